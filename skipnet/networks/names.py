"""Networks by name: which file of weights is meant. Options import it: it needs no package."""

from __future__ import annotations

import os
from pathlib import Path

from skipnet.checks import suggestion

SHIPPED = "shipped"
"""The network that is used unless another is asked for, under a name of its own."""
DEEP = "deep"
"""The network of the generator of that name."""
_WEIGHTS = Path(__file__).parent / "weights"
SHIPPED_WEIGHTS = _WEIGHTS / "small.npz"
DEEP_WEIGHTS = _WEIGHTS / f"{DEEP}.npz"
MATCHER = "matcher"
"""The network that matches what the deep network describes."""
MATCHER_WEIGHTS = _WEIGHTS / f"{MATCHER}.npz"


def names() -> tuple[str, ...]:
    """The networks that come with the package, but for the matcher."""
    return tuple(_files())


def weights_file(network: str, option: str = "network") -> Path:
    """The file of weights of a network.

    Args:
        network: one of ``names``, or the path of a file that ``train.py`` wrote.
        option: how the user calls it, for the error.

    Raises:
        ValueError: neither a name nor a file that exists.
    """
    return _file_of(network, _files(), option)


def matcher_file(matcher: str) -> Path:
    """The file of weights of a matcher: the shipped one's, by its name, or a given one's.

    Raises:
        ValueError: neither its name nor a file that exists.
    """
    return _file_of(matcher, {MATCHER: MATCHER_WEIGHTS}, "matcher")


def _files() -> dict[str, Path]:
    """Weights that come with the package, by name."""
    others = {path.stem: path for path in sorted(_WEIGHTS.glob("*.npz"))}
    others.pop(MATCHER, None)
    return {SHIPPED: SHIPPED_WEIGHTS, **others}


def _file_of(network: str, files: dict[str, Path], option: str) -> Path:
    """See ``weights_file``."""
    if not isinstance(network, str | os.PathLike):
        raise ValueError(f"{option}={network!r}: expected a name or the path of a file")
    if network in files:
        return files[str(network)]
    if Path(network).is_file():
        return Path(network)
    expected = suggestion(str(network), tuple(files))
    raise ValueError(f"{option}={network}: no such network or file{expected}, or a file's path")
