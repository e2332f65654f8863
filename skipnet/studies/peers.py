"""What others would do with many scans: pairs in a chain, and KISS-Matcher with a pose graph.

Neither has a word for a doubt but the one that is given to it here: a pair that did not register,
or of which too little agrees, is no link.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from skipnet.benchmark.methods import Task, kiss_matcher
from skipnet.geometry import invert
from skipnet.projects.components import components
from skipnet.registration.result import Registration
from skipnet.types import FloatArray, Status

LEAST_FITNESS = 0.3
"""Share of a scan's points that must have a partner for KISS-Matcher's answer to be a link."""

Placed = tuple[list[list[int]], list[FloatArray]]
"""Groups of scans, and (4, 4) of each scan in its group's frame."""


def chained(pairs: Mapping[tuple[int, int], Registration], count: int) -> Placed:
    """Registered pairs, the most confident first, each joining what is not joined yet."""
    sure = {k: r for k, r in pairs.items() if r.status is Status.REGISTERED}
    groups = [{scan: np.eye(4)} for scan in range(count)]
    for a, b in sorted(sure, key=lambda key: (-sure[key].confidence, key)):
        first = next(group for group in groups if a in group)
        second = next(group for group in groups if b in group)
        if first is second:
            continue
        T = first[a] @ sure[a, b].T_target_source @ invert(second[b])
        first |= {scan: T @ pose for scan, pose in second.items()}
        groups.remove(second)
    return _listed(groups, count)


def kiss_with_pose_graph(clouds_m: Sequence[FloatArray], voxel_size_m: float) -> Placed:
    """KISS-Matcher and GICP on every pair, balanced by Open3D's pose graph with line processes.

    Args:
        clouds_m: (N, 3) each.
        voxel_size_m: of the matcher; links are judged at twice as much.
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    method = kiss_matcher.make(voxel_size_m)
    thin = [
        o3d.geometry.PointCloud(o3d.utility.Vector3dVector(cloud)).voxel_down_sample(voxel_size_m)
        for cloud in clouds_m
    ]
    edges = {}
    for a, b in combinations(range(len(clouds_m)), 2):
        T = method(Task(clouds_m[b], clouds_m[a])).T_target_source
        reach_m = 2 * voxel_size_m
        found = registration.evaluate_registration(thin[b], thin[a], reach_m, T)
        if found.fitness >= LEAST_FITNESS:
            edges[a, b] = (
                T,
                registration.get_information_matrix_from_point_clouds(thin[b], thin[a], reach_m, T),
            )
    groups = [
        _balanced(part, {key: edge for key, edge in edges.items() if key[0] in part}, voxel_size_m)
        for part in components(range(len(clouds_m)), edges)
    ]
    return _listed(groups, len(clouds_m))


def _balanced(
    part: Sequence[int],
    edges: Mapping[tuple[int, int], tuple[FloatArray, FloatArray]],
    voxel_size_m: float,
) -> dict[int, FloatArray]:
    """Poses of connected scans by Open3D's global optimization."""
    import open3d as o3d

    registration = o3d.pipelines.registration
    poses = _by_a_tree(part, edges)
    row = {scan: number for number, scan in enumerate(part)}
    graph = registration.PoseGraph()
    graph.nodes.extend(registration.PoseGraphNode(poses[scan]) for scan in part)
    for (a, b), (T, information) in edges.items():
        edge = registration.PoseGraphEdge(row[b], row[a], T, information, uncertain=True)
        graph.edges.append(edge)
    registration.global_optimization(
        graph,
        registration.GlobalOptimizationLevenbergMarquardt(),
        registration.GlobalOptimizationConvergenceCriteria(),
        registration.GlobalOptimizationOption(
            max_correspondence_distance=2 * voxel_size_m, edge_prune_threshold=0.25
        ),
    )
    return {scan: np.array(graph.nodes[row[scan]].pose) for scan in part}


def _by_a_tree(
    part: Sequence[int], edges: Mapping[tuple[int, int], tuple[FloatArray, FloatArray]]
) -> dict[int, FloatArray]:
    """Poses along links from the first scan, those of most information first."""
    poses: dict[int, FloatArray] = {part[0]: np.eye(4)}
    order = sorted(edges, key=lambda key: (-float(np.trace(edges[key][1])), key))
    while len(poses) < len(part):
        a, b = next(key for key in order if (key[0] in poses) != (key[1] in poses))
        T = edges[a, b][0]
        if a in poses:
            poses[b] = poses[a] @ T
        else:
            poses[a] = poses[b] @ invert(T)
    return poses


def _listed(groups: Sequence[Mapping[int, FloatArray]], count: int) -> Placed:
    """Groups as lists, the largest first, and each scan's pose in its first scan's frame."""
    listed = sorted((sorted(group) for group in groups), key=lambda group: (-len(group), group))
    of_scan = {scan: group for group in groups for scan in group}
    firsts = {scan: group[0] for group in listed for scan in group}
    return listed, [invert(of_scan[s][firsts[s]]) @ of_scan[s][s] for s in range(count)]
