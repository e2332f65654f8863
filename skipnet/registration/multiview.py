"""Many scans in one frame: register pairs, trust the best of them, balance what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import numpy.typing as npt

from skipnet.config import RegistrationConfig
from skipnet.geometry import (
    invert,
    make_transform,
    rotation_from_vector,
    transform_points,
)
from skipnet.registration.pipeline import clean, register_scans
from skipnet.registration.refinement import refine
from skipnet.registration.scans import Scan, Viewpoint, check_viewpoint, checked, describe
from skipnet.registration.stopwatch import Stopwatch
from skipnet.skipmap.tree import SkipTree
from skipnet.types import FloatArray, Registration

PairKey = tuple[int, int]
"""Numbers of (target, source)."""
Poses = dict[int, FloatArray]
"""Per placed scan its (4, 4) pose in the first scan's frame."""
MAX_CLOSURE_VOXELS = 1.0
"""A pair that puts the centre of its overlap farther off than the more trusted ones do is wrong."""


@dataclass(frozen=True)
class MultiviewResult:
    """Where every scan stands, and what that rests on."""

    T_first_scan: list[FloatArray | None]
    """Per scan the (4, 4) pose in the first scan's frame; None where nothing connects it."""
    pairs: dict[PairKey, Registration]
    """What registering each pair (target, source) gave."""
    closures_m: dict[PairKey, float]
    """Of every registered pair among placed scans: how far its own pose and the final poses put
    the centre of its overlap apart, metres. 0 where nothing else constrains it."""
    rejected: list[PairKey]
    """Registered pairs that contradict more trusted ones and had no say."""
    status: str
    """"registered" when every scan has its place, else "failed"."""
    reason: str
    """One sentence for a person."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """Seconds per stage."""


@dataclass(frozen=True)
class Link:
    """One registered pair as the pose graph sees it."""

    T_target_source: FloatArray
    """(4, 4) measured pose."""
    centre_m: FloatArray
    """(3,) centre of the matched points, target frame."""
    information: FloatArray
    """(6, 6) inverse covariance of (rotation about the centre, translation), target axes."""

    def deviation(self, T_target_source: FloatArray) -> FloatArray:
        """(6,) how another pose differs: rotation about the centre (rad), its shift (m)."""
        from scipy.spatial.transform import Rotation

        change = T_target_source @ invert(self.T_target_source)
        shift_m = transform_points(change, self.centre_m[None])[0] - self.centre_m
        return np.concatenate([Rotation.from_matrix(change[:3, :3]).as_rotvec(), shift_m])


def register_many(
    scans: Sequence[npt.ArrayLike | SkipTree],
    *,
    viewpoints: Sequence[Viewpoint] | None = None,
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
) -> MultiviewResult:
    """Bring scans of one scene into the frame of the first, without a guess.

    Every scan is described once and every pair registered. The registered pairs of most confidence
    that connect the scans place them; the others, where they do not contradict these, balance the
    poses (pose graph, weighted by what each pair determines). Time grows with the square of the
    number of scans.

    Args:
        scans: two or more (N, 3) point clouds, each in its own frame, metres; see
            ``skipnet.register``.
        viewpoints: of each scan as in ``skipnet.register``; None finds all of them out.
        voxel_size_m: edge of a voxel; None chooses it from the data.
        seed: of every random choice.
        config: everything else; None takes the defaults.

    Raises:
        ValueError: fewer than two scans, one that is no point cloud, or viewpoints that do not fit.
    """
    config = config or RegistrationConfig()
    clock = Stopwatch()
    with clock("skip-map"):
        described = _describe_all(scans, viewpoints, voxel_size_m, seed, config)
    with clock("pairs"):
        pairs = {
            (target, source): register_scans(
                described[source], described[target], config, Stopwatch()
            )
            for target, source in combinations(range(len(described)), 2)
        }
    with clock("pose graph"):
        links = {
            (target, source): measure(described[source], described[target], pair.T_target_source)
            for (target, source), pair in pairs.items()
            if pair.status == "registered"
        }
        limit_m = MAX_CLOSURE_VOXELS * described[0].skipmap.voxel_size_m
        poses, agreeing = solve(links, {key: _trust(pairs[key]) for key in links}, limit_m)
        links = {key: link for key, link in links.items() if key[0] in poses and key[1] in poses}
    rejected = [key for key in links if key not in agreeing]
    status, reason = _verdict(poses, len(described), pairs, len(rejected))
    return MultiviewResult(
        T_first_scan=[poses.get(scan) for scan in range(len(described))],
        pairs=pairs,
        closures_m={key: closure_m(link, key, poses) for key, link in links.items()},
        rejected=rejected,
        status=status,
        reason=reason,
        timings_s=clock.seconds,
    )


def measure(source: Scan, target: Scan, T_target_source: FloatArray) -> Link:
    """What a registered pair determines, from its matches at the fine level.

    Args:
        source: described source ...
        target: ... and target.
        T_target_source: (4, 4) pose between the frames that the scans were given in.
    """
    T_own = invert(target.T_given_own) @ T_target_source @ source.T_given_own
    fine = refine(T_own[None], [(source.fine_skipmap, target.fine_skipmap)], max_steps=1)
    turn = np.kron(np.eye(2), target.T_given_own[:3, :3])
    return Link(
        T_target_source,
        transform_points(target.T_given_own, fine.centre_m)[0],
        turn @ fine.information[0] @ turn.T,
    )


def solve(
    links: Mapping[PairKey, Link], trust: Mapping[PairKey, tuple[float, ...]], limit_m: float
) -> tuple[Poses, set[PairKey]]:
    """Place scans along the most trusted tree, then balance them with all that agrees with it.

    Args:
        links: every registered pair.
        trust: of each; larger is better.
        limit_m: a link whose overlap the tree puts farther off has no say.

    Returns:
        Poses of the scans that are connected with scan 0, and the links that had a say.
    """
    poses = place(spanning_tree(trust), links)
    agreeing = {
        key: link
        for key, link in links.items()
        if key[0] in poses and key[1] in poses and closure_m(link, key, poses) <= limit_m
    }
    return balance(poses, agreeing), set(agreeing)


def spanning_tree(trust: Mapping[PairKey, tuple[float, ...]]) -> list[PairKey]:
    """The pairs of most trust that connect scan 0 with all it can reach, in the order of growth.

    >>> spanning_tree({(0, 1): (0.9,), (0, 2): (0.5,), (1, 2): (0.8,), (3, 4): (1.0,)})
    [(0, 1), (1, 2)]
    """
    reached: set[int] = {0}
    tree: list[PairKey] = []
    while True:
        frontier = [key for key in trust if (key[0] in reached) != (key[1] in reached)]
        if not frontier:
            return tree
        tree.append(max(frontier, key=lambda key: trust[key]))
        reached.update(tree[-1])


def place(tree: Sequence[PairKey], links: Mapping[PairKey, Link]) -> Poses:
    """Poses of the scans that the tree reaches, multiplied up along it."""
    poses: Poses = {0: np.eye(4)}
    for target, source in tree:
        T_target_source = links[target, source].T_target_source
        if target in poses:
            poses[source] = poses[target] @ T_target_source
        else:
            poses[target] = poses[source] @ invert(T_target_source)
    return poses


def closure_m(link: Link, key: PairKey, poses: Poses) -> float:
    """How far poses put the centre of a pair's overlap from where the pair itself does, metres."""
    return float(np.linalg.norm(link.deviation(_relative(poses, key))[3:]))


def balance(poses: Poses, links: Mapping[PairKey, Link]) -> Poses:
    """Spread the contradictions of loops over all links by what each determines (pose graph).

    Minimises the sum of deviation^T information deviation over the links (Lu & Milios, 1997), by
    SciPy's least squares; the first scan stays.

    Args:
        poses: where to start from; scan 0 is among them.
        links: registered pairs among these scans.
    """
    from scipy.optimize import least_squares

    free = [scan for scan in poses if scan > 0]
    if len(links) <= len(free):
        return poses  # a tree: nothing contradicts anything
    roots = {key: _square_root(link.information) for key, link in links.items()}

    def moved(steps: FloatArray) -> Poses:
        """The poses after (6 K,) steps: of each free scan, a rotation vector and a shift."""
        result = dict(poses)
        for scan, step in zip(free, steps.reshape(-1, 6), strict=True):
            rotation = rotation_from_vector(step[:3]) @ poses[scan][:3, :3]
            result[scan] = make_transform(rotation, poses[scan][:3, 3] + step[3:])
        return result

    def residuals(steps: FloatArray) -> FloatArray:
        """(6 L,) deviations of all links after the steps, in standard deviations."""
        current = moved(steps)
        deviations = (
            roots[key] @ link.deviation(_relative(current, key)) for key, link in links.items()
        )
        return np.concatenate(list(deviations))

    return moved(least_squares(residuals, np.zeros(6 * len(free)), x_scale="jac").x)


def _relative(poses: Poses, key: PairKey) -> FloatArray:
    """(4, 4) T_target_source between two placed scans."""
    target, source = key
    return invert(poses[target]) @ poses[source]


def _square_root(information: FloatArray) -> FloatArray:
    """A matrix W with W^T W = information."""
    values, vectors = np.linalg.eigh(information)
    return np.sqrt(np.maximum(values, 0.0))[:, None] * vectors.T


def _describe_all(
    scans: Sequence[npt.ArrayLike | SkipTree],
    viewpoints: Sequence[Viewpoint] | None,
    voxel_size_m: float | None,
    seed: int,
    config: RegistrationConfig,
) -> list[Scan]:
    if len(scans) < 2:
        raise ValueError(f"got {len(scans)} scans: expected two or more")
    if viewpoints is None:
        viewpoints = ["auto"] * len(scans)
    if len(viewpoints) != len(scans):
        raise ValueError(
            f"got {len(viewpoints)} viewpoints for {len(scans)} scans: expected one each"
        )
    for number, viewpoint in enumerate(viewpoints):
        check_viewpoint(viewpoint, f"viewpoints[{number}]")
    clouds_m = [
        clean(checked(scan, f"scans[{number}]"), config) for number, scan in enumerate(scans)
    ]
    return describe(clouds_m, viewpoints, voxel_size_m, seed)


def _trust(pair: Registration) -> tuple[float, float]:
    """Confidence to two digits, then overlap: near-certain pairs differ in what they share."""
    return round(pair.confidence, 2), float(str(pair.details["overlap"]))


def _verdict(
    poses: Poses, count: int, pairs: Mapping[PairKey, Registration], rejected: int
) -> tuple[str, str]:
    lost = [scan for scan in range(count) if scan not in poses]
    registered = sum(pair.status == "registered" for pair in pairs.values())
    found = f"{registered} of {len(pairs)} pairs registered"
    if rejected:
        found += f", {rejected} of them rejected because others contradict them"
    if not lost:
        return "registered", f"{found}; they connect all {count} scans"
    names = ", ".join(str(scan) for scan in lost)
    plural = "scans" if len(lost) > 1 else "scan"
    return "failed", f"{found}; nothing connects {plural} {names} with scan 0"
