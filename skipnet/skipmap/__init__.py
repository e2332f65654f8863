"""Voxels with additive moments: the skip-tree and the Skip-map."""
