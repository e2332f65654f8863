"""Bring scans into one frame: ``python register.py source=a.ply target=b.ply output_dir=out``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from skipnet import command
from skipnet.config import RegisterConfig

if TYPE_CHECKING:
    from skipnet.registration.multiview import MultiviewResult
    from skipnet.types import Registration


def main(config: RegisterConfig) -> Registration | MultiviewResult:
    """Register what the options name, write the results and return them.

    Raises:
        FileNotFoundError: an input is missing; said before anything slow is imported.
    """
    for path in config.inputs:
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file")
    from skipnet.registration import files

    choices = files.Choices(
        config.source_viewpoint,
        config.target_viewpoint,
        config.voxel_size_m,
        config.seed,
        config.registration,
    )
    folder = Path(config.output_dir)
    if config.scans:
        return files.register_scan_files(config.inputs, folder, choices)
    if config.inputs:
        source, target = config.inputs
        return files.register_pair_files(source, target, folder, choices)
    return files.register_simulated_pair(folder, choices)


def exit_code(result: Registration | MultiviewResult) -> int:
    """0 when registered, 3 when ambiguous or failed."""
    return command.EXIT_OK if result.status == "registered" else command.EXIT_NOT_REGISTERED


if __name__ == "__main__":
    configs = Path(__file__).parent / "configs"
    sys.exit(command.run("register", RegisterConfig, main, configs, exit_code))
