"""How far a sensor saw in every direction: what tells free space from space nobody looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skipnet.geometry import columns
from skipnet.types import FloatArray, IntArray

_MIN_BINS, _MAX_BINS = 32, 256
_POINTS_PER_BIN = 4
_POINTS_AT_ONCE = 1 << 17
"""So few that what is computed of them on the way takes little memory."""


@dataclass(frozen=True)
class RangeImage:
    """How far a sensor saw in every direction, on an octahedral map of the sphere."""

    viewpoint_m: FloatArray
    """(3,) sensor position in the scan's frame."""
    nearest_m: FloatArray
    """(B, B) nearest range seen in or next to each bin; 0 where nothing was seen."""

    def range_towards(
        self, x_m: FloatArray, y_m: FloatArray, z_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """For points by coordinates: their range, and the nearest range seen that way (or 0)."""
        x_m, y_m, z_m = (
            coordinate_m - coordinate_m.dtype.type(own_m)
            for coordinate_m, own_m in zip((x_m, y_m, z_m), self.viewpoint_m, strict=True)
        )
        bins = octahedral_bin(x_m, y_m, z_m, len(self.nearest_m))
        return np.sqrt(x_m * x_m + y_m * y_m + z_m * z_m), self.nearest_m.ravel().take(bins)


def build_range_image(
    points_m: FloatArray, viewpoint_m: FloatArray, T_own_points: FloatArray | None = None
) -> RangeImage:
    """Nearest range per direction, with as many bins as the scan's density fills.

    Each bin takes the nearest range of its 3x3 neighbours too, so that a surface seen at a grazing
    angle or a silhouette never looks like free space. Bins at the rim of what was seen count as
    unseen: nothing is known beyond the outermost scan line.

    Args:
        points_m: (N, 3) points of one scan.
        viewpoint_m: (3,) where they were seen from, in the frame of the image.
        T_own_points: (4, 4) from the frame of the points to that of the image; None where these
            are one.
    """
    bins = int(np.clip(np.sqrt(len(points_m) / _POINTS_PER_BIN), _MIN_BINS, _MAX_BINS))
    nearest_m = np.full(bins * bins, np.inf, dtype=np.float32)
    for xyz_m in columns(points_m, T_own_points, _POINTS_AT_ONCE):
        x_m, y_m, z_m = (xyz_m - viewpoint_m[:, None]).astype(np.float32)
        range_m = np.sqrt(x_m * x_m + y_m * y_m + z_m * z_m)
        np.minimum.at(nearest_m, octahedral_bin(x_m, y_m, z_m, bins), range_m)
    nearest_m = _least_of_neighbours(nearest_m.reshape(bins, bins))
    # Gaps between scan lines are closed by now; what the rim gained goes, and a bin more.
    inner = _least_of_neighbours(_least_of_neighbours(np.isfinite(nearest_m)))
    nearest_m[~inner] = 0.0
    return RangeImage(np.asarray(viewpoint_m, dtype=np.float64), nearest_m)


def _least_of_neighbours(values: NDArray) -> NDArray:
    """(B, B) least of each 3x3 neighbourhood; beyond the edge lies nothing less."""
    values = np.pad(values, 1, mode="edge")
    values = np.minimum(np.minimum(values[:-2], values[1:-1]), values[2:])
    return np.minimum(np.minimum(values[:, :-2], values[:, 1:-1]), values[:, 2:])


def octahedral_bin(x: FloatArray, y: FloatArray, z: FloatArray, bins: int) -> IntArray:
    """Flat bin of each direction, given by its coordinates, on the octahedron unfolded to a square.

    Args:
        x: array of any shape; the length of (x, y, z) does not matter.
        y: likewise.
        z: likewise.
        bins: along each side of the square.
    """
    scale = np.abs(x) + np.abs(y) + np.abs(z)
    scale[scale == 0] = 1
    u, v = x / scale, y / scale
    folded_u, folded_v = np.copysign(1 - np.abs(v), u), np.copysign(1 - np.abs(u), v)
    below = z < 0
    u, v = np.where(below, folded_u, u), np.where(below, folded_v, v)
    column = np.minimum(((u + 1) * (bins / 2)).astype(np.int32), bins - 1)
    line = np.minimum(((v + 1) * (bins / 2)).astype(np.int32), bins - 1)
    return line * bins + column
