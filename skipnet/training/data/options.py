"""Options of the labelled samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from skipnet.checks import require


class PatchKind(Enum):
    """How a voxel's surroundings become 125 numbers (``skipnet.features.patches``)."""

    surface_frame = "surface_frame"
    axis_aligned = "axis_aligned"


class Split(Enum):
    """What training, validation and test sets share."""

    by_scene = "by_scene"
    random = "random"


@dataclass
class LabelConfig:
    """What counts as a surface at a voxel; lengths in voxels."""

    radius_voxels: float = 2.5
    """A surface farther away does not count: half the width of 5 voxels."""
    min_area_voxels2: float = 3.0
    """Nor does one of which the sensor sees less there; a flat wall shows 19.6."""
    min_beams: float = 6.0
    """Nor one that fewer of the scanner's beams meet there."""

    def __post_init__(self) -> None:
        require(self.radius_voxels > 0, "label.radius_voxels", self.radius_voxels, "above 0")
        require(self.min_area_voxels2 >= 0, "label.min_area_voxels2", self.min_area_voxels2, "0 up")
        require(self.min_beams >= 0, "label.min_beams", self.min_beams, "0 or more")


@dataclass
class DataConfig:
    """Where the labelled patches come from."""

    families: list[str] = field(
        default_factory=lambda: ["paper_room", "oblique", "doorway", "closed", "curved"]
    )
    """Simulated families, taken in turn (``skipnet.simulation.scenes.scenes.FAMILIES``)."""
    scanner: str = "terrestrial"
    """terrestrial or rings."""
    turn_second_scan: bool = True
    """Turn each scene's second cloud at random; false keeps it upright, as in the paper."""
    patch: PatchKind = PatchKind.surface_frame
    """surface_frame, or axis_aligned as in the paper."""
    label: LabelConfig = field(default_factory=LabelConfig)
    """The definition of the classes."""
    split: Split = Split.by_scene
    """by_scene, or random: 70 % training, 15 % validation, 15 % test of the same scenes' voxels."""
    training_scenes: int = 130
    """Scenes with seeds from 0, two scans each."""
    validation_scenes: int = 15
    """Scenes with seeds from 1000; unused by split=random."""
    test_scenes: int = 20
    """Scenes with seeds from 2000, never seen in training, whatever the split."""
    most_per_class: int = 150
    """Training and validation voxels kept of each class and scan; the test keeps all."""
    samples: int | None = None
    """Samples in all, the same number of each class; null keeps all."""
    workers: int = 2
    """Processes that simulate; the data do not depend on their number."""

    def __post_init__(self) -> None:
        require(bool(self.families), "data.families", self.families, "at least one family")
        for name in ("training_scenes", "validation_scenes", "test_scenes"):
            count = getattr(self, name)
            require(0 < count <= 1000, f"data.{name}", count, "1 to 1000: seeds must not overlap")
        for name in ("most_per_class", "workers"):
            require(getattr(self, name) > 0, f"data.{name}", getattr(self, name), "1 or more")
        samples = self.samples
        require(samples is None or samples >= 50, "data.samples", samples, "50 or more, or null")
