"""Options of ``train.py network=deep``."""

from __future__ import annotations

from dataclasses import dataclass

from skipnet.checks import require


@dataclass
class DeepTrainConfig:
    """What the deep network learns from, and how; the optimiser and the seed are the others'."""

    steps: int = 20_000
    """Steps of the optimiser."""
    scans_per_step: int = 3
    """Pairs of scans whose patches meet in one step."""
    patches_per_scans: int = 256
    """Pairs of patches cut out of one pair of scans."""
    patches_per_step: int = 384
    """Pairs of patches of one step, from all its scans."""
    window: int = 200
    """Pairs of scans that are at hand at a time; each takes 11 MB."""
    uses: float = 6.0
    """Steps that a pair of scans takes part in, on average, before it is thrown away."""
    first: int = 0
    """Number of the factory to begin with."""
    start: str | None = None
    """Name or file of a deep network to go on from, with its scaling of the inputs; null begins
    anew. It must have the widths that are asked for."""
    threads: int = 2
    """Threads of torch; their number decides the last bits of what is learned."""
    temperature: float = 0.07
    """Cosine similarity that changes the odds of a match e-fold."""
    local_channels: int = 32
    """Channels of the local patterns."""
    hidden_units: int = 192
    """Units that sum up a sector, and the whole."""
    output_units: int = 48
    """Numbers of a descriptor."""
    blocks: int = 1
    """Local layers, one after the other."""
    mixed_precision: bool = True
    """Compute in bfloat16 where that will do: twice as fast, also on a processor that has it."""
    validation_pairs: int = 12
    """Numbers of the factory that are kept for validation."""
    test_pairs: int = 40
    """Numbers of the factory that the scores are from."""
    validate_every: int = 500
    """Steps between validations; at each a checkpoint is written, from which a run resumes."""
    patience: int = 0
    """Validations without a higher inlier ratio after which training ends; 0 never ends early."""

    def __post_init__(self) -> None:
        counts = ("steps", "scans_per_step", "patches_per_scans", "window", "validate_every")
        widths = ("local_channels", "hidden_units", "output_units", "blocks")
        for name in (*counts, *widths, "threads", "validation_pairs", "test_pairs"):
            require(getattr(self, name) > 0, f"deep.{name}", getattr(self, name), "1 or more")
        for name in ("uses", "temperature"):
            require(getattr(self, name) > 0, f"deep.{name}", getattr(self, name), "above 0")
        least = 2 * self.scans_per_step
        per_step = self.patches_per_step
        require(per_step >= least, "deep.patches_per_step", per_step, f"{least} or more")
        enough = self.window >= 4 * self.scans_per_step
        require(enough, "deep.window", self.window, f"{4 * self.scans_per_step} or more")
        require(self.first >= 0, "deep.first", self.first, "0 or more")
        require(self.patience >= 0, "deep.patience", self.patience, "0 or more")
