"""Which scenes serve which purpose: no scene that something was made from measures anything.

A simulated scene is its family and its seed. Every purpose has a range of seeds of its own here,
and no two ranges meet: below 100,000 lie the scenes that weights, confidences and rules were made
from, from there on those that only measure. What lies between the ranges is free; a new purpose
takes a range there and a line in ``RANGES``.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SeedRange:
    """The seeds of one purpose; a user asks for scene number 0, 1, ... of it."""

    purpose: str
    first: int
    """Seed of scene number 0."""
    count: int
    """Scenes that it has."""
    tries: int = 1
    """With more than one, a scene that does not serve has stand-ins: so many seeds for each."""

    @property
    def stop(self) -> int:
        """The first seed beyond the range, stand-ins included."""
        return self.first + self.count * self.tries

    def take(self, count: int, skip: int = 0) -> range:
        """Seeds of ``count`` scenes, those from number ``skip`` on.

        Raises:
            ValueError: the range has no such scenes.

        >>> list(SeedRange("example", 500, 10).take(2, skip=3))
        [503, 504]
        """
        if not 0 <= skip <= skip + count <= self.count:
            raise ValueError(
                f"{self.purpose}: {count} scenes from number {skip} on are not to be had, its "
                f"scenes are numbered 0 to {self.count - 1}; take fewer, or a smaller seed"
            )
        return range(self.first + skip, self.first + skip + count)

    def scene(self, number: int) -> int:
        """The seed of one scene."""
        return self.take(1, skip=number)[0]

    def stand_ins(self, number: int) -> range:
        """The seeds to try for one scene, its own first."""
        return range(self.scene(number), self.stop, self.count)

    def __contains__(self, seed: int) -> bool:
        return self.first <= seed < self.stop


TRAINING = SeedRange("training", 0, 1000)
"""What both heads of the network learn from: labelled scenes, and pairs of scans."""
CLASS_VALIDATION = SeedRange("validation of the classes", 1000, 1000)
CLASS_TEST = SeedRange("test of the classes", 2000, 1000)
DESCRIPTOR_VALIDATION = SeedRange("validation of the descriptor", 10_000, 1000)
DESCRIPTOR_TEST = SeedRange("test of the descriptor", 20_000, 1000)
DEEP_VALIDATION = SeedRange("validation of the deep network", 21_000, 1000)
DEEP_TEST = SeedRange("test of the deep network", 22_000, 1000)
DEEP_TRAINING = SeedRange("training of the deep network", 24_000, 26_000)
"""Numbers of the factory of training pairs, and the scenes they show."""
CALIBRATION = SeedRange("calibration", 50_000, 1000, tries=12)
"""What the verdict's confidence is fitted on."""
TUNING = SeedRange("tuning", 62_000, 38_000)
"""What rules and thresholds are chosen on; earlier versions were measured here, and mended."""

BENCHMARK = SeedRange("benchmark", 100_000, 10_000)
SPEED = SeedRange("speed", 110_000, 1000)
OVERLAP = SeedRange("overlap", 120_000, 1000, tries=12)
VIGILANCE = SeedRange("vigilance", 140_000, 1000)
VIGILANCE_APART = SeedRange("vigilance, scans that share nothing", 141_000, 9000)
VIGILANCE_ALIKE = SeedRange("vigilance, what is alike", 190_000, 9000)
ACCURACY = SeedRange("accuracy", 150_000, 1000)
PROJECTS = SeedRange("projects", 160_000, 10_000)
"""Many scans of one site."""
INVARIANTS = SeedRange("invariants", 180_000, 1000)
DEMO = SeedRange("demo", 170_000, 10_000)
"""What ``register.py`` shows without arguments, and the pictures of the documentation."""

RANGES = (
    *(TRAINING, CLASS_VALIDATION, CLASS_TEST, DESCRIPTOR_VALIDATION, DESCRIPTOR_TEST),
    *(DEEP_VALIDATION, DEEP_TEST, DEEP_TRAINING),
    *(CALIBRATION, TUNING),
    *(BENCHMARK, SPEED, OVERLAP, VIGILANCE, VIGILANCE_APART, ACCURACY, PROJECTS, DEMO),
    *(INVARIANTS, VIGILANCE_ALIKE),
)
"""All of them; a test holds that no two share a seed."""
FIRST_MEASURED = 100_000
"""From this seed on nothing is trained, fitted or chosen."""
