"""The generators of candidate poses, by name: each sees two described scans and proposes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skipnet.features.matching import mutual_nearest
from skipnet.features.primitives import Planes
from skipnet.networks.catalog import find_deep, find_matcher, find_network
from skipnet.networks.describing import matched, recognised
from skipnet.networks.model import Model
from skipnet.parallel.threads import side_by_side
from skipnet.registration.hypotheses.corners_edges import from_corners, from_edges
from skipnet.registration.hypotheses.correspondences import Facing, from_correspondences
from skipnet.registration.hypotheses.hypotheses import Hypotheses
from skipnet.registration.hypotheses.planes import from_planes
from skipnet.registration.hypotheses.slides import from_slides
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, IntArray

DEEP_CHOICES = 2
"""A voxel may correspond to so many others for which the deep network takes it."""

Propose = Callable[[Scan, Scan, RegistrationConfig], Hypotheses]
"""From source, target and options to candidate poses; the judge decides about all of them alike."""


def asked(config: RegistrationConfig, source: Scan, target: Scan) -> list[Generator]:
    """The generators of these two scans, in order: of both last resorts the deep network is asked
    where a scan is narrow alone; where sensors see all round it finds no more than FPFH does."""
    if source.is_narrow or target.is_narrow or Generator.fpfh not in config.generators:
        return config.generators
    return [generator for generator in config.generators if generator is not Generator.deep]


def propose(
    generator: Generator, source: Scan, target: Scan, config: RegistrationConfig
) -> Hypotheses:
    """Candidate poses of one generator."""
    return PROPOSE[generator](source, target, config)


def _from_corners(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    size_m = source.skipmap.voxel_size_m
    return from_corners(source.corners, target.corners, size_m, config.same_class_corners)


def _from_edges(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    return from_edges(source.lines, target.lines, source.skipmap.voxel_size_m)


def _from_planes(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    return from_planes(*_planes(source, target), source.skipmap.voxel_size_m)


def _from_slides(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    voxels = source.skipmap.centroids_m, target.skipmap.centroids_m
    return from_slides(*_planes(source, target), *voxels, source.skipmap.voxel_size_m)


def _from_descriptors(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    return _from_network(source, target, source.network, 1, config)


def _from_deep(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    if config.matcher is None:
        network = find_network(config.deep_network, config.device)
        return _from_network(source, target, network, DEEP_CHOICES, config)
    described = find_deep(config.deep_network, "deep_network", config.device)
    matcher, oriented = find_matcher(config.matcher, described), _agree_in_side(source, target)
    of_source, of_target = side_by_side(
        lambda scan, both: scan.tokens(described, both), (source, target), (False, not oriented)
    )
    found = matched(matcher, of_source, of_target, oriented, DEEP_CHOICES)
    return _from_matches(source, target, found, config, np.exp(-found[2]))


def _from_network(
    source: Scan, target: Scan, network: Model, choices: int, config: RegistrationConfig
) -> Hypotheses:
    """Poses on which voxels agree that recognise each other.

    Where a viewpoint is unknown the signs of the normals say nothing: then the target is described
    with both.
    """
    both_sides = False, not _agree_in_side(source, target)
    of_source, of_target = side_by_side(
        lambda scan, both: scan.keypoints(network, both), (source, target), both_sides
    )
    return _from_matches(source, target, recognised(of_source, of_target, choices), config)


def _from_fpfh(source: Scan, target: Scan, config: RegistrationConfig) -> Hypotheses:
    described = side_by_side(lambda scan: scan.histograms, (source, target))
    found = mutual_nearest(*described)
    return _from_matches(source, target, found, config)


def _planes(source: Scan, target: Scan) -> tuple[Planes, Planes]:
    """Planes of both; where a sensor's place is unknown, either side of them may be up."""
    planes_s, planes_t = side_by_side(lambda scan: scan.planes, (source, target))
    if not _agree_in_side(source, target):
        planes_s = planes_s.with_both_signs()
    return planes_s, planes_t


def _agree_in_side(source: Scan, target: Scan) -> bool:
    """Whether the normals of both look to their sensors."""
    return source.viewpoint_m is not None and target.viewpoint_m is not None


def _from_matches(
    source: Scan,
    target: Scan,
    found: tuple[IntArray, IntArray, FloatArray],
    config: RegistrationConfig,
    trust: FloatArray | None = None,
) -> Hypotheses:
    """Poses on which the best of the (K,) matched rows of both Skip-maps agree; (K,) trust in each
    match, or all alike. What is not trusted alike is mostly wrong, and must keep angles, too."""
    rows_s, rows_t, distance = found
    best = np.argsort(distance, kind="stable")[: config.max_correspondences]
    at_s, at_t = rows_s[best], rows_t[best]
    places_m = source.skipmap.centroids_m[at_s], target.skipmap.centroids_m[at_t]
    reach_m = 1.5 * source.skipmap.voxel_size_m
    if trust is None:
        return from_correspondences(*places_m, np.ones(len(best)), reach_m)
    axes = source.skipmap.normals[at_s], target.skipmap.normals[at_t]
    facing = Facing(*axes, _agree_in_side(source, target))
    return from_correspondences(*places_m, trust[best], reach_m, facing=facing)


PROPOSE: dict[Generator, Propose] = {
    Generator.corners: _from_corners,
    Generator.edges: _from_edges,
    Generator.planes: _from_planes,
    Generator.slides: _from_slides,
    Generator.descriptors: _from_descriptors,
    Generator.deep: _from_deep,
    Generator.fpfh: _from_fpfh,
}
"""Every generator; a new one is a function and a row here, and a member of ``Generator``."""
