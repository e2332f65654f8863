"""What is known about the best pose when the verdict is due."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from skipnet.registration.judging.furnishing import Furnishing
from skipnet.registration.judging.pieces import Pieces
from skipnet.registration.judging.riding import MIN_RIDING, MIN_SEEN_AGAIN
from skipnet.registration.judging.score import STRAY_SHARE
from skipnet.registration.judging.sides import Before
from skipnet.registration.judging.sliding import lies_on_itself
from skipnet.types import FloatArray

SAFE_MARGIN = 0.3
"""With less, a pose that leaves the sensors together may owe its lead to what looks alike there."""
MAX_BLIND = 0.25
"""Scans are blind when one of them is more than half so."""
BLIND_BOTH = 0.6
"""... and with more than this, neither of them sees what would contradict a pose."""

MIN_BLIND_SUPPORT = 0.2
"""Of 56 right answers that were registered without a viewpoint, simulated ones and development
pairs, none had less than 0.26; a figure that far clutter led astray had 0.16."""

CLEAN_MISMATCH, CLEAN_CLOSENESS = 0.06, 0.85
"""Where two simulated scans share little, what is right lies beside no other surface and agrees
closely; what is wrong does not, or contradicts what was seen: of poses with a confidence of 0.3 to
0.55 that nothing else calls in doubt 12 of 13 right ones are clean, and none of 11 wrong ones."""
MIN_SIDED_SUPPORT, MAX_SIDED_MISMATCH = 0.12, 0.15
"""Where the sides are known less support will do if little lies beside, and what agrees is close.
Of 96 simulated pairs of figures seen from unknown places 13 of 16 right poses of little support are
so, and none of 10 wrong ones; of 96 others 13 of 14, and one of 12. Right ones have a mismatch of
0.118 at most, wrong ones so close 0.18 and more; one of 48 more had a support of 0.113."""

FORCED_MISMATCH, FORCED_CLOSENESS = 0.2, 0.75
"""Where more of what comes near lies beside, and less of what agrees does so closely, surfaces are
forced together: of 529 answers of all kinds three were registered so, all wrong; of 96 others
none, nor was any right pose."""

_SEEN = ("support", "margin", "held")
FEATURES = ("violation", *_SEEN, "blind", *(f"blind_{name}" for name in _SEEN))
"""What the confidence is made of."""
FIRMLY_HELD_VOXELS = 99.0
"""More than this says nothing more."""
MOST_HELD = float(np.log10(1 + FIRMLY_HELD_VOXELS))
"""The most that the feature "held" can be."""


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
        "covariance_centre_m",
        "blind",
        "free_directions",
        "free_turns",
        "alternatives_T_target_source",
        "surfaces_part_at_m",
        "stands_before_share",
        "stands_before_at_m",
        "small_things_again",
        "small_things_gone_at_m",
        "pieces_again",
        "pieces_gone_at_m",
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
    contradiction: float
    """As ``violation``, voxels counted by what they are worth."""
    closeness: float
    """Share of what agrees that does so closely, see ``closer_look``; 1 where nobody can tell."""
    seen_again: float
    """Where the pose leaves both sensors at one place: the share of what stands out afar that both
    scans have; 1 otherwise."""
    riding_worth: float
    """Voxels' worth of what lies near both sensors at the same place, as what rides along does."""
    matched: int
    """Correspondences of the fine alignment."""
    held_voxels: float
    """Voxels, in effect, that face the motion against which the pose is held least."""
    weakest_std_voxels: float
    """Standard deviation of that motion, in voxels, as the matched surfaces' scatter has it."""
    evenly_held: float
    """As ``held_voxels``, each counted alike; asked where these are few."""
    is_sparse: bool
    """One of the scans is: its normals are rough."""
    odd_share: float
    """Share of what agrees that lies off by far more than the rest: what is alike, not equal; 0
    where the pose is in doubt anyway, or both sensors' places are known."""
    is_mirrored: bool
    """The source's mirror image explains the target clearly better."""
    blind: float
    """Share of the two scans whose viewpoint is unknown: they contradict nothing."""
    are_sided: bool
    """Of both scans it is known from which side their surfaces were seen, if not from where."""
    covariance: FloatArray
    """(6, 6) of the pose: rotation (rad) about the matched surfaces' centre, then how far this is
    off (m), in the target's axes."""
    covariance_centre_m: FloatArray
    """(3,) that centre, in the target's frame."""
    free_directions: FloatArray
    """(F, 3) unit directions in the target's frame along which the data let the pose slide."""
    free_turns: FloatArray
    """(F, 3) unit axes in the target's frame about which the data let the pose turn."""
    alternatives: FloatArray
    """(A, 4, 4) distinct poses that explain the data as well."""
    forks_m: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    """(P, 3) where the scans' surfaces part, in the target's frame; see ``judging.forks``. Asked of
    scans that are both blind, and of poses that would be registered."""
    before: Before = field(default_factory=Before.none)
    """What stands before the side that a scan shows; asked of poses that would be registered."""
    typical_offset: float = 0.0
    """How far off half of what agrees lies at least, in standard deviations of the points about
    their surfaces; asked where a pose would be registered and not both sensors' places are known.
    """
    furnishing: Furnishing = field(default_factory=Furnishing.none)
    """What the small things say of the pose; asked where both sensors' places are known."""
    pieces: Pieces = field(default_factory=Pieces.none)
    """What the scans differ by in small pieces; asked where they are exact as well."""

    @property
    def is_blind(self) -> bool:
        """So little is known of what the sensors saw as free that wrong poses go uncontradicted."""
        return self.blind > MAX_BLIND

    @property
    def has_too_little(self) -> bool:
        """Nothing would contradict the pose, and too little speaks for it."""
        little = self.blind > BLIND_BOTH and self.support < MIN_BLIND_SUPPORT
        close = self.closeness >= CLEAN_CLOSENESS and self.mismatch <= MAX_SIDED_MISMATCH
        enough = self.are_sided and close and self.support >= MIN_SIDED_SUPPORT
        return little and not enough

    @property
    def is_forced(self) -> bool:
        """Much of what comes near the other scan lies beside it, what agrees does so loosely."""
        return self.mismatch > FORCED_MISMATCH and self.closeness < FORCED_CLOSENESS

    @property
    def is_clean(self) -> bool:
        """It is known from where, or from which side, both scans were taken, and nothing at all
        speaks against the pose."""
        clean = self.contradiction <= STRAY_SHARE and self.mismatch <= CLEAN_MISMATCH
        clean = clean and self.closeness >= CLEAN_CLOSENESS
        return clean and (self.are_sided or not self.is_blind)

    @property
    def lies_on_itself(self) -> bool:
        """See the function."""
        return lies_on_itself(self.support, self.held_voxels)

    @property
    def may_only_ride(self) -> bool:
        """Both sensors would have stood at one place, and yet have seen different things: rings on
        flat ground, what rides along, or what repeats, may be all that speaks for it."""
        may_ride = self.is_sparse or self.riding_worth > MIN_RIDING or self.margin < SAFE_MARGIN
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
            self.covariance_centre_m.tolist(),
            self.blind,
            self.free_directions.tolist(),
            self.free_turns.tolist(),
            self.alternatives.tolist(),
            self.forks_m.tolist(),
            self.before.share,
            self.before.at_m.tolist(),
            self.furnishing.again,
            self.furnishing.gone_m.tolist(),
            self.pieces.again,
            self.pieces.gone_m.tolist(),
        )
        return dict(zip(self.JSON_NAMES, values, strict=True))

    @property
    def features(self) -> FloatArray:
        """(F,) what the confidence is computed from, in the order of ``FEATURES``."""
        held = np.log10(1 + min(self.held_voxels, FIRMLY_HELD_VOXELS))
        seen = np.array([self.support, self.margin, held])
        # Without free space the other figures must say more: they get weights of their own.
        return np.concatenate([[np.sqrt(self.violation)], seen, [self.blind], self.blind * seen])
