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
    """Register what the options name, write the results and return them."""
    from skipnet.registration import files

    folder, inputs = Path(config.output_dir), config.inputs
    size_m, seed = config.voxel_size_m, config.seed
    if config.scans:
        return files.register_scan_files(inputs, folder, voxel_size_m=size_m, seed=seed)
    if not inputs:
        return files.register_simulated_pair(folder, voxel_size_m=size_m, seed=seed)
    return files.register_pair_files(
        source=inputs[0],
        target=inputs[1],
        output_dir=folder,
        source_viewpoint=config.source_viewpoint,
        target_viewpoint=config.target_viewpoint,
        voxel_size_m=size_m,
        seed=seed,
    )


def exit_code(result: Registration | MultiviewResult) -> int:
    """0 when registered, 3 when ambiguous or failed."""
    return command.EXIT_OK if result.status == "registered" else command.EXIT_NOT_REGISTERED


if __name__ == "__main__":
    configs = Path(__file__).parent / "configs"
    sys.exit(command.run("register", RegisterConfig, main, configs, exit_code))
