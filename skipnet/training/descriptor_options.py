"""Options of what both heads of the small network learn from, and how."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from skipnet.checks import require
from skipnet.simulation.scanning.recipe import Recipe


class Loss(Enum):
    """What the descriptor's training minimises."""

    contrastive = "contrastive"
    """InfoNCE: the partner against all other places of the batch."""
    hardest = "hardest"
    """A hinge on the most similar wrong place alone."""


@dataclass
class DescriptorTrainConfig:
    """What both heads learn from, beside the labelled patches, and how."""

    families: list[str] = field(
        default_factory=lambda: [
            "paper_room",
            "oblique",
            "curved",
            "doorway",
            "closed",
            "facade",
            "terrain",
            "clutter",
        ]
    )
    """Simulated families, taken in turn (``skipnet.simulation.scenes.scenes.FAMILIES``)."""
    augmentation: Recipe = field(default_factory=Recipe)
    """How their scans are taken and spoilt; also those of validation and test."""
    training_pairs: int = 400
    """Pairs of scans with seeds from 0."""
    validation_pairs: int = 16
    """Pairs of scans with seeds from 10000."""
    test_pairs: int = 16
    """Pairs of scans with seeds from 20000, for the scores."""
    patches_per_scans: int = 600
    """Pairs of patches drawn from one pair of scans."""
    steps: int = 2000
    """Steps of the optimiser at most."""
    scans_per_step: int = 2
    """Pairs of scans whose patches meet in one step."""
    patches_per_step: int = 768
    """Pairs of patches of one step, from all its scans."""
    labelled_per_step: int = 1024
    """Labelled patches of one step, for the classes."""
    class_weight: float = 1.0
    """Weight of the classes' loss beside the descriptor's."""
    loss: Loss = Loss.contrastive
    """contrastive, or hardest; loss=NAME takes configs/loss."""
    temperature: float = 0.07
    """Cosine similarity that changes the odds of a match e-fold."""
    sector_units: int = 48
    """Units that sum up one sector of a patch."""
    hidden_units: int = 128
    """Units that read the five sectors together."""
    output_units: int = 32
    """Numbers of a descriptor."""
    hidden_dropout: float = 0.3
    """Share of the hidden units that the class head, when it learns by itself, has to do without:
    they know the training scenes too well."""
    validate_every: int = 250
    """Steps between validations; at each a checkpoint is written, from which a run resumes."""
    patience: int = 5
    """Validations without a higher inlier ratio after which training ends; 0 never ends early."""

    def __post_init__(self) -> None:
        require(bool(self.families), "descriptor.families", self.families, "at least one family")
        for name in ("training_pairs", "validation_pairs", "test_pairs"):
            count = getattr(self, name)
            limit = 1000  # further on lie the seeds of scenes that the classes are judged on
            require(0 < count <= limit, f"descriptor.{name}", count, f"1 to {limit}")
        counts = ("patches_per_scans", "steps", "scans_per_step", "validate_every")
        units = ("sector_units", "hidden_units", "output_units")
        for name in (*counts, *units, "labelled_per_step"):
            require(getattr(self, name) > 0, f"descriptor.{name}", getattr(self, name), "1 or more")
        per_step = self.patches_per_step
        least = 2 * self.scans_per_step
        require(per_step >= least, "descriptor.patches_per_step", per_step, f"{least} or more")
        for name in ("class_weight", "temperature"):
            require(getattr(self, name) > 0, f"descriptor.{name}", getattr(self, name), "above 0")
        share = self.hidden_dropout
        require(0 <= share < 1, "descriptor.hidden_dropout", share, "0 or more and below 1")
        require(self.patience >= 0, "descriptor.patience", self.patience, "0 or more")
