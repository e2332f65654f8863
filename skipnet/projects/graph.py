"""The pose graph: where scans stand when all links between them are weighed against each other.

Gauss-Newton on sparse normal equations (Lu & Milios, 1997) with a robust kernel: truncated least
squares by graduated non-convexity (Yang, Antonante, Tzoumas & Carlone, RA-L 2020).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import invert, make_transform, rotation_from_vector, transform_points
from skipnet.projects.ways import PairKey
from skipnet.types import FloatArray, IntArray

Poses = Mapping[int, FloatArray]
"""Per placed scan its (4, 4) pose in the frame of its group's first scan."""
TYPICAL_SQUARE = 5.35
"""Median of chi squared with six degrees of freedom, which scales links that claim too much."""
FARTHEST_SQUARE = 50.0
"""Links that deviate by more have no say. Chance gives one of a hundred million; half as much would
be chance enough, were the median not that of residuals, which loops make smaller than errors."""
GROWTH = 1.4
"""By which the kernel becomes less convex at each round."""
MAX_ROUNDS = 60
MAX_STEPS = 8
"""Gauss-Newton steps before the first round; every round takes one more."""
_STILL = 1e-10
"""Radians and metres by which a step moves nothing any more."""
_LOOSE = 1e-9
"""Share of the mean information that every scan has in itself, lest a loose one run away."""


@dataclass(frozen=True)
class Link:
    """What a pair of scans says of its relative pose."""

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


@dataclass(frozen=True)
class Balance:
    """Balanced poses and what they rest on."""

    poses: Mapping[int, FloatArray]
    """(4, 4) per scan; the first one stays where it was."""
    weights: Mapping[PairKey, float]
    """Of each link: 1 it has its full say, 0 it contradicts the others and has none."""
    covariances: Mapping[int, FloatArray]
    """(6, 6) per scan of (rotation, translation) about its own origin, group axes, scaled by how
    well the links agree; 0 for the first."""


def relative(poses: Poses, key: PairKey) -> FloatArray:
    """(4, 4) T_target_source between two placed scans."""
    target, source = key
    return invert(poses[target]) @ poses[source]


def closure_m(link: Link, key: PairKey, poses: Poses) -> float:
    """How far poses put the centre of a pair's overlap from where the pair itself does, metres."""
    return float(np.linalg.norm(link.deviation(relative(poses, key))[3:]))


def balance(poses: Poses, links: Mapping[PairKey, Link]) -> Balance:
    """Spread the contradictions of loops over all links by what each determines.

    Args:
        poses: where to start from; the lowest number stays.
        links: between these scans; together they connect them.
    """
    if not links:
        return Balance(dict(poses), {}, dict.fromkeys(poses, np.zeros((6, 6))))
    graph = _Graph(dict(poses), dict(links))
    weights: FloatArray = np.ones(len(links))
    for _ in range(MAX_STEPS):
        if graph.step(weights) < _STILL:
            break
    weights = graph.graduate()
    return Balance(
        graph.poses,
        dict(zip(graph.keys, weights.tolist(), strict=True)),
        graph.covariances(weights),
    )


class _Graph:
    """Poses that move, links that stay."""

    def __init__(self, poses: dict[int, FloatArray], links: dict[PairKey, Link]) -> None:
        self.poses = poses
        self.keys = sorted(links)
        self._links = [links[key] for key in self.keys]
        self._row = {scan: row for row, scan in enumerate(sorted(poses))}
        self._information = np.array([link.information for link in self._links])
        self._inverse_measured = invert(np.array([link.T_target_source for link in self._links]))
        self._centres_m = np.array([link.centre_m for link in self._links])
        self._ends: IntArray = np.array([[self._row[t], self._row[s]] for t, s in self.keys])

    def deviations(self) -> FloatArray:
        """(L, 6) of all links, as ``Link.deviation`` has them."""
        from scipy.spatial.transform import Rotation

        T = np.array([self.poses[scan] for scan in sorted(self.poses)])
        found = invert(T[self._ends[:, 0]]) @ T[self._ends[:, 1]]
        change = found @ self._inverse_measured
        shift_m = np.einsum("lij,lj->li", change[:, :3, :3], self._centres_m) + change[:, :3, 3]
        turns = Rotation.from_matrix(change[:, :3, :3]).as_rotvec()
        return np.hstack([turns, shift_m - self._centres_m])

    def squares(self) -> FloatArray:
        """(L,) squared deviations in standard deviations, as the links claim them."""
        found = self.deviations()
        squares: FloatArray = np.einsum("li,lij,lj->l", found, self._information, found)
        return squares

    def graduate(self) -> FloatArray:
        """(L,) weights of truncated least squares, reached from the convex side."""
        squares = self.squares()
        limit = FARTHEST_SQUARE * _scale(squares)
        if squares.max() <= limit:
            return np.ones(len(squares))
        mu = limit / (2 * squares.max() - limit)
        for _ in range(MAX_ROUNDS):
            weights = _truncated(squares, limit, mu)
            self.step(weights)
            squares = self.squares()
            limit = FARTHEST_SQUARE * _scale(squares[weights > 0])
            mu *= GROWTH
            if ((weights == 0) | (weights == 1)).all():
                break
        for _ in range(MAX_STEPS):  # who agrees in the end has a say, whatever happened on the way
            squares = self.squares()
            weights = (squares <= FARTHEST_SQUARE * _scale(squares[weights > 0])).astype(float)
            if self.step(weights) < _STILL:
                break
        return weights

    def step(self, weights: FloatArray) -> float:
        """Move the poses by one Gauss-Newton step; return the largest motion."""
        from scipy.sparse.linalg import splu

        matrix, gradient = self._normal_equations(weights)
        steps = np.concatenate([np.zeros(6), splu(matrix).solve(-gradient)]).reshape(-1, 6)
        for scan, row in self._row.items():
            T = self.poses[scan]
            turned = rotation_from_vector(steps[row, :3]) @ T[:3, :3]
            self.poses[scan] = make_transform(turned, T[:3, 3] + steps[row, 3:])
        return float(np.abs(steps).max())

    def covariances(self, weights: FloatArray) -> dict[int, FloatArray]:
        """Of each scan's pose, from the inverse of the information."""
        from scipy.sparse.linalg import splu

        squares = self.squares()[weights > 0]
        scale = max(1.0, _scale(squares)) if len(squares) else 1.0
        matrix, _ = self._normal_equations(weights)
        solver = splu(matrix)
        result: dict[int, FloatArray] = {min(self.poses): np.zeros((6, 6))}
        for scan, row in self._row.items():
            if row > 0:
                unit = np.zeros((matrix.shape[0], 6))
                unit[6 * (row - 1) : 6 * row] = np.eye(6)
                result[scan] = scale * solver.solve(unit)[6 * (row - 1) : 6 * row]
        return result

    def _normal_equations(self, weights: FloatArray):  # type: ignore[no-untyped-def]
        """Sparse matrix and gradient over all scans but the first."""
        from scipy.sparse import coo_matrix

        jacobians = self._jacobians()
        weighted = weights[:, None, None] * self._information
        blocks = np.einsum("laji,ljk,lbkm->labim", jacobians, weighted, jacobians)
        towards = np.einsum("laji,ljk,lk->lai", jacobians, weighted, self.deviations())
        size = 6 * len(self._row)
        columns = 6 * self._ends[..., None] + np.arange(6)
        rows = np.broadcast_to(columns[:, :, None, :, None], blocks.shape)
        across = np.broadcast_to(columns[:, None, :, None, :], blocks.shape)
        entries = (blocks.ravel(), (rows.ravel(), across.ravel()))
        matrix = coo_matrix(entries, shape=(size, size)).tocsc()[6:, 6:]
        gradient = np.bincount(columns.ravel(), towards.ravel(), minlength=size)[6:]
        diagonal = matrix.diagonal()
        loose = coo_matrix(
            (np.full(size - 6, _LOOSE * max(diagonal.mean(), 1e-12)), (range(size - 6),) * 2)
        )
        return (matrix + loose).tocsc(), gradient

    def _jacobians(self) -> FloatArray:
        """(L, 2, 6, 6) of the deviations by small motions of (target, source).

        A scan's motion turns it about its own origin and shifts it, both in the group's axes.
        """
        T_t = np.array([self.poses[target] for target, _ in self.keys])
        origins_m = np.array([self.poses[scan][:3, 3] for scan in sorted(self.poses)])
        centres_m = np.einsum("lij,lj->li", T_t[:, :3, :3], self._centres_m) + T_t[:, :3, 3]
        back = np.swapaxes(T_t[:, :3, :3], 1, 2)
        result = np.zeros((len(self.keys), 2, 6, 6))
        for end, sign in ((0, -1.0), (1, 1.0)):
            lever_m = centres_m - origins_m[self._ends[:, end]]
            result[:, end, :3, :3] = sign * back
            result[:, end, 3:, 3:] = sign * back
            result[:, end, 3:, :3] = -sign * back @ _cross(lever_m)
        return result


def _truncated(squares: FloatArray, limit: float, mu: float) -> FloatArray:
    """(L,) weights of the graduated kernel (equation 14 of the paper)."""
    low, high = mu / (mu + 1) * limit, (mu + 1) / mu * limit
    between = np.sqrt(limit * mu * (mu + 1) / np.maximum(squares, 1e-300)) - mu
    weights: FloatArray = np.where(squares <= low, 1.0, np.where(squares >= high, 0.0, between))
    return weights.clip(0.0, 1.0)


def _scale(squares: FloatArray) -> float:
    """By how much links understate their variance, from what most of them deviate."""
    return max(float(np.median(squares)) / TYPICAL_SQUARE, 1.0)


def _cross(vectors: FloatArray) -> FloatArray:
    """(..., 3, 3) matrices M with M x = vector cross x."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    matrices: FloatArray = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return matrices
