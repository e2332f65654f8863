"""Options of ``train.py``."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from skipnet.checks import require
from skipnet.training.data.options import DataConfig, PatchKind, Split
from skipnet.training.deep_options import DeepTrainConfig


class Activation(Enum):
    """What a hidden unit does with its sum."""

    tanh = "tanh"
    gelu = "gelu"


class InputScaling(Enum):
    """How the network's inputs are brought to one scale."""

    standard = "standard"
    minmax = "minmax"


class NetworkKind(Enum):
    """Which network ``train.py`` trains."""

    two_heads = "two_heads"
    """The one that ships: classes and descriptor."""
    classes = "classes"
    """For the classes alone, as the paper's."""
    deep = "deep"
    """For correspondences alone, from a factory of pairs that feeds it as it learns."""


class Device(Enum):
    """Where networks are trained."""

    cpu = "cpu"
    cuda = "cuda"
    mps = "mps"


class Loss(Enum):
    """What the descriptor's training minimises."""

    contrastive = "contrastive"
    """InfoNCE: the partner against all other places of the batch."""
    hardest = "hardest"
    """A hinge on the most similar wrong place alone."""


@dataclass
class AugmentationConfig:
    """How the descriptor's training pairs are scanned and spoilt; shares are of pairs of scans."""

    rings_share: float = 0.25
    """Taken by a spinning scanner of 16 channels."""
    camera_share: float = 0.25
    """Seen by two cameras of a narrow view that look at about the same point."""
    fused_share: float = 0.2
    """Fused from two places each: nothing says which side of a surface was seen."""
    aim_error: float = 0.2
    """How far apart the cameras aim, as a share of their distance from the point."""
    voxel_octaves: float = 1.0
    """The usual voxel size is multiplied by a power of two between minus and plus this."""
    noise_voxels: list[float] = field(default_factory=lambda: [0.0, 0.05, 0.15])
    """Deviations of the points' noise, in voxels, one of which is drawn for a pair."""
    least_kept: float = 0.3
    """Of a scan's points between this share and all are kept."""
    holes: int = 6
    """Up to so many balls of points, of 2 to 12 voxels, are taken out of each scan."""
    curved_share: float = 0.8
    """So many of the examples are drawn by curvature; the rest evenly."""
    turned_share: float = 0.4
    """Shown with all their surfaces seen from the back."""

    def __post_init__(self) -> None:
        for name in ("rings_share", "camera_share", "fused_share", "curved_share", "turned_share"):
            share = getattr(self, name)
            require(0 <= share <= 1, f"descriptor.augmentation.{name}", share, "0 to 1")
        shares = self.rings_share + self.camera_share + self.fused_share
        require(shares <= 1, "descriptor.augmentation shares", shares, "at most 1 together")
        kept = self.least_kept
        require(0 < kept <= 1, "descriptor.augmentation.least_kept", kept, "above 0, at most 1")
        noise = self.noise_voxels
        known = bool(noise) and min(noise) >= 0
        require(known, "descriptor.augmentation.noise_voxels", noise, "one or more of 0 or more")
        for name in ("aim_error", "voxel_octaves", "holes"):
            value = getattr(self, name)
            require(value >= 0, f"descriptor.augmentation.{name}", value, "0 or more")


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
    """Simulated families, taken in turn (``skipnet.simulation.scenes.FAMILIES``)."""
    augmentation: AugmentationConfig = field(default_factory=AugmentationConfig)
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


@dataclass
class TrainConfig:
    """Options of ``train.py``."""

    experiment_name: str = "scenes"
    """Its name in reports."""
    network: NetworkKind = NetworkKind.two_heads
    """two_heads, or classes alone, as the paper's; hidden_sizes, activation, input_scaling and what
    says when to stop belong to the latter, descriptor.* to the former; deep.* to deep."""
    descriptor: DescriptorTrainConfig = field(default_factory=DescriptorTrainConfig)
    """How to train both heads."""
    deep: DeepTrainConfig = field(default_factory=DeepTrainConfig)
    """How to train the deep network."""
    data: DataConfig = field(default_factory=DataConfig)
    """What to learn the classes from."""
    hidden_sizes: list[int] = field(default_factory=lambda: [192, 96])
    """Units of each hidden layer; the paper's network is [50]."""
    activation: Activation = Activation.gelu
    """gelu, or tanh as in the paper's network (MATLAB's tansig)."""
    dropout: float = 0.2
    """Share of the hidden units that training leaves out at random; 0 none."""
    input_scaling: InputScaling = InputScaling.standard
    """standard: mean 0, deviation 1; minmax: to [-1, 1], MATLAB's mapminmax."""
    optimizer: dict[str, Any] = field(default_factory=dict)
    """``_target_`` and arguments of a torch optimiser; optimizer=NAME takes configs/optimizer."""
    learning_rate: float = 0.003
    """Of the optimisers that have one; scaled conjugate gradient has none, as in MATLAB."""
    cosine_decay: bool = True
    """Let the learning rate fall to 0 over the epochs."""
    batch_size: int | None = 512
    """Samples per step; null takes all at once, as MATLAB does."""
    epochs: int = 25
    """Passes over the training set at most."""
    goal: float = 0.0
    """Training loss at which to stop: cross-entropy averaged over outputs and samples."""
    min_gradient: float = 0.0
    """Stop when the full batch's gradient is shorter; 0 never."""
    max_fail: int = 0
    """Stop after so many epochs above the lowest validation loss; 0 never."""
    frequency_strength: float = 0.75
    """A thinned class gets back this power of what thinning took: 1 as in the scan, 0 nothing."""
    double_precision: bool = False
    """Train in float64; scaled conjugate gradient needs it. Weights are stored in float32."""
    ship: bool = False
    """Put the weights and their card into the package too, as those that skipnet.register uses; of
    two heads only."""
    compare_alone: bool = False
    """Train a network for the classes alone on the same samples, for the same tables."""
    compare_sklearn: bool = False
    """Train scikit-learn's classifiers on the same samples, for the same tables."""
    seed: int = 0
    """Of the weights' start, the order of the batches, the random split and the peers."""
    device: Device = Device.cpu
    """cpu, cuda or mps; the same seed gives the same bits on the cpu."""
    output_dir: str = "runs/train"
    """Folder of the run, relative to where the user stands; one that was interrupted goes on where
    it was."""

    def __post_init__(self) -> None:
        sizes = self.hidden_sizes
        require(bool(sizes) and min(sizes) > 0, "hidden_sizes", sizes, "positive layer sizes")
        require(self.learning_rate > 0, "learning_rate", self.learning_rate, "above 0")
        require(0 <= self.dropout < 1, "dropout", self.dropout, "0 or more and below 1")
        batch = self.batch_size
        require(batch is None or batch > 0, "batch_size", batch, "1 or more, or null for all")
        require(self.epochs > 0, "epochs", self.epochs, "1 or more")
        for name in ("goal", "min_gradient", "max_fail", "frequency_strength", "seed"):
            require(getattr(self, name) >= 0, name, getattr(self, name), "0 or more")
        require("_target_" in self.optimizer, "optimizer", self.optimizer, "a torch optimiser")
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")
        two_heads = self.network is NetworkKind.two_heads
        alone = "false, or network=two_heads"
        require(two_heads or not self.compare_alone, "compare_alone", self.compare_alone, alone)
        require(two_heads or not self.ship, "ship", self.ship, "false, or network=two_heads")
        if two_heads:
            self._check_two_heads()

    def _check_two_heads(self) -> None:
        """Refuse what only ``network=classes`` heeds."""
        data, target = self.data, str(self.optimizer["_target_"])
        sizes, activation = self.hidden_sizes, self.activation
        require(len(sizes) == 2, "hidden_sizes", sizes, "two sizes, or network=classes")
        fits = activation is Activation.gelu
        require(fits, "activation", activation.value, "gelu, or network=classes")
        fits = data.patch is PatchKind.surface_frame
        require(fits, "data.patch", data.patch.value, "surface_frame, or network=classes")
        fits = data.split is Split.by_scene
        require(fits, "data.split", data.split.value, "by_scene, or network=classes")
        require(data.samples is None, "data.samples", data.samples, "null, or network=classes")
        for name in ("compare_sklearn", "double_precision"):
            require(not getattr(self, name), name, True, "false, or network=classes")
        fits = not target.endswith("ScaledConjugateGradient")
        require(fits, "optimizer", target, "one for mini-batches, or network=classes")
