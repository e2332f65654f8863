"""What the verdict rests on is found out about the best pose and its rivals."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.registration.aligners import Aligner
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.findings import BLIND_BOTH, MAX_BLIND, Findings
from skipnet.registration.freedom import free_directions, free_turns
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.riding import seen_again
from skipnet.registration.judging.score import CHANCE_SCORE, STRAY_SHARE, Score
from skipnet.registration.judging.sliding import (
    holds_against,
    lies_on_itself,
    moves_freely,
)
from skipnet.registration.verdict import MIN_HELD_VOXELS
from skipnet.types import BoolArray, FloatArray, IntArray

AMBIGUOUS_MARGIN = 0.1
"""A rival whose score comes within this share of the best one's explains the data as well."""
MIN_DECISIVE = 0.2
"""... unless what tells the two apart speaks for the best one as clearly as this."""
CONTRADICTED, MIN_LEAD, MIN_CLEAR = 0.0005, 0.35, 0.15
"""A pose that so many voxels contradict must lead by so much, or differ from its rivals so
clearly. Of 43 poses that differ by less than 0.2 at least three of ten false ones are
found out that way, and one of 33 right ones, between people who passed by, is called in doubt."""
NARROW_LEAD, NARROW_CLEAR = 0.7, 0.45
"""Two narrow views must lead by more then, or differ more clearly: most pairs of such views share
nothing, and bare corners lie on one another; so must what lies on itself. docs/judge.md."""
MOST_RIVALS = 12
"""Rivals with which the best pose is compared voxel by voxel."""
HARMLESS_OVERLAP = 0.2
"""... and so does one that contradicts nothing, if this much agrees and the best pose does ..."""
HARMFUL_VIOLATION = 0.003
"""... contradict what was seen, by this share of all voxels and more."""
REPEATED_SCORE = 0.25
"""A rival that contradicts no more than the best pose may be a repeat of it, moved on or turned,
if it has this share of its score. In simulated rows, racks and pedestals the true pose has 0.3 to
0.8 of a false one's; right poses of rooms and facades have no such rival above 0.2 ..."""
REPEATED_TOTAL = 0.12
"""... and scores so much by itself: where two simulated scans share little, chance alone makes
rivals that score 0.05 to 0.1, nine of ten below this; in what repeats they score 0.14 to 0.7."""
REPEATED_ON_MAP = 0.75
"""Where one scan is blind it must have this share: maps have many clean places."""
REPEATED_SUPPORT = 0.5
"""Where both are nothing contradicts: there it must be the best pose moved on, with this share of
its support ..."""
MORE_MISMATCH = 0.03
"""... and hardly more beside the other scan's surfaces. Of real pairs, simulated ones and the
situations in development no registered right pose has such a rival with more than a quarter of its
support; stairs and rows of trailers have 0.68 and more."""
SAME_TURN_COSINE = float(np.cos(0.05))


def find_out(
    judge: Judge,
    aligner: Aligner,
    best: Refinement,
    score: Score,
    first: int,
    rivals: Rivals,
) -> Findings:
    """What the verdict rests on.

    Args:
        judge, aligner: of both scans.
        best: the best pose, finely aligned.
        score: the judge's figures for all candidates ...
        first: ... of which this is the best pose, as it was before.
        rivals: what the others say.
    """
    T_best, held = best.T_target_source[0], held_voxels(best, 0)
    directions = free_directions(judge, best, aligner.is_sparse)
    in_doubt = len(directions) > 0 or len(rivals.alternatives) > 0
    is_blind = judge.blind > MAX_BLIND  # elsewhere what is odd decides nothing
    # A plane's or a pipe's turns would only repeat its slides; sparse scans' normals are rough.
    no_turns = len(directions) > 0 or aligner.is_sparse
    return Findings(
        overlap=float(score.overlap[first]),
        violation=float(score.violation[first]),
        margin=rivals.margin,
        support=float(score.support[first]),
        decisiveness=rivals.decisiveness,
        mismatch=float(score.mismatch_rate[first]),
        contradiction=float(score.contradiction[first]),
        closeness=judge.closeness(T_best),
        seen_again=seen_again(judge, T_best),
        riding_worth=judge.riding_worth,
        matched=int(best.matched[0]),
        held_voxels=held,
        evenly_held=aligner.evenly_held(T_best) if held < MIN_HELD_VOXELS else held,
        weakest_std_voxels=float(best.weakest_std_m[0]) / judge.voxel_size_m,
        is_sparse=aligner.is_sparse,
        odd_share=aligner.odd_share(T_best) if is_blind and not in_doubt else 0.0,
        is_mirrored=not in_doubt and aligner.is_mirrored(T_best),
        blind=judge.blind,
        are_sided=judge.are_sided,
        covariance=aligner.doubt(held) * best.covariance[0],
        covariance_centre_m=best.centre_m[0],
        free_directions=directions,
        free_turns=np.zeros((0, 3)) if no_turns else free_turns(judge, best),
        alternatives=rivals.alternatives,
    )


@dataclass(frozen=True)
class Rivals:
    """What the best pose's rivals say."""

    margin: float
    """Lead over the best of them, as a share of the own score; 1 without a rival."""
    decisiveness: float
    """The least with which what tells them apart speaks for the best pose; 1 without a rival."""
    alternatives: FloatArray
    """(A, 4, 4) those that explain the data as well."""


def compare_rivals(
    judge: Judge,
    fine: Refinement,
    T_target_source: FloatArray,
    score: Score,
    kept: IntArray,
    are_narrow: bool = False,
    one_will_do: bool = False,
) -> Rivals:
    """Compare the best of (K,) kept poses with the others; where one alternative will do, no more
    are looked for once there is one.

    One that scores nearly as much is as good, unless what tells the two apart speaks for the best
    one, and the rival does not contradict less: the next bay agrees in more where both sensors
    stood alike, and that tells nothing.
    """
    first, rivals = kept[0], kept[1:]
    top = max(float(score.total[first]), 1e-9)
    closest = max(score.total[rivals].max(initial=0.0), CHANCE_SCORE)
    harmless = score.violation[rivals] <= STRAY_SHARE
    harmless &= score.overlap[rivals] >= HARMLESS_OVERLAP
    harmless &= score.violation[first] >= HARMFUL_VIOLATION
    near = rivals[:MOST_RIVALS]
    decisive = judge.decisiveness(T_target_source[first], T_target_source[near])
    contradicts_less = score.violation[near] + STRAY_SHARE < score.violation[first]
    equal = score.total[rivals] > (1 - AMBIGUOUS_MARGIN) * top
    equal[:MOST_RIVALS] &= (decisive < MIN_DECISIVE) | contradicts_less
    if score.violation[first] > CONTRADICTED:
        more = are_narrow or lies_on_itself(score.support[first], held_voxels(fine, first))
        lead, clear = (NARROW_LEAD, NARROW_CLEAR) if more else (MIN_LEAD, MIN_CLEAR)
        close = score.total[near] > (1 - lead) * top
        equal[:MOST_RIVALS] |= close & (decisive < clear)
    if judge.blind > BLIND_BOTH:
        repeated = _moved_on(T_target_source, score, first, rivals)
    else:
        known = equal | harmless
        repeated = _repeats(judge, fine, T_target_source, score, first, rivals, known, one_will_do)
    return Rivals(
        margin=float(max(1 - closest / top, 0.0)),
        decisiveness=float(decisive.min(initial=1.0)),
        alternatives=T_target_source[rivals[equal | harmless | repeated]],
    )


def _repeats(
    judge: Judge,
    fine: Refinement,
    T_target_source: FloatArray,
    score: Score,
    first: int,
    rivals: IntArray,
    known: BoolArray,
    one_will_do: bool,
) -> BoolArray:
    """(R,) which rivals explain the data without an objection, though less of them; not asked of
    those that are known for alternatives anyway.

    Steps, bays, trailers in a row, the sides of a pedestal: the pose that lays most on most is the
    one that brings both sensors to the same place of the pattern, not the right one.
    """
    most = score.contradiction[first] + STRAY_SHARE
    share = REPEATED_ON_MAP if judge.blind > MAX_BLIND else REPEATED_SCORE
    least = max(share * score.total[first], REPEATED_TOTAL)
    repeated: BoolArray = (score.contradiction[rivals] <= most) & (score.total[rivals] >= least)
    repeated &= ~known
    for row in np.flatnonzero(repeated):
        if one_will_do and (known.any() or repeated[:row].any()):
            break
        repeated[row] = not _slips(judge, fine, T_target_source, rivals[row])
    return repeated


def _slips(judge: Judge, fine: Refinement, T_target_source: FloatArray, row: int) -> bool:
    """Whether one candidate is no pose of its own, but a plane laid on a plane anywhere."""
    share, motions = holds_against(fine.information[row], fine.matched[row], fine.spread_m[row])
    weak = share[0] * fine.matched[row] < MIN_HELD_VOXELS
    return bool(weak) and moves_freely(motions[0], T_target_source[row], fine.centre_m[row], judge)


def _moved_on(T_target_source: FloatArray, score: Score, first: int, rivals: IntArray) -> BoolArray:
    """(R,) which rivals are the best pose, moved on, and explain blind scans nearly as well."""
    rotations = T_target_source[rivals, :3, :3].reshape(-1, 9)
    cosine = (rotations @ T_target_source[first, :3, :3].ravel() - 1) / 2
    clean = score.contradiction[rivals] <= score.contradiction[first] + STRAY_SHARE
    clean &= score.mismatch_rate[rivals] <= score.mismatch_rate[first] + MORE_MISMATCH
    enough = score.support[rivals] >= REPEATED_SUPPORT * score.support[first]
    repeated: BoolArray = clean & enough & (cosine > SAME_TURN_COSINE)
    return repeated


def held_voxels(fine: Refinement, row: int) -> float:
    """Voxels, in effect, that hold one pose against the small motion that is held least."""
    share, _ = holds_against(fine.information[row], fine.matched[row], fine.spread_m[row])
    return float(share[0] * fine.matched[row])
