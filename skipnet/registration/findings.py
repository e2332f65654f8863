"""What is known about the best pose when the verdict is due."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.types import FloatArray

FEATURES = (
    "overlap",
    "violation",
    "margin",
    "held",
    "blind",
    "blind_overlap",
    "blind_margin",
    "blind_held",
)
FIRMLY_HELD_VOXELS = 99.0
"""More than this says nothing more."""


@dataclass(frozen=True)
class Findings:
    """What is known about the best pose when the verdict is due."""

    overlap: float
    """Mean of both ways' matched shares."""
    violation: float
    """Mean of both ways' shares in seen free space."""
    margin: float
    """Lead over the best distinct alternative's score, as a share of the own; 1 without a rival."""
    matched: int
    """Correspondences of the fine alignment."""
    held_voxels: float
    """Voxels, in effect, that face the motion against which the pose is held least."""
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
    def features(self) -> FloatArray:
        """What the confidence is computed from, in the order of ``FEATURES``."""
        return self.features_from(
            self.overlap, self.violation, self.margin, self.held_voxels, self.blind
        )

    @staticmethod
    def features_from(
        overlap: float, violation: float, margin: float, held_voxels: float, blind: float
    ) -> FloatArray:
        """(F,) features of figures as this class holds them."""
        held = np.log10(1 + min(held_voxels, FIRMLY_HELD_VOXELS))
        # Without free space the other figures must say more: they get weights of their own.
        in_the_dark = blind * np.array([1.0, overlap, margin, held])
        return np.array([overlap, np.sqrt(violation), margin, held, *in_the_dark])
