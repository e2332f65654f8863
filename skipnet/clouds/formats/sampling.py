"""Points on the triangles of a mesh, where its vertices alone would leave its surfaces empty."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.types import FloatArray, IntArray

_FEWEST_VERTICES = 10_000
"""A mesh of more is taken to be a scan whose vertices are its points."""
_SAMPLES = 200_000


def is_coarse(vertices: int) -> bool:
    """Whether a mesh of so many vertices is sampled."""
    return vertices < _FEWEST_VERTICES


def sample_triangles(vertices: Cloud, triangles: IntArray) -> Cloud:
    """Spread points evenly over (T, 3) triangles of vertex numbers, always in the same places.

    Colours are those of the nearest corner; what else vertices have is left out. Where the
    triangles have no area, or leave half of the vertices out, the vertices come back.
    """
    corners_m = vertices.points_m[triangles]
    across = np.cross(corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0])
    area_m2 = 0.5 * np.linalg.norm(across, axis=1)
    total_m2 = float(area_m2.sum())
    in_use = len(np.unique(triangles))
    if not 0 < total_m2 < np.inf or in_use < 0.5 * len(vertices):
        return vertices
    rng = np.random.default_rng(0)
    chosen = rng.choice(len(triangles), _SAMPLES, p=area_m2 / total_m2)
    weights = _barycentric(rng)
    nearest = triangles[chosen, weights.argmax(axis=1)]
    note = f"a mesh of {len(triangles):,} triangles: sampled at {_SAMPLES:,} points"
    return replace(
        vertices,
        points_m=np.einsum("nk,nki->ni", weights, corners_m[chosen]),
        colour=None if vertices.colour is None else vertices.colour[nearest],
        normals=across[chosen] / (2 * area_m2[chosen, None]),
        intensity=None,
        columns={},
        notes=(*vertices.notes, note),
    )


def _barycentric(rng: np.random.Generator) -> FloatArray:
    """(N, 3) weights of a triangle's corners, evenly over its area."""
    first, second = rng.random((2, _SAMPLES))
    root = np.sqrt(first)
    return np.stack([1 - root, root * (1 - second), root * second], axis=1)
