"""Bring scans into one frame: ``python register.py source=a.ply target=b.ply output_dir=out``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

from skipnet import command
from skipnet.config import RegisterConfig

if TYPE_CHECKING:
    from skipnet.registration.files import Report


def main(config: RegisterConfig) -> Report:
    """Register what the options name, write the results and return them."""
    from skipnet.registration.files import register_files

    return register_files(
        config.inputs,
        config.output_dir,
        voxel_size_m=config.voxel_size_m,
        seed=config.seed,
    )


if __name__ == "__main__":
    sys.exit(
        command.run(
            "register",
            RegisterConfig,
            main,
            Path(__file__).parent / "configs",
            exit_code=lambda report: command.EXIT_OK if report.registered else command.EXIT_NOT_REGISTERED,
        )
    )
