"""What a registration returns."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from importlib import import_module

import numpy as np

from skipnet.clouds.cloud import Cloud
from skipnet.registration.findings import Findings
from skipnet.registration.prior import PriorCheck
from skipnet.scans.given import ScanLike, opened
from skipnet.scans.scan import Scan
from skipnet.skipmap.tree import SkipTree
from skipnet.types import FloatArray, Status

PAGES = "skipnet.results.saving"
"""The room above, which writes results; imported when somebody asks for it."""


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
    side: FloatArray | None = None
    """(3,) unit direction from a thing to where its scanner stood, found in the data where the
    position is unknown; None where nothing tells."""


@dataclass(frozen=True)
class Asked:
    """What a registration was asked about."""

    source: Cloud | SkipTree
    target: Cloud | SkipTree
    seed: int
    described: tuple[Scan, Scan] | None = None
    """Both scans as they were searched."""


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
    prior: PriorCheck | None = None
    """How far the answer is from the prior that was given; None without one."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """Seconds per stage, in the order of the pipeline."""

    given: Asked | None = field(default=None, repr=False, compare=False)
    """What it was found from; None of a pair among many scans."""

    def __str__(self) -> str:
        return f"{self.status} (confidence {self.confidence:.2f}): {self.reason}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def transform(self, source: ScanLike) -> Cloud | FloatArray:
        """The source in the target's frame.

        Args:
            source: whatever ``skipnet.register`` takes.

        Returns:
            Of a Cloud or a file a Cloud with all that it holds; of an array an array, whose other
            columns stay; of other libraries' clouds the points.
        """
        opened_source = opened(source, "source")
        assert isinstance(opened_source, Cloud)
        moved = opened_source.moved(self.T_target_source)
        if isinstance(source, Cloud | str | os.PathLike):
            return moved
        others = list(moved.columns.values()) if isinstance(source, np.ndarray | list) else []
        return np.column_stack([moved.points_m, *others]) if others else moved.points_m

    def save(self, folder: str | os.PathLike[str], format: str = "auto") -> None:
        """Write what the command line writes: result.json, aligned.ply, report.html, a picture.

        Args:
            folder: made when missing; results of an earlier run in it are replaced.
            format: of the aligned source, beside PLY, such as "laz".

        Raises:
            ValueError: the result does not hold its scans: it is of a pair among many.
        """
        import_module(PAGES).save(self, folder, format)

    def show(self) -> str:
        """Open the report in the browser; the path of its page."""
        return str(import_module(PAGES).show(self))

    def _repr_html_(self) -> str:
        """The verdict and both scans in 3-D, for notebooks."""
        return str(import_module(PAGES).notebook_html(self))

    @property
    def _off_prior(self) -> dict[str, object]:
        check = self.prior
        return {} if check is None else {"prior_off_m": check.off_m, "prior_off_rad": check.off_rad}

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
            "source_side": _listed(self.source.side),
            "target_side": _listed(self.target.side),
            "source_strays": self.source.strays,
            "target_strays": self.target.strays,
            "network": self.network,
            **self._off_prior,
            **{name: found.get(name) for name in Findings.JSON_NAMES},
        }


def _listed(position_m: FloatArray | None) -> list[float] | None:
    return None if position_m is None else np.asarray(position_m).tolist()
