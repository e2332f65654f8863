"""What is known about the best pose when the verdict is due."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from skipnet.registration.aligners import Aligner
from skipnet.registration.alignment.refinement import Refinement
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.riding import MIN_RIDING, MIN_SEEN_AGAIN, seen_again
from skipnet.registration.judging.score import STRAY_SHARE, Score
from skipnet.registration.judging.sliding import (
    MIN_DETERMINED,
    holds,
    holds_against,
    is_weak,
    moves_freely,
)
from skipnet.types import FloatArray, IntArray

AMBIGUOUS_LEAD = 0.1
"""A rival whose score comes within this share of the best one's explains the data as well."""
SAFE_LEAD = 0.3
"""With less, a pose that leaves the sensors together may owe its lead to what looks alike there."""
MAX_BLIND = 0.25
"""Scans are blind when one of them is more than half so."""
MIN_DECISIVE = 0.2
"""... unless what tells the two apart speaks for the best one as clearly as this."""
MOST_RIVALS = 12
"""Rivals with which the best pose is compared voxel by voxel."""
HARMLESS_OVERLAP = 0.2
"""... and so does one that contradicts nothing, if this much agrees and the best pose does ..."""
HARMFUL_VIOLATION = 0.003
"""... contradict what was seen, by this share of all voxels and more."""
CHANCE_SCORE = 0.05
"""What some pose always scores: a lead counts against this, though no rival be found."""
MIN_THICKNESS_VOXELS = 0.5
"""A scan whose voxels scatter by less about their plane is that plane."""
MIN_SPARSE_HOLD = 6.0
"""Voxels that must face a direction in sparse scans: their normals err, and fewer hold nothing."""

_SEEN = ("support", "margin", "held")
FEATURES = ("violation", *_SEEN, "blind", *(f"blind_{name}" for name in _SEEN))
"""What the confidence is made of."""
FIRMLY_HELD_VOXELS = 99.0
"""More than this says nothing more."""


@dataclass(frozen=True)
class Findings:
    """What is known about the best pose when the verdict is due."""

    JSON_NAMES: ClassVar[tuple[str, ...]] = (
        "overlap",
        "violation",
        "margin",
        "support",
        "decisiveness",
        "mismatch",
        "seen_again",
        "riding_worth",
        "odd_share",
        "is_mirrored",
        "matched_voxels",
        "held_voxels",
        "position_std_m",
        "rotation_std_rad",
        "covariance",
        "blind",
        "free_directions",
        "free_turns",
        "alternatives_T_target_source",
    )
    """Keys of ``as_json``."""

    overlap: float
    """Mean of both ways' matched shares."""
    violation: float
    """Mean of both ways' shares in seen free space."""
    margin: float
    """Lead over the best distinct alternative's score, as a share of the own; 1 without a rival."""
    support: float
    """As ``overlap``, voxels counted by what they are worth as evidence."""
    decisiveness: float
    """How clearly the voxels on which the best pose and its nearest rival differ speak for it, -1
    to 1; 1 without a rival."""
    mismatch: float
    """Of what comes near the other scan's surface, the share of the worth that lies beside it."""
    seen_again: float
    """Where the pose leaves both sensors at one place: the share of what stands out afar that both
    scans have; 1 otherwise."""
    riding_worth: float
    """Voxels' worth of what lies near both sensors at the same place, as what rides along does."""
    matched: int
    """Correspondences of the fine alignment."""
    held_voxels: float
    """Voxels, in effect, that face the motion against which the pose is held least."""
    is_sparse: bool
    """One of the scans is: its normals are rough."""
    odd_share: float
    """Share of what agrees that lies off by far more than the rest: what is alike, not equal; 0
    where the pose is in doubt anyway."""
    is_mirrored: bool
    """The source's mirror image explains the target clearly better."""
    blind: float
    """Share of the two scans whose viewpoint is unknown: they contradict nothing."""
    covariance: FloatArray
    """(6, 6) of the pose as the matched surfaces' scatter predicts it: rotation (rad) about their
    centre, then translation (m), in the target's axes."""
    free_directions: FloatArray
    """(F, 3) unit directions in the target's frame along which the data let the pose slide."""
    free_turns: FloatArray
    """(F, 3) unit axes in the target's frame about which the data let the pose turn."""
    alternatives: FloatArray
    """(A, 4, 4) distinct poses that explain the data as well."""

    @property
    def is_blind(self) -> bool:
        """So little is known of what the sensors saw as free that wrong poses go uncontradicted."""
        return self.blind > MAX_BLIND

    @property
    def may_only_ride(self) -> bool:
        """Both sensors would have stood at one place, and yet have seen different things: rings on
        flat ground, what rides along, or what repeats, may be all that speaks for it."""
        may_ride = self.is_sparse or self.riding_worth > MIN_RIDING or self.margin < SAFE_LEAD
        return self.seen_again < MIN_SEEN_AGAIN and may_ride

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the matched surfaces' centre."""
        return float(np.sqrt(np.trace(self.covariance[3:, 3:])))

    @property
    def rotation_std_rad(self) -> float:
        """Standard deviation of the rotation."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3])))

    @property
    def as_json(self) -> dict[str, object]:
        """The same as plain numbers and lists, in the order of ``JSON_NAMES``."""
        values = (
            self.overlap,
            self.violation,
            self.margin,
            self.support,
            self.decisiveness,
            self.mismatch,
            self.seen_again,
            self.riding_worth,
            self.odd_share,
            self.is_mirrored,
            self.matched,
            self.held_voxels,
            self.position_std_m,
            self.rotation_std_rad,
            self.covariance.tolist(),
            self.blind,
            self.free_directions.tolist(),
            self.free_turns.tolist(),
            self.alternatives.tolist(),
        )
        return dict(zip(self.JSON_NAMES, values, strict=True))

    @property
    def features(self) -> FloatArray:
        """(F,) what the confidence is computed from, in the order of ``FEATURES``."""
        held = np.log10(1 + min(self.held_voxels, FIRMLY_HELD_VOXELS))
        seen = np.array([self.support, self.margin, held])
        # Without free space the other figures must say more: they get weights of their own.
        return np.concatenate([[np.sqrt(self.violation)], seen, [self.blind], self.blind * seen])


def find_out(
    judge: Judge,
    aligner: Aligner,
    best: Refinement,
    T_target_source: FloatArray,
    score: Score,
    kept: IntArray,
) -> Findings:
    """What the verdict rests on.

    Args:
        judge: of both scans.
        aligner: likewise.
        best: the best pose, finely aligned.
        T_target_source: (K, 4, 4) all refined candidates.
        score: the judge's figures for these.
        kept: rows of the distinct ones, best first.
    """
    first, rivals, T_best = kept[0], kept[1:], best.T_target_source[0]
    top = max(float(score.total[first]), 1e-9)
    lead = 1 - score.total[rivals] / top
    harmless = score.violation[rivals] <= STRAY_SHARE
    harmless &= score.overlap[rivals] >= HARMLESS_OVERLAP
    harmless &= score.violation[first] >= HARMFUL_VIOLATION
    closest = max(score.total[rivals].max(initial=0.0), CHANCE_SCORE)
    decisive = judge.decisiveness(T_target_source[first], T_target_source[rivals[:MOST_RIVALS]])
    equal = lead < AMBIGUOUS_LEAD
    equal[:MOST_RIVALS] &= decisive < MIN_DECISIVE
    directions = _free_directions(judge, best, aligner.is_sparse)
    share, _ = holds_against(best.information[0], best.matched[0], best.spread_m[0])
    in_doubt = len(directions) > 0 or bool((equal | harmless).any())
    return Findings(
        overlap=float(score.overlap[first]),
        violation=float(score.violation[first]),
        margin=float(max(1 - closest / top, 0.0)),
        support=float(score.support[first]),
        decisiveness=float(decisive.min(initial=1.0)),
        mismatch=float(score.mismatch_rate[first]),
        seen_again=seen_again(judge, T_best),
        riding_worth=judge.riding_worth,
        matched=int(best.matched[0]),
        held_voxels=float(share[0] * best.matched[0]),
        is_sparse=aligner.is_sparse,
        odd_share=0.0 if in_doubt else aligner.odd_share(T_best),
        is_mirrored=not in_doubt and aligner.is_mirrored(T_best),
        blind=1 - 0.5 * (judge.source.trust + judge.target.trust),
        covariance=best.covariance[0],
        free_directions=directions,
        # A plane's or a pipe's turns would only repeat its slides; sparse scans' normals are rough.
        free_turns=np.zeros((0, 3))
        if len(directions) or aligner.is_sparse
        else _free_turns(judge, best),
        alternatives=T_target_source[rivals[equal | harmless]],
    )


def _free_directions(judge: Judge, best: Refinement, is_sparse: bool) -> FloatArray:
    """(F, 3) directions along which one pose can slide, in the target's frame.

    Noise may roughen a scan that shows nothing but one plane; it holds nothing all the same.
    """
    turns = best.T_target_source[0, :3, :3], np.eye(3)
    for scan, turn in zip((judge.source, judge.target), turns, strict=True):
        square_m2, axes = np.linalg.eigh(np.cov(scan.points_m.T.astype(np.float64)))
        if np.sqrt(square_m2[0]) < MIN_THICKNESS_VOXELS * judge.voxel_size_m:
            in_plane: FloatArray = (turn @ axes[:, 1:]).T
            return in_plane
    T, centre_m = best.T_target_source[0], best.centre_m[0]
    share, directions = holds(best.information[0], best.matched[0])
    free = [
        direction
        for part, direction in zip(share, directions, strict=True)
        if is_weak(part, best.matched[0])
        and (
            (is_sparse and part * best.matched[0] < MIN_SPARSE_HOLD)
            or moves_freely(np.append(np.zeros(3), direction), T, centre_m, judge)
        )
    ]
    return np.array(free).reshape(-1, 3)


def _free_turns(judge: Judge, best: Refinement) -> FloatArray:
    """(G, 3) axes about which one pose can turn."""
    T, centre_m = best.T_target_source[0], best.centre_m[0]
    share, motions = holds_against(best.information[0], best.matched[0], best.spread_m[0])
    weak = motions[(share < MIN_DETERMINED) & motions[:, :3].any(axis=1)]
    turns = [
        motion[:3] / np.linalg.norm(motion[:3])
        for motion in weak
        if moves_freely(motion, T, centre_m, judge)
    ]
    return np.array(turns).reshape(-1, 3)
