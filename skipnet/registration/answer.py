"""The best pose so far, with the verdict on it, in whatever frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skipnet.geometry import transform_points
from skipnet.registration.findings import Findings
from skipnet.registration.verdict import Verdict, decide
from skipnet.types import FloatArray, Status


@dataclass(frozen=True)
class Answer:
    """The best pose so far, the verdict on it, and the candidates it was chosen from."""

    coarse: FloatArray
    """(K, 4, 4) the candidates that came off best, as they were proposed."""
    finalists: FloatArray
    """(K, 4, 4) the same after alignment; none without candidates."""
    T_target_source: FloatArray
    """(4, 4) the best of them after fine alignment."""
    verdict: Verdict
    findings: Findings | None

    @staticmethod
    def none() -> Answer:
        """Before any candidate: the identity, failed."""
        reason = "the scans offered no feature from which to propose a pose"
        verdict = Verdict(Status.FAILED, 0.0, reason)
        return Answer(np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.eye(4), verdict, None)

    @property
    def T_target_source_coarse(self) -> FloatArray:
        """(4, 4) the best pose as it was proposed."""
        return self.coarse[0] if len(self.coarse) else np.eye(4)

    def mapped(self, change: Callable[[FloatArray], FloatArray], T_new_old: FloatArray) -> Answer:
        """The same answer between other frames.

        Args:
            change: maps (..., 4, 4) poses to those between the new frames.
            T_new_old: (4, 4) from the old target frame to the new one.
        """
        poses = [change(T) for T in (self.coarse, self.finalists, self.T_target_source)]
        if self.findings is None:
            return Answer(poses[0], poses[1], poses[2], self.verdict, None)
        found, rotation = self.findings, T_new_old[:3, :3]
        both = np.kron(np.eye(2), rotation)
        things, pieces, before = found.furnishing, found.pieces, found.before
        findings = replace(
            found,
            covariance=both @ found.covariance @ both.T,
            covariance_centre_m=transform_points(T_new_old, found.covariance_centre_m[None])[0],
            free_directions=found.free_directions @ rotation.T,
            free_turns=found.free_turns @ rotation.T,
            alternatives=change(found.alternatives),
            forks_m=transform_points(T_new_old, found.forks_m),
            before=replace(before, at_m=transform_points(T_new_old, before.at_m)),
            furnishing=replace(things, gone_m=transform_points(T_new_old, things.gone_m)),
            pieces=replace(
                pieces,
                gone_m=transform_points(T_new_old, pieces.gone_m),
                parts_m=transform_points(T_new_old, pieces.parts_m),
            ),
        )
        return Answer(poses[0], poses[1], poses[2], decide(findings), findings)
