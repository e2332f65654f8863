"""What decided the numbers: versions of everything that took part."""

from __future__ import annotations

__version__ = "0.1.0"
"""Of skipnet; the package's own metadata is read off here."""
_PACKAGES = ("numpy", "numba", "scipy", "small_gicp", "torch", "open3d")


def versions() -> dict[str, str]:
    """Version of skipnet, Python and the packages that decide the numbers."""
    import platform
    from importlib.metadata import PackageNotFoundError, version

    found = {"skipnet": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def machine() -> dict[str, str]:
    """What it runs on: processor, the cores that it may use, memory and system."""
    import os
    import platform

    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": _field("/proc/cpuinfo", "model name") or platform.processor() or "unknown",
        "cores": str(cores),
        "memory": _gigabytes(_field("/proc/meminfo", "MemTotal")),
        "system": f"{platform.system()} {platform.machine()}",
    }


def _field(path: str, name: str) -> str:
    """The first value of that name in a file of Linux's; empty where there is none."""
    try:
        with open(path, encoding="utf-8") as file:
            lines = (line.partition(":") for line in file)
            return next((value.strip() for key, _, value in lines if key.strip() == name), "")
    except OSError:
        return ""


def _gigabytes(kilobytes: str) -> str:
    digits = kilobytes.removesuffix("kB").strip()
    return f"{int(digits) / 2**20:.0f} GB" if digits.isdigit() else "unknown"
