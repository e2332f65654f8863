"""Point clouds in files and in memory: reading, writing, checking, denoising."""

from __future__ import annotations
