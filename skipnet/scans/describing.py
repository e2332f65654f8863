"""From points to described scans: maps, place of the sensor, evidence."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from skipnet.clouds.repeats import first_of_each
from skipnet.clouds.statistics import principal_frame
from skipnet.clouds.strays import find_strays
from skipnet.geometry import invert, transform_points
from skipnet.networks.catalog import find_network
from skipnet.networks.model import Model
from skipnet.parallel.threads import one_blas_thread, side_by_side
from skipnet.scans.afar import side_seen
from skipnet.scans.evidence import build_evidence
from skipnet.scans.range_image import build_range_image
from skipnet.scans.record import Record
from skipnet.scans.scan import MIN_TRUST, AutoAt, Scan, Viewpoint
from skipnet.scans.viewpoint import trust_in
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.skipmap.skipmap import SkipMap, skipmap_of_tree
from skipnet.skipmap.tree import Points, SkipTree, build_tree, points_of
from skipnet.types import FloatArray


@one_blas_thread
def describe(
    clouds_m: Sequence[Points],
    viewpoints: Sequence[Viewpoint],
    voxel_size_m: float | None = None,
    seed: int = 0,
    network: Model | None = None,
) -> list[Scan]:
    """Describe scans with one voxel size, side by side.

    Args:
        clouds_m: (N, 3) points of each scan, or their fine voxels, in any frame.
        viewpoints: see ``Viewpoint``; of each scan, in the frame of its points.
        voxel_size_m: edge of a voxel at the middle level; None chooses it from the data.
        seed: of the order in which the judge samples voxels.
        network: what recognises and classifies voxels; None takes the shipped one.
    """
    clouds_m, strays = zip(*side_by_side(_cleared, clouds_m), strict=True)
    points_m = [points_of(cloud_m) for cloud_m in clouds_m]
    frames = side_by_side(principal_frame, points_m)
    if voxel_size_m is None:
        voxel_size_m = choose_voxel_size(*points_m, T_given_own=frames)
    one = partial(
        _describe_one,
        voxel_size_m=voxel_size_m,
        seed=seed,
        network=network or find_network(),
    )
    return side_by_side(one, clouds_m, strays, viewpoints, frames)


def common_voxel_size_m(clouds_m: Sequence[Points]) -> float:
    """The voxel size that ``describe`` chooses for these clouds."""
    clean_m = [points_of(cloud_m) for cloud_m, _ in side_by_side(_cleared, clouds_m)]
    return choose_voxel_size(*clean_m)


def _cleared(cloud_m: Points) -> tuple[Points, int]:
    """The cloud without repeats and points far from all others, and how many of these there are."""
    if isinstance(cloud_m, SkipTree):
        return cloud_m, 0
    first = first_of_each(cloud_m)
    cloud_m = cloud_m if first is None else cloud_m[first]
    strays = find_strays(cloud_m)
    return (cloud_m, 0) if strays is None else (cloud_m[~strays], int(strays.sum()))


def _describe_one(
    cloud_m: Points,
    strays: int,
    viewpoint: Viewpoint,
    T_given_own: FloatArray,
    voxel_size_m: float,
    seed: int,
    network: Model,
) -> Scan:
    """Divide a scan into voxels and find out how far its viewpoint can be believed."""
    T_own_given = invert(T_given_own)
    fine_tree = build_tree(cloud_m, voxel_size_m / 2, np.zeros(3), T_own_given)
    levels = _levels(fine_tree)
    is_given = not (viewpoint is None or isinstance(viewpoint, str | AutoAt))
    place_m = T_own_given[:3, 3]
    if is_given or isinstance(viewpoint, AutoAt):
        given_m = viewpoint.place_m if isinstance(viewpoint, AutoAt) else viewpoint
        place_m = transform_points(T_own_given, np.array([given_m], np.float64))[0]
    image, side, afar_m, trust = None, None, None, 0.0
    if not (viewpoint is None or is_given):
        afar_m = side_seen(*levels[:2], place_m)
    if afar_m is not None:
        side = build_range_image(points_of(cloud_m), afar_m, T_own_given)
    elif viewpoint is not None:
        trust = trust_in(*levels[:2], place_m, is_given)
    if trust > 0:
        image = build_range_image(points_of(cloud_m), place_m, T_own_given)
    record = Record(T_given_own, strays, fine_tree, image, trust, side, seed)
    return _described(record, levels, network)


def restored(record: Record, network: Model) -> Scan:
    """The scan that a record was kept of, to the same bits.

    Args:
        record: of the scan.
        network: the one that it was described with, or another.
    """
    return _described(record, _levels(record.fine_tree), network)


def _levels(fine_tree: SkipTree) -> tuple[SkipMap, SkipMap, SkipMap]:
    """Skip-maps at the voxel size, half of it and twice, normals of either sign."""
    tree = fine_tree.coarser()
    return skipmap_of_tree(tree), skipmap_of_tree(fine_tree), skipmap_of_tree(tree.coarser())


def _described(record: Record, levels: tuple[SkipMap, SkipMap, SkipMap], network: Model) -> Scan:
    """The scan of a record and its Skip-maps."""
    image, rng = record.range_image, np.random.default_rng(record.seed)
    believed_m = heard_m = None if record.side is None else record.side.viewpoint_m
    trust = 1.0
    if image is not None:
        # The judge hears of places, too, that are not believed so far.
        heard_m, trust = image.viewpoint_m, record.trust
        believed_m = heard_m if trust >= MIN_TRUST else None
    skipmap, fine, coarse = (level.seen_from(believed_m) for level in levels)
    heard = skipmap if heard_m is believed_m else levels[0].seen_from(heard_m)
    evidence = build_evidence(heard, image, rng, trust)
    return Scan(record, skipmap, coarse, fine, evidence, network)
