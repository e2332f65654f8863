"""The options of a command, composed from its YAML files and the command line, and their help."""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from omegaconf import DictConfig


def composed(
    name: str, schema: type, config_dir: Path, overrides: Sequence[str]
) -> tuple[DictConfig, DictConfig]:
    """The options as the YAML files and the overrides make them, and Hydra's own."""
    from hydra import compose, initialize_config_dir
    from omegaconf import open_dict, read_write

    store(name, schema)
    with initialize_config_dir(str(config_dir.resolve()), version_base="1.3"):
        own = compose(name, list(overrides), return_hydra_config=True)
    of_hydra = own.hydra
    with read_write(own), open_dict(own):
        del own["hydra"]
    return own, of_hydra


def is_plain(flags: Namespace) -> bool:
    """Whether nothing is asked of Hydra but to compose the options of one run."""
    asked = any(value for flag, value in vars(flags).items() if flag != "overrides")
    return not asked and not any(one.lstrip("+~").startswith("hydra") for one in flags.overrides)


def store(name: str, schema: type) -> None:
    """Let the YAML file of a command list its schema; those of studies lie in a folder."""
    from hydra.core.config_store import ConfigStore

    ConfigStore.instance().store(f"{name.split('/')[-1]}_schema", schema)


def help_text(name: str, schema: type, config_dir: Path, overrides: Sequence[str]) -> str:
    """What Hydra would answer to ``--help``, in half the time: it looks through its plugins first.

    The template is ``hydra.help.template`` of the script's YAML file.
    """
    from omegaconf import OmegaConf

    own, of_hydra = composed(name, schema, config_dir, overrides)
    groups = {
        folder.name: ", ".join(sorted(file.stem for file in folder.glob("*.yaml")))
        for folder in sorted(config_dir.iterdir())
        if folder.is_dir()
    }
    return Template(of_hydra.help.template).substitute(
        APP_CONFIG_GROUPS="".join(f"{group}: {names}\n" for group, names in groups.items()),
        CONFIG=OmegaConf.to_yaml(own),
    )
