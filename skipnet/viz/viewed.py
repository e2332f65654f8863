"""What the viewer shows, packed for a page: places as whole steps, values as bytes."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import nearest
from skipnet.types import FeatureClass, FloatArray, IntArray
from skipnet.viz.colours import CURVATURE_OF_BRIGHTEST
from skipnet.viz.views import thin_rows

_THINNING_CELLS = 600
_STEPS = 65535
NO_CLASS = len(FeatureClass)
"""The class of voxels that are no feature."""


@dataclass(frozen=True)
class ViewedSkipMap:
    """The effective voxels of a scan, in its own frame."""

    centroids_m: FloatArray
    """(V, 3)."""
    curvatures: FloatArray
    """(V,)."""
    classes: IntArray
    """(V,) FeatureClass, or ``NO_CLASS``."""


@dataclass(frozen=True)
class ViewedScan:
    """One scan, in its own frame."""

    name: str
    points_m: FloatArray
    """(N, 3)."""
    tint: str
    """Its colour among the others, as #RRGGBB."""
    colour: IntArray | None = None
    """(N, 3) uint8, its own colours."""
    residuals_m: FloatArray | None = None
    """(N,) how far each point lies from the other scan in the pose that is shown first."""
    skipmap: ViewedSkipMap | None = None


@dataclass(frozen=True)
class ViewedPose:
    """One way in which all scans may stand in the common frame."""

    label: str
    """On its button."""
    note: str
    """Below the view, when it is shown: what it is, and how far it is to be believed."""
    T_common_scan: Sequence[FloatArray | None]
    """(4, 4) of each scan; None of one that is not shown."""


def pack(
    scan: ViewedScan, rows: IntArray, points_m: FloatArray, brightest_m: float
) -> dict[str, object]:
    """A scan as the script takes it: of the ``rows`` of its points, which are ``points_m``."""
    middle_m = _middle(points_m)
    packed: dict[str, object] = {
        "name": scan.name,
        "tint": [int(scan.tint[k : k + 2], 16) / 255 for k in (1, 3, 5)],
        **_placed(points_m, middle_m),
    }
    if scan.colour is not None:
        packed["own"] = _base64(scan.colour[rows].astype(np.uint8))
    if scan.residuals_m is not None:
        packed["residuals"] = _bytes(scan.residuals_m[rows] / brightest_m)
    found = scan.skipmap
    if found is not None and len(found.centroids_m):
        in_order, voxel = np.argsort(rows), np.empty(len(rows), np.int64)
        voxel[in_order] = nearest(points_m[in_order], found.centroids_m)[1]
        packed |= _described(found.curvatures[voxel], found.classes[voxel])
        voxels = _placed(found.centroids_m, middle_m)
        packed["voxels"] = voxels | _described(found.curvatures, found.classes)
        features = found.classes < FeatureClass.PLANE
        marks_m = found.centroids_m[features]
        packed["marks"] = (marks_m - middle_m).astype(np.float32).round(4).tolist()
        packed["kinds"] = found.classes[features].tolist()
    return packed


def _placed(points_m: FloatArray, middle_m: FloatArray) -> dict[str, object]:
    """Places as steps of a box about the scan's middle, in which the poses are given too."""
    low_m, span_m = _box(points_m)
    steps = np.rint((points_m - low_m) / span_m * _STEPS).astype("<u2")
    return {
        "low": (low_m - middle_m).tolist(),
        "span": span_m.tolist(),
        "places": _base64(steps),
    }


def _described(curvatures: FloatArray, classes: IntArray) -> dict[str, str]:
    return {
        "curvature": _bytes(curvatures / CURVATURE_OF_BRIGHTEST),
        "classes": _base64(classes.astype(np.uint8)),
    }


def _bytes(share: FloatArray) -> str:
    return _base64(np.rint(255 * np.clip(share, 0, 1)).astype(np.uint8))


def some_rows(points_m: FloatArray, most: int) -> IntArray:
    """Rows of points even over space, in random order: any number of the first are even too."""
    return np.random.default_rng(0).permutation(thin_rows(points_m, most, _THINNING_CELLS))


def _box(points_m: FloatArray) -> tuple[FloatArray, FloatArray]:
    low_m, high_m = points_m.min(axis=0), points_m.max(axis=0)
    return low_m, np.maximum(high_m - low_m, 1e-6)


def _middle(points_m: FloatArray) -> FloatArray:
    """A place near a scan, from which browsers count in single precision."""
    return np.round(points_m.mean(axis=0))


def pack_pose(
    pose: ViewedPose, scans_m: Sequence[FloatArray], centre_m: FloatArray
) -> dict[str, object]:
    """Transforms between the scans' middles and the view's centre, column by column."""
    matrices: list[list[float] | None] = []
    for T, points_m in zip(pose.T_common_scan, scans_m, strict=True):
        if T is None:
            matrices.append(None)
            continue
        local = np.array(T, np.float64)
        local[:3, 3] = T[:3, :3] @ _middle(points_m) + T[:3, 3] - centre_m
        matrices.append(local.T.ravel().tolist())
    return {"note": pose.note, "matrices": matrices}


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
