"""Voxels with additive moments: the skip-tree and the Skip-map."""

from __future__ import annotations
