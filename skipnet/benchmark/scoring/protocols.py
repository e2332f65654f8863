"""The published rules by which a pose counts as right, each with a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.benchmark.options import ProtocolKind
from skipnet.metrics.poses import PoseScore
from skipnet.types import Pair


@dataclass(frozen=True)
class Protocol:
    """A rule: what is right, which pairs count, over what rates are averaged."""

    label: str
    """Short, for the head of a column."""
    sentence: str
    """The whole rule, for the foot of a table."""
    rotation_deg: float | None = None
    """Limit of the rotation error ..."""
    translation_m: float | None = None
    """... and of the translation error; None, both: the pair's own, or the RMSE's."""
    rmse_m: float | None = None
    """Limit of the RMSE through gt.info, instead of the other two."""
    consecutive_count: bool = True
    """Whether pairs of consecutive scans are in the denominator."""
    mean_of_sets: bool = False
    """The rate is the mean over the scenes' rates, not over all pairs."""

    def applies_to(self, pair: Pair) -> bool:
        """Whether the pair counts, and has what the rule needs."""
        if self.rmse_m is not None and pair.information is None:
            return False
        return self.consecutive_count or not pair.consecutive

    def is_right(self, score: PoseScore) -> bool:
        """Whether a pose with these errors is right."""
        if self.rmse_m is not None:
            return score.rmse_m is not None and score.rmse_m < self.rmse_m
        if self.rotation_deg is None or self.translation_m is None:
            return score.success
        return bool(
            np.rad2deg(score.rotation_error_rad) < self.rotation_deg
            and score.translation_error_m < self.translation_m
        )


def _by_limits(rotation_deg: float, translation_m: float) -> Protocol:
    return Protocol(
        f"{rotation_deg:g}°, {translation_m:g} m",
        f"Right: rotation error below {rotation_deg:g} degrees and translation error below "
        f"{translation_m:g} m; all pairs count.",
        rotation_deg,
        translation_m,
    )


PROTOCOLS = {
    ProtocolKind.own: Protocol(
        "own limits",
        "Right: both errors below the limits that come with the pair; all pairs count.",
    ),
    ProtocolKind.rmse_20cm: Protocol(
        "RMSE < 0.2 m",
        "Right: RMSE below 0.2 m through gt.info; consecutive fragments do not count; the rate "
        "is the mean over the scenes.",
        rmse_m=0.2,
        consecutive_count=False,
        mean_of_sets=True,
    ),
    ProtocolKind.deg15_30cm: _by_limits(15, 0.3),
    ProtocolKind.deg5_2m: _by_limits(5, 2),
    ProtocolKind.deg5_60cm: _by_limits(5, 0.6),
    ProtocolKind.deg2_30cm: _by_limits(2, 0.3),
}


def right_by_rule(score: PoseScore, pair: Pair) -> dict[str, bool]:
    """Whether a pose is right by each rule that applies to its pair, by the rule's name."""
    return {
        kind.name: protocol.is_right(score)
        for kind, protocol in PROTOCOLS.items()
        if protocol.applies_to(pair)
    }
