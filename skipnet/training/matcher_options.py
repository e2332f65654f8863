"""Options of ``train.py network=matcher``."""

from __future__ import annotations

from dataclasses import dataclass

from skipnet.checks import require
from skipnet.networks.names import DEEP, weights_file


@dataclass
class MatcherTrainConfig:
    """What the matcher learns from, and how; the optimiser and the seed are the others'."""

    describes: str = DEEP
    """Name or file of the deep network that describes the keypoints; it stays as it is."""
    steps: int = 10_000
    """Steps of the optimiser."""
    scans_per_step: int = 2
    """Pairs of scans of one step."""
    keypoints: int = 384
    """Of a scan in one step, drawn from all that the matcher looks at; its time grows with their
    square."""
    cropped_share: float = 0.5
    """So often a side of each scan is cut away in a step, up to half of it."""
    dropped_share: float = 0.1
    """Of the numbers of a keypoint, hidden in a step."""
    jitter_voxels: float = 0.15
    """Deviation of a keypoint from its place in a step."""
    window: int = 1000
    """Pairs of scans that are at hand at a time; each takes 0.8 MB."""
    uses: float = 12.0
    """Steps that a pair of scans takes part in, on average, before it is thrown away."""
    first: int = 3000
    """Number of the factory to begin with; the deep network learned from those before."""
    start: str | None = None
    """File of a matcher to go on from; null begins with the deep network's own descriptors."""
    threads: int = 2
    """Threads of torch; their number decides the last bits of what is learned."""
    width: int = 96
    """Numbers of a keypoint on its way through the layers."""
    heads: int = 4
    """Ways to attend to others, side by side."""
    layers: int = 3
    """One after the other."""
    mixed_precision: bool = True
    """Compute in bfloat16 where that will do."""
    validation_pairs: int = 40
    """Numbers of the factory that are kept for validation."""
    test_pairs: int = 40
    """Numbers of the factory that the scores are from."""
    validate_every: int = 500
    """Steps between validations; at each a checkpoint is written, from which a run resumes."""
    patience: int = 0
    """Validations without a higher inlier ratio after which training ends; 0 never ends early."""

    def __post_init__(self) -> None:
        counts = ("steps", "scans_per_step", "keypoints", "window", "validate_every", "threads")
        widths = ("width", "heads", "layers", "validation_pairs", "test_pairs")
        for name in (*counts, *widths):
            require(getattr(self, name) > 0, f"matcher.{name}", getattr(self, name), "1 or more")
        for name in ("cropped_share", "dropped_share"):
            share = getattr(self, name)
            require(0 <= share < 1, f"matcher.{name}", share, "0 to below 1")
        jitter = self.jitter_voxels
        require(jitter >= 0, "matcher.jitter_voxels", jitter, "0 or more")
        require(self.uses > 0, "matcher.uses", self.uses, "above 0")
        fits = self.width % self.heads == 0
        require(fits, "matcher.width", self.width, f"a multiple of heads, {self.heads}")
        enough = self.window >= 4 * self.scans_per_step
        require(enough, "matcher.window", self.window, f"{4 * self.scans_per_step} or more")
        for name in ("first", "patience"):
            require(getattr(self, name) >= 0, f"matcher.{name}", getattr(self, name), "0 or more")
        weights_file(self.describes, "matcher.describes")
