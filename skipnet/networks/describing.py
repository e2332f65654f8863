"""A network at work on scans: keypoints described, voxels classified, two scans matched."""

from __future__ import annotations

import numpy as np

from skipnet.features.cylinders import choose_keypoints
from skipnet.features.matching import among_nearest, mutual_nearest, mutually_near
from skipnet.features.patches import build_patches
from skipnet.networks.model import Model
from skipnet.networks.numpy_matcher import NumpyMatcher
from skipnet.networks.tokens import Tokens
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

Keypoints = tuple[IntArray, FloatArray]
"""(K,) rows of a Skip-map and their (K, D) descriptors."""
KEPT_SHARE = 0.6
"""Of the voxels described, the most matchable are matched: the others give far more wrong matches
than right."""


@one_blas_thread
def describe_keypoints(
    skipmap: SkipMap,
    network: Model,
    both_sides: bool = False,
    max_keypoints: int | None = None,
) -> Keypoints:
    """The voxels of a scan that are likeliest to be recognised in another, and their descriptors.

    Args:
        skipmap: the scan's Skip-map.
        network: describes and says what is matchable.
        both_sides: describe each voxel with both signs of its normal.
        max_keypoints: voxels described, see ``choose_keypoints``; the most matchable are returned.
            None takes as many as the network asks for.

    Returns:
        (K,) rows of the Skip-map, a row twice at most if both sides are described, and (K, D).
    """
    count = max_keypoints or network.max_keypoints
    rows = choose_keypoints(skipmap, count, network.curved_share)
    patches = network.cut(skipmap, rows)
    if both_sides:
        patches = np.concatenate([patches, network.turned_over(patches)])
        rows = np.concatenate([rows, rows])
    described, matchable = network.read(patches)
    kept = np.argsort(-matchable, kind="stable")[: int(np.ceil(KEPT_SHARE * len(rows)))]
    return rows[kept], described[kept]


def classify_voxels(skipmap: SkipMap, rows: IntArray, network: Model) -> FloatArray:
    """(K, 5) probabilities of the classes, in the order of ``FeatureClass``, of (K,) voxels."""
    return network.classify(build_patches(skipmap, rows), network.cut(skipmap, rows))


@one_blas_thread
def correspond(
    source: SkipMap,
    target: SkipMap,
    network: Model,
    max_keypoints: int | None = None,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of two scans that recognise each other.

    Where a viewpoint is unknown the signs of the normals say nothing: then the target is
    described with both.

    Args:
        source: Skip-map of the source.
        target: Skip-map of the target.
        network: describes and says what is matchable.
        max_keypoints: voxels described per scan, see ``describe_keypoints``.

    Returns:
        (C,) rows of the source, (C,) rows of the target and (C,) distances between their
        descriptors: 0 equal, 2 opposed.
    """
    unknown = source.viewpoint_m is None or target.viewpoint_m is None
    of_source, of_target = side_by_side(
        lambda scan, both: describe_keypoints(scan, network, both, max_keypoints),
        (source, target),
        (False, unknown),
    )
    return recognised(of_source, of_target)


def recognised(
    source: Keypoints, target: Keypoints, choices: int = 1
) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of two scans, from ``describe_keypoints``, that recognise each other.

    Args:
        source: rows and descriptors.
        target: rows and descriptors.
        choices: so many others may each of them be taken for.

    Returns:
        See ``correspond``.
    """
    (rows_s, described_s), (rows_t, described_t) = source, target
    if choices == 1:
        of_source, of_target, distance = mutual_nearest(described_s, described_t)
    else:
        of_source, of_target, distance = mutually_near(described_s, described_t, choices)
    return rows_s[of_source], rows_t[of_target], distance


def matched(
    matcher: NumpyMatcher,
    source: tuple[IntArray, Tokens],
    target: tuple[IntArray, Tokens],
    oriented: bool,
    choices: int = 1,
) -> tuple[IntArray, IntArray, FloatArray]:
    """Voxels of two scans that a matcher takes for each other.

    Args:
        matcher: sees both scans' keypoints together.
        source: rows and tokens, from ``tokens_of``.
        target: rows and tokens.
        oriented: whether the axes of both look to their sensors' sides.
        choices: so many others may each of them be taken for.

    Returns:
        (C,) rows of the source, (C,) rows of the target and (C,) how unlikely each pair is: the
        negative logarithm of its probability.
    """
    (rows_s, tokens_s), (rows_t, tokens_t) = source, target
    unlikely = -matcher.match(tokens_s, tokens_t, oriented)
    of_source, of_target = among_nearest(unlikely, choices)
    return rows_s[of_source], rows_t[of_target], unlikely[of_source, of_target]
