"""Every option of every script, with its default, unit and range: the schemas Hydra checks against.

A range is checked when the dataclass is made, so a bad value fails before any work is done. Algorithms
never see these classes: they take plain arrays and scalars.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


def require(condition: bool, option: str, value: object, expected: str) -> None:
    """Raise a ValueError that names the option, what was given and what is expected.

    >>> require(False, "seed", -1, "a whole number of at least 0")
    Traceback (most recent call last):
    ...
    ValueError: seed=-1: expected a whole number of at least 0
    """
    if not condition:
        raise ValueError(f"{option}={value}: expected {expected}")


def check_viewpoint(option: str, value: object) -> None:
    """A viewpoint is "auto", None (unknown), or the sensor's position [x, y, z] in metres."""
    is_position = (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(number, int | float) for number in value)
    )
    require(value is None or value == "auto" or is_position, option, value, "auto, null or [x,y,z]")


# --- register.py ----------------------------------------------------------------------------------


@dataclass
class RegisterConfig:
    """Options of ``register.py``: a pair (source, target), many scans, or neither: a simulated pair."""

    source: str | None = None
    """The scan to move (.ply .pcd .xyz .txt .csv .npy .npz .las .laz .e57), in metres."""
    target: str | None = None
    """The scan that stays."""
    scans: list[str] = field(default_factory=list)
    """Two or more scans to bring into the frame of the first, instead of source and target."""
    output_dir: str = "runs/register"
    """Where the results are written, relative to where the user stands; made when missing."""
    source_viewpoint: Any = "auto"
    """Sensor position in the source's frame: auto (find out), null (unknown) or [x,y,z] in metres."""
    target_viewpoint: Any = "auto"
    """Sensor position in the target's frame: auto (find out), null (unknown) or [x,y,z] in metres."""
    voxel_size_m: float | None = None
    """Voxel edge length in metres; null chooses it from the data."""
    seed: int = 0
    """Seed of every random choice: the same input and seed give the same bits."""

    def __post_init__(self) -> None:
        check_viewpoint("source_viewpoint", self.source_viewpoint)
        check_viewpoint("target_viewpoint", self.target_viewpoint)
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        size_m = self.voxel_size_m
        require(size_m is None or size_m > 0, "voxel_size_m", size_m, "metres above 0, or null")
        self._check_inputs()

    def _check_inputs(self) -> None:
        if (self.source is None) != (self.target is None):
            given = "source" if self.target is None else "target"
            raise ValueError(f"only {given} was given: give source=FILE and target=FILE together")
        if self.scans and self.source is not None:
            raise ValueError("scans=[...] and source=/target= exclude each other: give one of the two")
        require(len(self.scans) != 1, "scans", self.scans, "at least two files")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")

    @property
    def inputs(self) -> list[Path]:
        """The files to read, in the order given; empty when a pair is to be simulated."""
        if self.source is not None and self.target is not None:
            return [Path(self.source), Path(self.target)]
        return [Path(scan) for scan in self.scans]


# --- train.py -------------------------------------------------------------------------------------
# (sections of the learning room)


# --- evaluate.py ----------------------------------------------------------------------------------
# (sections of the benchmark room)
