"""Options of ``train.py``."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from skipnet.checks import require
from skipnet.progress import Terminal
from skipnet.training.data.options import DataConfig, PatchKind, Split
from skipnet.training.deep_options import DeepTrainConfig
from skipnet.training.descriptor_options import DescriptorTrainConfig
from skipnet.training.matcher_options import MatcherTrainConfig


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
    matcher = "matcher"
    """For which keypoints of two scans are one place, upon what a deep network describes."""


class Device(Enum):
    """Where networks are trained."""

    cpu = "cpu"
    cuda = "cuda"
    mps = "mps"


@dataclass
class TrainConfig:
    """Options of ``train.py``."""

    experiment_name: str = "scenes"
    """Its name in reports."""
    network: NetworkKind = NetworkKind.two_heads
    """two_heads, or classes alone, as the paper's; hidden_sizes, activation, input_scaling and what
    says when to stop belong to the latter, descriptor.* to the former; deep.* to deep, matcher.* to
    matcher."""
    descriptor: DescriptorTrainConfig = field(default_factory=DescriptorTrainConfig)
    """How to train both heads."""
    deep: DeepTrainConfig = field(default_factory=DeepTrainConfig)
    """How to train the deep network."""
    matcher: MatcherTrainConfig = field(default_factory=MatcherTrainConfig)
    """How to train the matcher."""
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
    two heads, of the deep network and of the matcher."""
    compare_alone: bool = False
    """Train a network for the classes alone on the same samples, for the same tables."""
    compare_sklearn: bool = False
    """Train scikit-learn's classifiers on the same samples, for the same tables."""
    seed: int = 0
    """Of the weights' start, the order of the batches, the random split and the peers."""
    device: Device = Device.cpu
    """cpu, cuda or mps; the same seed gives the same bits on the cpu."""
    terminal: Terminal = Terminal.table
    """table: a bar, then what came out; quiet: errors alone; json: one line of JSON."""
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
        ships = self.network is not NetworkKind.classes
        require(ships or not self.ship, "ship", self.ship, "false, or another network than classes")
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
