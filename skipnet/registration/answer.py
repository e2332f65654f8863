"""The best pose so far, with the verdict on it, in whatever frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from skipnet.registration.findings import Findings
from skipnet.registration.verdict import Verdict, decide
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray


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
        verdict = Verdict(
            "failed", 0.0, "the scans offered no feature from which to propose a pose"
        )
        return Answer(np.zeros((0, 4, 4)), np.zeros((0, 4, 4)), np.eye(4), verdict, None)

    @property
    def T_target_source_coarse(self) -> FloatArray:
        """(4, 4) the best pose as it was proposed."""
        return self.coarse[0] if len(self.coarse) else np.eye(4)

    def mapped(self, change: Callable[[FloatArray], FloatArray], rotation: FloatArray) -> Answer:
        """The same answer between other frames.

        Args:
            change: maps (..., 4, 4) poses to those between the new frames.
            rotation: (3, 3) from the old target frame to the new one.
        """
        poses = [change(T) for T in (self.coarse, self.finalists, self.T_target_source)]
        if self.findings is None:
            return Answer(poses[0], poses[1], poses[2], self.verdict, None)
        both = np.kron(np.eye(2), rotation)
        findings = replace(
            self.findings,
            covariance=both @ self.findings.covariance @ both.T,
            free_directions=self.findings.free_directions @ rotation.T,
            free_turns=self.findings.free_turns @ rotation.T,
            alternatives=change(self.findings.alternatives),
        )
        return Answer(poses[0], poses[1], poses[2], decide(findings), findings)

    def details(self, source: Scan, target: Scan) -> dict[str, object]:
        """What was assumed and found, for reports."""
        found = self.findings
        viewpoints_m = [
            None if scan.viewpoint_given_m is None else scan.viewpoint_given_m.tolist()
            for scan in (source, target)
        ]
        extents = [
            " x ".join(f"{length:.3g}" for length in np.ptp(scan.evidence.points_m, axis=0))
            for scan in (source, target)
            if len(scan.skipmap)
        ]
        reach = f"; the scans extend over {' and '.join(extents)}" if extents else ""
        return {
            "unit": f"coordinates taken as metres{reach}",
            "voxel_size_m": source.skipmap.voxel_size_m,
            "source_viewpoint_m": viewpoints_m[0],
            "target_viewpoint_m": viewpoints_m[1],
            "overlap": found and found.overlap,
            "violation": found and found.violation,
            "margin": found and found.margin,
            "matched_voxels": found and found.matched,
            "held_voxels": found and found.held_voxels,
            "position_std_m": found and float(np.sqrt(np.trace(found.covariance[3:, 3:]))),
            "rotation_std_rad": found and float(np.sqrt(np.trace(found.covariance[:3, :3]))),
            "covariance": found and found.covariance.tolist(),
            "blind": found and found.blind,
            "free_directions": found and found.free_directions.tolist(),
            "free_turns": found and found.free_turns.tolist(),
            "alternatives_T_target_source": found and found.alternatives.tolist(),
        }
