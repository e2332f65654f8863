"""The verdict: registered, ambiguous or failed, a calibrated confidence, a reason in words."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from skipnet.registration.alike import why_another
from skipnet.registration.findings import (
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
    if (why := why_another(findings)) is not None:
        return Verdict(Status.AMBIGUOUS, min(confidence, 0.5), f"{seen}, {why}")
    reason = f"{seen} and {findings.violation:.1%} contradict what the sensors saw as free"
    return Verdict(Status.REGISTERED, confidence, reason)


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
