"""What people look at: pictures, TensorBoard, one-file HTML reports."""

from __future__ import annotations
