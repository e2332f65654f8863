"""How far a sensor saw in every direction: what tells free space from space nobody looked at."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skipnet.compiled import compiled, inlined
from skipnet.types import BoolArray, FloatArray, IntArray

_MIN_BINS, _MAX_BINS = 32, 512
_POINTS_PER_BIN = 4
_LEAST_SHARE = 0.25
"""Of all directions: a narrower view gets no finer bins. Finer ones contradict most poses that a
pattern repeats, and the false one that is left, seen from where the first sensor stood, looks
like the only one: of 24 simulated pedestals 11 were accepted wrongly instead of 5."""
_LOOK_BINS, _LOOK_POINTS = 32, 20_000
"""So rough a map of so many points tells which part of all directions was seen."""


@dataclass(frozen=True)
class RangeImage:
    """How far a sensor saw in every direction, on an octahedral map of the sphere."""

    viewpoint_m: FloatArray
    """(3,) sensor position in the scan's frame."""
    nearest_m: FloatArray
    """(B, B) nearest range seen in or next to each bin; 0 where nothing was seen."""

    def sees(self, T_image_points: FloatArray, points_m: FloatArray) -> BoolArray:
        """(V,) whether something was seen in the direction of (V, 3) points under a (4, 4) motion,
        before or behind them."""
        T = np.array(T_image_points[:3])
        T[:, 3] -= self.viewpoint_m
        return _sees(T.astype(points_m.dtype), points_m, self.nearest_m)

    def in_front(
        self,
        T_image_points: FloatArray,
        points_m: FloatArray,
        asked: BoolArray,
        free_share: float,
        free_m: float,
    ) -> BoolArray:
        """Which points lie well in front of what was seen in their direction.

        Args:
            T_image_points: (C, 4, 4) motions of the points into the scan's frame.
            points_m: (V, 3) points, the first S of which are looked at.
            asked: (C, S) those to look at under each motion; for all others it is False.
            free_share: what is in front is so by this share of the range ...
            free_m: ... and by so much.

        Returns:
            (C, S) bool.
        """
        T = np.array(T_image_points[:, :3])
        T[:, :, 3] -= self.viewpoint_m
        limits = np.float32(1 - free_share), np.float32(free_m)
        places = np.empty(asked.shape[1], np.int32), np.empty(asked.shape[1], np.float32)
        columns_m, front = points_m[: asked.shape[1]].T.copy(), np.empty_like(asked)
        _in_front(T.astype(np.float32), columns_m, asked, self.nearest_m, limits, places, front)
        return front


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
    T_image_points = np.eye(4) if T_own_points is None else T_own_points.copy()
    T_image_points[:3, 3] -= viewpoint_m
    per_bin = _POINTS_PER_BIN * max(_seen_share(points_m, T_image_points), _LEAST_SHARE)
    bins = int(np.clip(np.sqrt(len(points_m) / per_bin), _MIN_BINS, _MAX_BINS))
    nearest_m = np.full((bins, bins), np.inf, dtype=np.float32)
    _take_nearest(points_m, T_image_points, nearest_m)
    nearest_m = _least_of_neighbours(nearest_m)
    # Gaps between scan lines are closed by now; what the rim gained goes, and a bin more.
    inner = _least_of_neighbours(_least_of_neighbours(np.isfinite(nearest_m)))
    nearest_m[~inner] = 0.0
    return RangeImage(np.asarray(viewpoint_m, dtype=np.float64), nearest_m)


def _seen_share(points_m: FloatArray, T_image_points: FloatArray) -> float:
    """Part of all directions in which (N, 3) points lie: a camera sees little of the sphere."""
    rough = np.full((_LOOK_BINS, _LOOK_BINS), np.inf, dtype=np.float32)
    _take_nearest(points_m[:: len(points_m) // _LOOK_POINTS + 1], T_image_points, rough)
    return max(float(np.isfinite(rough).mean()), 1 / rough.size)


def _least_of_neighbours(values: NDArray) -> NDArray:
    """(B, B) least of each 3x3 neighbourhood; beyond the edge lies nothing less."""
    values = np.pad(values, 1, mode="edge")
    values = np.minimum(np.minimum(values[:-2], values[1:-1]), values[2:])
    return np.minimum(np.minimum(values[:, :-2], values[:, 1:-1]), values[:, 2:])


@inlined
def octahedral_bin(x: float, y: float, z: float, bins: int) -> tuple[int, int]:
    """Line and column of a direction on the octahedron unfolded to a square.

    Args:
        x: the direction's coordinates; its length does not matter.
        y: likewise.
        z: likewise.
        bins: along each side of the square.
    """
    length = abs(x) + abs(y) + abs(z)
    scale = 1 / length if length > 0 else length
    u, v = x * scale, y * scale
    folded_u, folded_v = math.copysign(1 - abs(v), u), math.copysign(1 - abs(u), v)
    u, v, half = (folded_u if z < 0 else u), (folded_v if z < 0 else v), 0.5 * bins
    line = int(min(bins - 1.0, max(0.0, (v + 1) * half)))
    return line, int(min(bins - 1.0, max(0.0, (u + 1) * half)))


@compiled
def _take_nearest(points_m: FloatArray, T_image_points: FloatArray, nearest_m: FloatArray) -> None:
    """Lower each bin of (B, B) to the range of the nearest point in it; the sensor is at 0."""
    T = T_image_points
    for i in range(len(points_m)):
        x_m, y_m, z_m = points_m[i, 0], points_m[i, 1], points_m[i, 2]
        x = T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3]
        y = T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3]
        z = T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3]
        line, column = octahedral_bin(x, y, z, len(nearest_m))
        range_m = np.float32(np.sqrt(x * x + y * y + z * z))
        nearest_m[line, column] = min(nearest_m[line, column], range_m)


@compiled
def _in_front(
    T_image_points: FloatArray,
    columns_m: FloatArray,
    asked: BoolArray,
    nearest_m: FloatArray,
    limits: tuple[np.float32, np.float32],
    places: tuple[IntArray, FloatArray],
    front: BoolArray,
) -> None:
    """See ``RangeImage.in_front``, of (3, S) coordinates; the sensor is at 0. Where a point lies is
    worked out for several at a time, asked about or not."""
    bins, squares_m2 = places
    ranges_m, (seen_share, free_m) = nearest_m.ravel(), limits
    one, zero = np.float32(1), np.float32(0)
    side = np.int32(len(nearest_m))
    half, last = np.float32(0.5) * np.float32(side), np.float32(side - 1)
    xs_m, ys_m, zs_m = columns_m[0], columns_m[1], columns_m[2]
    for c in range(len(T_image_points)):
        T = T_image_points[c]
        # Numbers of their own: what is read from an array could change with what is written.
        xx, xy, xz, x0 = T[0, 0], T[0, 1], T[0, 2], T[0, 3]
        yx, yy, yz, y0 = T[1, 0], T[1, 1], T[1, 2], T[1, 3]
        zx, zy, zz, z0 = T[2, 0], T[2, 1], T[2, 2], T[2, 3]
        for s in range(len(bins)):
            x = xx * xs_m[s] + xy * ys_m[s] + xz * zs_m[s] + x0
            y = yx * xs_m[s] + yy * ys_m[s] + yz * zs_m[s] + y0
            z = zx * xs_m[s] + zy * ys_m[s] + zz * zs_m[s] + z0
            length = abs(x) + abs(y) + abs(z)
            scale = one / length if length > zero else zero
            u, v = x * scale, y * scale
            folded_u, folded_v = math.copysign(one - abs(v), u), math.copysign(one - abs(u), v)
            u, v = (folded_u if z < zero else u), (folded_v if z < zero else v)
            line = np.int32(min(last, max(zero, (v + one) * half)))
            bins[s] = line * side + np.int32(min(last, max(zero, (u + one) * half)))
            squares_m2[s] = x * x + y * y + z * z
        was_asked, is_front = asked[c], front[c]
        for s in range(len(bins)):
            seen_m = seen_share * ranges_m[bins[s]] - free_m
            is_front[s] = was_asked[s] & (seen_m > zero) & (squares_m2[s] < seen_m * seen_m)


@compiled
def _sees(T: FloatArray, points_m: FloatArray, nearest_m: FloatArray) -> BoolArray:
    """See ``RangeImage.sees``; the sensor is at 0."""
    seen = np.zeros(len(points_m), dtype=np.bool_)
    for s in range(len(points_m)):
        x_m, y_m, z_m = points_m[s, 0], points_m[s, 1], points_m[s, 2]
        x = T[0, 0] * x_m + T[0, 1] * y_m + T[0, 2] * z_m + T[0, 3]
        y = T[1, 0] * x_m + T[1, 1] * y_m + T[1, 2] * z_m + T[1, 3]
        z = T[2, 0] * x_m + T[2, 1] * y_m + T[2, 2] * z_m + T[2, 3]
        line, column = octahedral_bin(x, y, z, len(nearest_m))
        seen[s] = nearest_m[line, column] > 0
    return seen
