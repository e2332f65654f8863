"""The pose graph: links between scans, a tree of the most trusted, what is left over balanced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, make_transform, rotation_from_vector, transform_points
from skipnet.registration.alignment.refinement import refine
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray

PairKey = tuple[int, int]
"""Numbers of (target, source)."""
Poses = dict[int, FloatArray]
"""Per placed scan its (4, 4) pose in the first scan's frame."""


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
