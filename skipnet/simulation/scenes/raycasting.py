"""The one place that talks to Open3D's ray caster."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skipnet.types import FloatArray, IntArray


class Hits(NamedTuple):
    """The first triangle on each ray."""

    distances: FloatArray
    """(N,) float64 in units of the ray's direction vector; infinite where nothing was hit."""
    triangle: IntArray
    """(N,) index of the triangle; meaningless where nothing was hit."""
    normals: FloatArray
    """(N, 3) unit normals by the right-hand rule; zero where nothing was hit."""


class Raycaster:
    """Answers rays and distances against triangles; the same ray gets the same bits every time."""

    def __init__(self, vertices_m: FloatArray, triangles: IntArray) -> None:
        """Build the acceleration structure (a millisecond for a room, float32 inside).

        Args:
            vertices_m: (V, 3).
            triangles: (T, 3) vertex indices.
        """
        from open3d import core, t

        self._tensor = core.Tensor.from_numpy
        self._scene = t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(np.ascontiguousarray(vertices_m, dtype=np.float32)),
            self._tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
        )

    def cast(self, origins_m: FloatArray, directions: FloatArray) -> Hits:
        """First hits of rays from (N, 3) or (3,) origins along (N, 3) directions.

        A ray through an edge, to float32 precision, may be told either of its two faces.
        """
        rays = np.empty((len(directions), 6), dtype=np.float32)
        rays[:, :3] = origins_m
        rays[:, 3:] = directions
        hits = self._scene.cast_rays(self._tensor(rays))
        return Hits(
            hits["t_hit"].numpy().astype(np.float64),
            hits["primitive_ids"].numpy(),
            hits["primitive_normals"].numpy(),
        )

    def distances_m(self, points_m: FloatArray) -> FloatArray:
        """(N,) distance from (N, 3) points to the nearest triangle.

        Open3D computes it in float32: it is off by up to 3 mm near long thin triangles.
        """
        points = np.ascontiguousarray(points_m, dtype=np.float32)
        return self._scene.compute_distance(self._tensor(points)).numpy()
