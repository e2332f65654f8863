"""One step of GICP for many poses: the normal equations of point-to-point residuals, each weighed
by the surfaces that both points lie on (Segal et al., RSS 2009)."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.registration.alignment.normal_equations import Matches
from skipnet.scans.sparse import Thinned
from skipnet.types import FloatArray, IntArray


def match_distributions(
    T: FloatArray, source: Thinned, rows: IntArray, target: Thinned, reach_m: float
) -> tuple[Matches, FloatArray]:
    """Nearest points as correspondences, and the normal equations of their residuals.

    Args:
        T: (C, 4, 4) poses of the source in the target's frame.
        source: the points to match ...
        rows: (S,) ... are these of it.
        target: the points to match them with.
        reach_m: the farthest correspondence.

    Returns:
        The equations, and (C,) mean squared Mahalanobis distances of the correspondences.
    """
    points_m = source.points_m[rows]
    moved_m = points_m @ np.swapaxes(T[:, :3, :3], 1, 2) + T[:, None, :3, 3]
    found = target.nearest(moved_m.reshape(-1, 3), reach_m).reshape(len(T), -1)
    own = moved_m, source.covariances[rows]
    theirs = target.points_m, target.covariances
    matches, squared = Matches.none((found >= 0).sum(axis=1)), np.zeros(len(T))
    figures = matches.centre_m, matches.spread_m, matches.information, matches.gradient, squared
    _normal_equations(T, *own, *theirs, found, matches.matched, figures)
    return matches, squared


@compiled
def _normal_equations(
    T_target_source: FloatArray,
    moved_m: FloatArray,
    source_covariances: FloatArray,
    target_m: FloatArray,
    target_covariances: FloatArray,
    row: IntArray,
    matched: IntArray,
    figures: tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray],
) -> None:
    """Centre of the matched points, spread, information and gradient about it, and the mean squares
    of C candidates, into zeros.

    Args:
        T_target_source: (C, 4, 4).
        moved_m: (C, S, 3) the source's points where the poses put them.
        source_covariances: (S, 3, 3) in the source's axes.
        target_m: (M, 3).
        target_covariances: (M, 3, 3).
        row: (C, S) of the target; -1 for no correspondence.
        matched: (C,) how many there are.
        figures: what is filled in.
    """
    centre_m, spread_m, information, gradient, squared = figures
    lever_m, residual_m, weight = np.empty(3), np.empty(3), np.empty((3, 3))
    for c in range(len(row)):
        if matched[c] == 0:
            continue
        for s in range(row.shape[1]):
            if row[c, s] >= 0:
                for i in range(3):
                    centre_m[c, i] += moved_m[c, s, i] / matched[c]
        square_m2 = 0.0
        for s in range(row.shape[1]):
            t = row[c, s]
            if t < 0:
                continue
            for i in range(3):
                lever_m[i] = moved_m[c, s, i] - centre_m[c, i]
                residual_m[i] = target_m[t, i] - moved_m[c, s, i]
                square_m2 += lever_m[i] * lever_m[i]
            _weigh(T_target_source[c], source_covariances[s], target_covariances[t], weight)
            squared[c] += _add(lever_m, residual_m, weight, information[c], gradient[c])
        spread_m[c] = np.sqrt(square_m2 / matched[c])
        squared[c] /= matched[c]


@compiled
def _weigh(
    T_target_source: FloatArray, source: FloatArray, target: FloatArray, weight: FloatArray
) -> None:
    """Inverse of the (3, 3) covariances' sum in the target's axes, into ``weight``."""
    R, m = T_target_source, weight
    for i in range(3):
        for j in range(i + 1):
            total = target[i, j]
            for k in range(3):
                for n in range(3):
                    total += R[i, k] * source[k, n] * R[j, n]
            m[i, j] = total
    a, b, c, d, e, f = m[0, 0], m[1, 0], m[2, 0], m[1, 1], m[2, 1], m[2, 2]
    minor_a, minor_b, minor_c = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * minor_a + b * minor_b + c * minor_c
    m[0, 0], m[1, 1] = minor_a / determinant, (a * f - c * c) / determinant
    m[2, 2] = (a * d - b * b) / determinant
    m[0, 1] = m[1, 0] = minor_b / determinant
    m[0, 2] = m[2, 0] = minor_c / determinant
    m[1, 2] = m[2, 1] = (b * c - a * e) / determinant


@compiled
def _add(
    lever_m: FloatArray,
    residual_m: FloatArray,
    weight: FloatArray,
    information: FloatArray,
    gradient: FloatArray,
) -> float:
    """One correspondence's part of the equations, and its squared Mahalanobis distance.

    A small motion (w, v) moves the point by  w x lever + v:  column i of the Jacobian is the axis i
    crossed with the lever, or the axis itself.
    """
    x, y, z = lever_m
    cross = ((0.0, -z, y), (z, 0.0, -x), (-y, x, 0.0))
    square = 0.0
    for i in range(3):
        pull = 0.0
        for j in range(3):
            pull += weight[i, j] * residual_m[j]
        square += residual_m[i] * pull
        gradient[3 + i] += pull
        for k in range(3):
            gradient[k] += cross[k][i] * pull
            weighted = 0.0
            for j in range(3):
                weighted += weight[i, j] * cross[k][j]
            information[3 + i, k] += weighted
            information[k, 3 + i] += weighted
            for n in range(3):
                information[n, k] += cross[n][i] * weighted
            information[3 + i, 3 + k] += weight[i, k]
    return square
