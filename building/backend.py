"""Builds skipnet by setuptools; a wheel gets machine code for the machine that builds it.

Compiling the loops takes half a minute, which ``pip install`` then pays instead of the first
registration. On another processor, Python or numba the wheel works too: it compiles there, as a
checkout does. ``SKIPNET_MACHINE_CODE=no`` leaves it out, for a wheel that goes to many machines.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import *  # noqa: F403
from setuptools.command.build_py import build_py

COMPILE = "from skipnet.commands.compile import compile_usual; compile_usual()"
NEEDED = "numba", "numpy", "pillow", "scipy", "small_gicp", "threadpoolctl"
"""What registering two scans imports."""


def is_wanted() -> bool:
    """Unless the environment says no."""
    return os.environ.get("SKIPNET_MACHINE_CODE", "yes").lower() not in ("no", "0", "false")


def get_requires_for_build_wheel(config_settings: dict[str, str] | None = None) -> list[str]:
    """setuptools' own needs, and those dependencies of skipnet's that compiling takes."""
    needs: list[str] = build_meta.get_requires_for_build_wheel(config_settings)
    if is_wanted():
        text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
        needs += [re.findall(rf'^    "({name}\b[^"]*)"', text, re.M)[0] for name in NEEDED]
    return needs


class BuildWithMachineCode(build_py):
    """Copies the package, then compiles what registering two scans needs into the copy."""

    def run(self) -> None:
        """Without machine code where it cannot be made: that is no reason not to install."""
        super().run()
        if self.editable_mode or not is_wanted():
            return
        folder = Path(self.build_lib).resolve()
        code = folder / "skipnet" / "machine_code"
        shutil.rmtree(code, ignore_errors=True)  # of an earlier build
        code.mkdir()
        print("skipnet: the loops are compiled, half a minute", flush=True)
        done = subprocess.run([sys.executable, "-c", COMPILE], cwd=folder, env=_environment(folder))
        if done.returncode:
            print("skipnet: not compiled ahead of time; the first registration does it", flush=True)


def _environment(folder: Path) -> dict[str, str]:
    """In which the copy is imported, and numba writes into it."""
    paths = [str(folder), *filter(None, [os.environ.get("PYTHONPATH")])]
    return os.environ | {
        "PYTHONPATH": os.pathsep.join(paths),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NUMBA_CACHE_LOCATOR_CLASSES": "skipnet.compiled.InstalledLocator",
    }
