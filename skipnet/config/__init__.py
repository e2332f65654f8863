"""Every option of every script, with default, unit and range: the schemas Hydra checks against.

A range is checked when the dataclass is made, so a bad value fails before any work is done.
Algorithms never see these classes: they take plain arrays and scalars.
"""

from skipnet.config.checks import require
from skipnet.config.descriptor import AugmentationConfig, DescriptorTrainConfig, Loss
from skipnet.config.evaluate import (
    DatasetKind,
    DisturbanceConfig,
    EvaluateConfig,
    ProtocolKind,
    SpeedConfig,
    VariantConfig,
    standard_variants,
)
from skipnet.config.register import Generator, RegisterConfig, RegistrationConfig, check_viewpoint
from skipnet.config.train import (
    Activation,
    DataConfig,
    Device,
    InputScaling,
    LabelConfig,
    NetworkKind,
    PatchKind,
    Split,
    TrainConfig,
)

__all__ = [
    "require",
    "AugmentationConfig",
    "DescriptorTrainConfig",
    "Loss",
    "DatasetKind",
    "DisturbanceConfig",
    "EvaluateConfig",
    "ProtocolKind",
    "SpeedConfig",
    "VariantConfig",
    "standard_variants",
    "Generator",
    "RegisterConfig",
    "RegistrationConfig",
    "check_viewpoint",
    "Activation",
    "DataConfig",
    "Device",
    "InputScaling",
    "LabelConfig",
    "NetworkKind",
    "PatchKind",
    "Split",
    "TrainConfig",
]
