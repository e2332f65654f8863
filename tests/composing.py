"""Options as the command line composes them, for tests."""

from __future__ import annotations

from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra.core.config_store import ConfigStore
from omegaconf import OmegaConf

from skipnet.benchmark.options import EvaluateConfig

CONFIGS = Path(__file__).parents[1] / "configs"


def evaluate_options(*overrides: str) -> EvaluateConfig:
    """What ``python evaluate.py OVERRIDES`` would run."""
    ConfigStore.instance().store(name="evaluate_schema", node=EvaluateConfig)
    with initialize_config_dir(str(CONFIGS), version_base="1.3"):
        composed = compose("evaluate", ["output_dir=run", *overrides])
    options = OmegaConf.to_object(composed)
    assert isinstance(options, EvaluateConfig)
    return options
