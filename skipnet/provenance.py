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
