"""A pair in 3-D, and how a page speaks of its pose: a refused one is not "the motion found"."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.geometry import transform_points
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.registration.result import Registration
from skipnet.results.inputs import LARGEST_SCENE_M, Given
from skipnet.results.skipmaps import matched_features, skipmaps_of
from skipnet.skipmap.tree import points_of
from skipnet.types import FloatArray, Status
from skipnet.viz.colours import SOURCE_COLOUR, TARGET_COLOUR
from skipnet.viz.lengths import Lengths
from skipnet.viz.residuals import distances_m
from skipnet.viz.viewed import ViewedPose, ViewedScan, some_rows
from skipnet.viz.viewer import MOST_POINTS, viewer

_FAR_EXTENTS = 5.0
"""Scans farther apart than so many of their extents are shown moved together."""
_ASKED = 20_000
"""Points that tell how far."""
MOST_ALTERNATIVES = 8
"""Poses beside the best that get a button; result.json has all."""


@dataclass(frozen=True)
class PoseWords:
    """How a page speaks of the pose."""

    heading: str
    button: str
    note: str


WORDS = {
    Status.REGISTERED: PoseWords(
        "The motion found", "registered", "With the motion found: registered."
    ),
    Status.AMBIGUOUS: PoseWords(
        "One possible motion, not certain",
        "possible, not certain",
        "A possible pose, not certain: others explain the scans as well, or too little holds it.",
    ),
    Status.FAILED: PoseWords(
        "The best candidate, refused",
        "best candidate, refused",
        "Not a result: the best candidate, which was refused. Do not use it.",
    ),
}


NOTHING = PoseWords("No motion found", "", "No pose was proposed.")
"""Of a failure without any candidate."""


def words_of(result: Registration) -> PoseWords:
    """How to speak of a result's pose."""
    return NOTHING if result.findings is None else WORDS[Status(result.status)]


@one_blas_thread
def pair_viewer(
    source: Given,
    target: Given,
    result: Registration,
    lengths: Lengths,
    most: int = MOST_POINTS,
) -> tuple[str, FloatArray]:
    """The view of a pair, and the (N,) residuals of the source's points in the pose.

    Args:
        source: the scan that was moved.
        target: the scan that stayed.
        result: of the registration.
        lengths: how to speak of them.
        most: points to show.
    """
    source_m, target_m = points_of(source.points_m), points_of(target.points_m)
    T = result.T_target_source
    moved_m = transform_points(T, source_m)
    # As the view will show them; the others are not asked.
    shown = np.sort(some_rows(target_m, most // 2))
    there_m, back_m = side_by_side(distances_m, (moved_m, target_m[shown]), (target_m, moved_m))
    away_m = there_m, np.zeros(len(target_m))
    away_m[1][shown] = back_m
    names = (f"source: {source.path.name}", f"target: {target.path.name}")
    described = skipmaps_of(result)
    tints = (SOURCE_COLOUR, TARGET_COLOUR)
    scans = [
        ViewedScan(
            name,
            points_m,
            tint,
            None if scan.is_large else scan.cloud.colour_8bit,
            residuals_m,
            skipmap,
        )
        for name, points_m, tint, scan, residuals_m, skipmap in zip(
            names, (source_m, target_m), tints, (source, target), away_m, described, strict=True
        )
    ]
    poses = [_before(source_m, target_m, lengths), *_candidates(result)]
    start = min(1, len(poses) - 1)
    matches = matched_features(described, result)
    brightest_m = result.voxel_size_m / 2
    view = viewer(scans, poses, start, brightest_m, most, matches, lengths)
    return view, there_m


def _before(source_m: FloatArray, target_m: FloatArray, lengths: Lengths) -> ViewedPose:
    """Both scans as they came; moved together where that would be two dots far apart."""
    T, apart_m = moved_together(source_m, target_m)
    if T[:3, 3].any():
        there = f"{lengths.large(apart_m)} apart"
        note = f"As they came, but moved together: they lie {there}."
        return ViewedPose("as they came, moved together", note, (T, np.eye(4)))
    return ViewedPose("as they came", "Both scans as they came.", (T, np.eye(4)))


def moved_together(source_m: FloatArray, target_m: FloatArray) -> tuple[FloatArray, float]:
    """The (4, 4) shift that brings a scan beside another, none where it is not far from it, and
    how far it is."""
    T = np.eye(4)
    source_m, target_m = (one[:: 1 + len(one) // _ASKED] for one in (source_m, target_m))
    apart_m = np.median(target_m, axis=0) - np.median(source_m, axis=0)
    extent_m = max(float(np.ptp(points_m, axis=0).max()) for points_m in (source_m, target_m))
    if np.linalg.norm(apart_m) > _FAR_EXTENTS * extent_m:
        T[:3, 3] = apart_m
    return T, float(np.linalg.norm(apart_m))


def _candidates(result: Registration) -> list[ViewedPose]:
    if result.findings is None:
        return []
    words, stays = words_of(result), np.eye(4)
    poses = [ViewedPose(words.button, words.note, (result.T_target_source, stays))]
    others = result.findings.alternatives
    of = f" of {len(others)}, of which the first {MOST_ALTERNATIVES} are shown"
    rest = of if len(others) > MOST_ALTERNATIVES else ""
    for number, T in enumerate(others[:MOST_ALTERNATIVES], 1):
        note = f"Alternative {number}{rest}: another pose that explains the scans nearly as well."
        poses.append(ViewedPose(f"alternative {number}", note, (T, stays)))
    return poses


def advice(result: Registration) -> list[str]:
    """What to try when the scans were not registered; nothing when they were."""
    if result.status == Status.REGISTERED:
        return []
    tips = []
    extents_m = [scan.extent_m.max() for scan in (result.source, result.target)
                 if scan.extent_m is not None]  # fmt: skip
    if extents_m and max(extents_m) > LARGEST_SCENE_M:
        tips.append(
            f"The scans extend over {max(extents_m):,.0f} m. If their coordinates are millimetres, "
            "say so: unit=mm."
        )
    if len(extents_m) == 2 and max(extents_m) > 50 * min(extents_m):
        tips.append("One scan is more than 50 times as large as the other: are both in one unit?")
    unknown = [
        name
        for name, scan in (("source", result.source), ("target", result.target))
        if scan.viewpoint_m is None
    ]
    if unknown:
        options = " and ".join(f"{name}_viewpoint=[x,y,z]" for name in unknown)
        tips.append(f"Where the sensor stood is unknown. If you know it, say so: {options}.")
    found = result.findings
    if found is not None and len(found.alternatives):
        tips.append(
            "Other poses fit nearly as well: look at the alternatives below. A scan taken between "
            "the two places, or one that sees what differs, settles it."
        )
    if found is not None and len(found.free_directions) + len(found.free_turns):
        tips.append(
            "The shared surfaces let one scan slide or turn along the other (a corridor, a bare "
            "wall): a scan that also sees a corner or a cross wall holds it."
        )
    tips.append(
        "Scans that share less than about a third of what they see often fail: take one more scan "
        "between the two."
    )
    return tips
