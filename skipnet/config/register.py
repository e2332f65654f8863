"""Options of ``register.py``, and of the registration itself."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

from skipnet.config.checks import require


class Generator(Enum):
    """Where candidate poses come from."""

    corners = "corners"
    edges = "edges"
    planes = "planes"
    slides = "slides"
    descriptors = "descriptors"
    """The learned ones."""
    fpfh = "fpfh"
    """Descriptors computed by a fixed rule, for comparison; slower, and Open3D's."""


@dataclass
class RegistrationConfig:
    """Options of the registration itself; the defaults serve any scan."""

    generators: list[Generator] = field(
        default_factory=lambda: [
            Generator.planes,
            Generator.slides,
            Generator.descriptors,
            Generator.fpfh,
        ]
    )
    """Asked in this order; a later one only while the verdict is not clear yet."""
    denoise: bool = False
    """Drop outliers first, as the paper does. Effective voxels do without."""
    denoise_neighbours: int = 4
    """Nearest neighbours whose mean distance is looked at."""
    denoise_sigma: float = 1.0
    """Standard deviations above the mean from which a point is dropped."""
    same_class_corners: bool = True
    """Only corners of equal class correspond, as in the paper; false lets any two."""
    feature_weight: float = 1.0
    """Weight of edge and corner voxels in the judge, where planes have 1; 1 asks no network."""
    violation_weight: float = 10.0
    """How fast voxels in seen free space devalue a pose: 1 / weight of all leave it 37 %."""
    max_correspondences: int = 1500
    """Descriptor matches that enter the compatibility graph."""
    refine_samples: int = 1500
    """Voxels with which candidates are refined before the final judgement."""
    final_samples: int = 4000
    """Voxels of each scan that the final judgement looks at."""

    def __post_init__(self) -> None:
        require(bool(self.generators), "generators", self.generators, "at least one generator")
        known = all(isinstance(generator, Generator) for generator in self.generators)
        require(known, "generators", self.generators, "members of Generator")
        for name in ("denoise_sigma", "feature_weight", "violation_weight"):
            value = getattr(self, name)
            require(0 <= value < math.inf, name, value, "a number of 0 or more")
        require(self.feature_weight > 0, "feature_weight", self.feature_weight, "above 0")
        for name in ("max_correspondences", "refine_samples", "final_samples"):
            require(getattr(self, name) >= 50, name, getattr(self, name), "50 or more")
        neighbours = self.denoise_neighbours
        require(neighbours >= 1, "denoise_neighbours", neighbours, "1 or more")


@dataclass
class RegisterConfig:
    """Options of ``register.py``: two scans, many scans, or none: a simulated pair."""

    source: str | None = None
    """The scan to move (.ply .pcd .xyz .txt .csv .npy .npz .las .laz .e57), in metres."""
    target: str | None = None
    """The scan that stays."""
    scans: list[str] = field(default_factory=list)
    """Two or more scans to bring into the frame of the first, instead of source and target."""
    output_dir: str = "runs/register"
    """Where the results are written, relative to where the user stands; made when missing."""
    source_viewpoint: Any = "auto"
    """Sensor position in the source's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    target_viewpoint: Any = "auto"
    """Sensor position in the target's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    voxel_size_m: float | None = None
    """Voxel edge length in metres; null chooses it from the data."""
    seed: int = 0
    """Seed of every random choice: the same input and seed give the same bits."""
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    """How to register."""

    def __post_init__(self) -> None:
        check_viewpoint("source_viewpoint", self.source_viewpoint)
        check_viewpoint("target_viewpoint", self.target_viewpoint)
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        size_m = self.voxel_size_m
        fits = size_m is None or 0 < size_m < math.inf
        require(fits, "voxel_size_m", size_m, "metres above 0, or null")
        self._check_inputs()

    def _check_inputs(self) -> None:
        if (self.source is None) != (self.target is None):
            given = "source" if self.target is None else "target"
            raise ValueError(f"only {given} was given: give source=FILE and target=FILE together")
        if self.scans and self.source is not None:
            raise ValueError("scans=[...] and source=/target= exclude each other: give only one")
        if self.scans and (self.source_viewpoint, self.target_viewpoint) != ("auto", "auto"):
            raise ValueError(
                "source_viewpoint and target_viewpoint are for two scans: with scans=[...] all "
                "viewpoints are found out; leave them out"
            )
        require(len(self.scans) != 1, "scans", self.scans, "at least two files")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")

    @property
    def inputs(self) -> list[Path]:
        """The files to read, in the order given; empty when a pair is to be simulated."""
        if self.source is not None and self.target is not None:
            return [Path(self.source), Path(self.target)]
        return [Path(scan) for scan in self.scans]


def check_viewpoint(option: str, value: object) -> None:
    """A viewpoint is "auto", None (unknown), or the sensor's position [x, y, z] in metres."""
    is_position = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(number, int | float) for number in value)
    )
    require(value is None or value == "auto" or is_position, option, value, "auto, null or [x,y,z]")
