"""What a registration returns."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from skipnet.clouds.cloud import Cloud
from skipnet.geometry import transform_points
from skipnet.registration.findings import Findings
from skipnet.types import FloatArray, Status


@dataclass(frozen=True)
class ScanFacts:
    """What was assumed of one scan, in the frame that it was given in."""

    extent_m: FloatArray | None
    """(3,) along its principal axes; None without voxels."""
    viewpoint_m: FloatArray | None
    """(3,) sensor position; None when unknown."""
    trust: float
    """What the evidence of that position is worth: 0 when it is unknown, to 1."""
    strays: int = 0
    """Points far from all others, which were left out."""


@dataclass(frozen=True)
class Registration:
    """What ``skipnet.register`` returns."""

    T_target_source: FloatArray
    """(4, 4) float64, ``p_target = T_target_source @ p_source``, after fine alignment."""
    T_target_source_coarse: FloatArray
    """(4, 4) float64, before fine alignment."""
    status: Status
    """Registered, ambiguous or failed."""
    confidence: float
    """In [0, 1]: the share of results with this value that are right; 0 surely wrong, 1 right."""
    reason: str
    """One sentence for a person: why this status."""
    voxel_size_m: float
    """Edge of a voxel."""
    network: str
    """Digest of the network that recognised and classified voxels."""
    source: ScanFacts
    target: ScanFacts
    findings: Findings | None = None
    """What the verdict rests on; None when no pose was proposed."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """Seconds per stage, in the order of the pipeline."""

    def __str__(self) -> str:
        return f"{self.status} (confidence {self.confidence:.2f}): {self.reason}"

    def transform(self, source: Cloud | npt.ArrayLike) -> Cloud | FloatArray:
        """The source in the target's frame: a Cloud with all that it holds, or (N, 3) points."""
        if isinstance(source, Cloud):
            return source.moved(self.T_target_source)
        return transform_points(self.T_target_source, np.asarray(source, np.float64))

    @property
    def details(self) -> dict[str, object]:
        """What was assumed and found, as JSON has it."""
        found = {} if self.findings is None else self.findings.as_json
        extents = [
            " x ".join(f"{length:.3g}" for length in scan.extent_m)
            for scan in (self.source, self.target)
            if scan.extent_m is not None
        ]
        reach = f"; the scans extend over {' and '.join(extents)}" if extents else ""
        return {
            "unit": f"coordinates taken as metres{reach}",
            "voxel_size_m": self.voxel_size_m,
            "source_viewpoint_m": _listed(self.source.viewpoint_m),
            "target_viewpoint_m": _listed(self.target.viewpoint_m),
            "source_trust": self.source.trust,
            "target_trust": self.target.trust,
            "source_strays": self.source.strays,
            "target_strays": self.target.strays,
            "network": self.network,
            **{name: found.get(name) for name in Findings.JSON_NAMES},
        }


def _listed(position_m: FloatArray | None) -> list[float] | None:
    return None if position_m is None else np.asarray(position_m).tolist()
