"""What single voxels show: patches, primitives, descriptors."""

from __future__ import annotations
