"""The verdict: registered, ambiguous or failed, a calibrated confidence, a reason in words."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from skipnet.registration.findings import (
    BLIND_BOTH,
    CLEAN_MISMATCH,
    FEATURES,
    MOST_HELD,
    Findings,
)
from skipnet.registration.judging.score import CHANCE_SCORE, STRAY_SHARE, Score
from skipnet.types import FloatArray, Status

CALIBRATION_FILE = Path(__file__).parent / "confidence.json"
MIN_CONFIDENCE = 0.55
"""A pose must be more likely right than wrong to count as registered, by some margin: of 226
simulated answers, each judged by a fit that had not seen it, 89 were registered rightly and 2
wrongly; with 0.5 it were 91 and 3, with 0.6 87 and 2."""
CLEAN_GAIN = 1.0
"""By how much the logit of the confidence is more for a pose against which nothing speaks: the fit
asks for support, which two scans that share little cannot give. See ``CLEAN_MISMATCH``."""
MAX_VIOLATION = 0.02
"""Scans of one shell with other furniture contradict each other by 2.9 % and more, whatever else
agrees; right poses of dense scans with passers-by by up to 1.6 %. Scans of few lines with many
passers-by reach 6 %, and are refused: rather that than a wrong room."""
MAX_ODD_SHARE = 0.035
"""Right poses of simulated dense scans have at most 0.006, of real ones at most 0.024; other
specimens and mirror images of simulated arches 0.05 to 0.14."""
VERY_EXACT, MAX_ODD_IF_EXACT = 0.98, 0.015
"""Where so much of what agrees does so closely (``Findings.closeness``) even less may be odd: there
right simulated poses have at most 0.003, half-blind real ones 0.010, and other specimens whose
blocks stand but a little otherwise 0.024 and more."""
MAX_ODD_IF_BLIND = 0.01
"""... and where neither sensor's place is known 0.0067, of 53 right simulated poses, sensors'
places withheld; a wheel turned by some of its equal teeth has 0.012."""
MAX_TYPICAL_OFFSET = 3.0
"""Under 77 right simulated poses of scans of which one has no known place half of what agrees lies
off by 0.7 standard deviations at most, of real figures on a turntable by 1.3; two blocks of which
one is a thirtieth larger by 7.6."""
MIN_HELD_VOXELS = 1.0
"""Fine alignment stays where it is along a motion that is held by less (``DAMPING_VOXELS``). Of 177
simulated answers of the fit that were held so little, one was right ..."""
MAX_WEAK_STD_VOXELS, MIN_EVENLY_HELD = 0.1, 3.0
"""... unless what does hold it is known so exactly that it moves by no more, and that is so many
voxels, each counted alike. On gentle ground most voxels face one way and weigh most; the few others
hold the pose all the same: of right poses of 8 terrains and a figure that were refused, 8 are held
by 5 to 26 voxels, of four others by 1.4 at most ..."""
MAX_LAID_ON_ITSELF = 0.6
"""... if no more than this agrees: what lies on itself nearly everywhere and yet is hardly held is
a pedestal or a vase, turned."""


@dataclass(frozen=True)
class Verdict:
    """The tool's word on a result."""

    status: Status
    confidence: float
    """In [0, 1]: the share of results with this value that are right."""
    reason: str
    """One sentence for a person."""


def decide(findings: Findings) -> Verdict:
    """Turn the findings about the best pose into a verdict."""
    confidence = confidence_of(findings.features, CLEAN_GAIN * findings.is_clean)
    seen = f"{findings.overlap:.0%} of the surfaces agree"
    if findings.matched == 0:
        return Verdict(Status.FAILED, 0.0, f"fine alignment found no hold: in the best pose {seen}")
    if findings.violation > MAX_VIOLATION:
        reason = f"{seen}, but {findings.violation:.1%} lie where the other sensor saw free space"
        return Verdict(Status.FAILED, min(confidence, _calibration().refused), reason)
    if findings.is_mirrored:
        reason = (
            f"{seen}, but the source's mirror image explains the target better: one scan's axes "
            "are mirrored, or it is the other one of a mirrored pair; flip an axis and try again"
        )
        return Verdict(Status.FAILED, min(confidence, 0.1), reason)
    if findings.may_only_ride:
        reason = (
            f"{seen} if the sensor stood still, but of what stands farther off only "
            f"{findings.seen_again:.0%} is seen again: what rides with the sensor, its rings "
            "on flat ground, or what repeats may be all that speaks for it; crop it, or add a scan"
        )
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), reason)
    if len(findings.free_directions):
        axis = np.array2string(findings.free_directions[0], precision=2, suppress_small=True)
        reason = f"{seen}, but nothing fixes the position along {axis} in the target's frame"
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), reason)
    if len(findings.free_turns):
        axis = np.array2string(findings.free_turns[0], precision=2, suppress_small=True)
        reason = f"{seen}, but nothing fixes the turn about {axis} in the target's frame"
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), reason)
    if _is_loose(findings):
        reason = f"{seen}, but next to nothing holds the pose against a small motion"
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), reason)
    if len(findings.alternatives):
        poses = 1 + len(findings.alternatives)
        reason = f"{seen}, but {poses} distinct poses explain the data about equally well"
        return Verdict(Status.AMBIGUOUS, min(confidence, 1 / poses), reason)
    if confidence < MIN_CONFIDENCE or findings.has_too_little or findings.is_forced:
        reason = f"no pose explains both scans: in the best one {seen}"
        return Verdict(Status.FAILED, min(confidence, 0.5), reason)
    if (why := _why_another(findings)) is not None:
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), f"{seen}, {why}")
    reason = f"{seen} and {findings.violation:.1%} contradict what the sensors saw as free"
    return Verdict(Status.REGISTERED, confidence, reason)


def _why_another(findings: Findings) -> str | None:
    """What says that the scans show two things that are alike, not the same one; None if nothing
    does."""
    most_odd = MAX_ODD_SHARE
    if findings.closeness >= VERY_EXACT:
        most_odd = MAX_ODD_IF_BLIND if findings.blind > BLIND_BOTH else MAX_ODD_IF_EXACT
    if findings.is_blind and findings.odd_share > most_odd:
        return (
            f"most of them exactly, but {findings.odd_share:.0%} lie off by far more: the "
            "scans may show two things that are alike, not the same one, or parts of it have moved"
        )
    if findings.typical_offset > MAX_TYPICAL_OFFSET:
        return (
            f"but half of them lie off by {findings.typical_offset:.0f} times as much as their "
            "points scatter: the scans may show two things of unlike size or shape, or one is "
            "bent; check the units and scales"
        )
    if len(findings.forks_m):
        return (
            f"but at {_place(findings.forks_m)} the scans' surfaces part and go on "
            "differently: they may show two things that are alike, not the same one, or something "
            "was changed there; crop it, or give the places of the sensors"
        )
    if findings.before.is_another:
        return (
            f"but {findings.before.share:.1%} of one scan, such as at "
            f"{_place(findings.before.at_m)}, stands before what the other one shows there: they "
            "may show two things that are alike, or something was moved"
        )
    things, pieces = findings.furnishing, findings.pieces
    if things.is_another_in_bulk:
        return _scattered(things.gone_m, things.bulky_gone, things.bulky_again)
    if things.is_another:
        return _scattered(things.gone_m, len(things.gone_m), things.again)
    if pieces.is_most_gone:
        return (
            f"but {pieces.share:.0%} of what stands out in either scan, such as at "
            f"{_place(pieces.parts_m)}, is not in the other one: they may show two places that are "
            "alike, or nearly all was moved; add a scan, or crop what was moved"
        )
    if pieces.is_another:
        return _scattered(pieces.gone_m, len(pieces.gone_m), pieces.again)
    return None


def _scattered(gone_m: FloatArray, gone: int, again: int) -> str:
    """Why what lies about says that two rooms are shown."""
    return (
        f"but {gone} small things stand in one scan alone, such as at {_place(gone_m)}, and only "
        f"{again} in both: they may show two rooms that are alike, or nearly all was moved; add a "
        "scan, or crop what was moved"
    )


def _place(places_m: FloatArray) -> str:
    """The first of (P, 3) places, in words."""
    place = ", ".join(f"{coordinate:.3g}" for coordinate in places_m[0])
    return f"({place}) in the target's frame"


def _is_loose(findings: Findings) -> bool:
    """Whether next to nothing holds the pose, as far as is known."""
    is_exact = findings.weakest_std_voxels <= MAX_WEAK_STD_VOXELS
    is_exact = is_exact and findings.evenly_held >= MIN_EVENLY_HELD
    is_exact = is_exact and findings.overlap <= MAX_LAID_ON_ITSELF
    return findings.held_voxels < MIN_HELD_VOXELS and not is_exact


def confidence_of(features: FloatArray, gained: float = 0.0) -> float:
    """Calibrated probability that a pose with these ``FEATURES`` is right (logistic regression),
    its logit being more by what is gained."""
    fitted = _calibration()
    return float(1 / (1 + np.exp(-(features @ fitted.weights + fitted.bias + gained))))


def may_be_registered(
    score: Score,
    blind: float,
    gained: float = 0.0,
    margin: float | None = None,
    confidence: float = MIN_CONFIDENCE,
) -> bool:
    """Whether one of (C,) scored poses may be registered, whatever else is found out about it.

    A bound: of what the confidence is made of, all that the score does not say is taken to be as
    good as can be: the lead over all rivals, and the hold.

    Args:
        score: the judge's figures, before any closer look.
        blind: share of the two scans whose viewpoint is unknown.
        gained: by how much the logit of the confidence may rise before they are scored again.
        margin: the lead over all rivals, where it is known.
        confidence: that is needed.
    """
    fitted = _calibration()

    def weight(name: str) -> float:
        return fitted.weight(name) + blind * fitted.weight(f"blind_{name}")

    if margin is None:
        margin = 1 - CHANCE_SCORE / max(float(score.total.max(initial=0.0)), CHANCE_SCORE)
    logit = fitted.bias + fitted.weight("blind") * blind + weight("support") * score.support
    logit = logit + fitted.weight("violation") * np.sqrt(score.violation)
    logit = logit + max(weight("margin"), 0.0) * margin + max(weight("held"), 0.0) * MOST_HELD
    clean = (score.contradiction <= STRAY_SHARE) & (score.mismatch_rate <= CLEAN_MISMATCH)
    logit = logit + CLEAN_GAIN * clean
    return bool((logit + gained >= np.log(confidence / (1 - confidence))).any())


@dataclass(frozen=True)
class _Calibration:
    weights: FloatArray
    """(F,) of ``FEATURES``."""
    bias: float
    refused: float
    """Share of poses that are right although they are refused for ``MAX_VIOLATION``."""

    def weight(self, feature: str) -> float:
        """Of one of ``FEATURES``."""
        return float(self.weights[FEATURES.index(feature)])


@cache
def _calibration() -> _Calibration:
    stored = json.loads(CALIBRATION_FILE.read_text())
    weights = np.array([stored["weights"][name] for name in FEATURES])
    return _Calibration(weights, float(stored["bias"]), float(stored["refused"]))
