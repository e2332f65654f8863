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


def names() -> tuple[str, ...]:
    """The networks that come with the package."""
    return (SHIPPED, *sorted(path.stem for path in _WEIGHTS.glob("*.npz")))


def weights_file(network: str, option: str = "network") -> Path:
    """The file of weights of a network.

    Args:
        network: one of ``names``, or the path of a file that ``train.py`` wrote.
        option: how the user calls it, for the error.

    Raises:
        ValueError: neither a name nor a file that exists.
    """
    if not isinstance(network, str | os.PathLike):
        raise ValueError(f"{option}={network!r}: expected a name or the path of a file")
    if network == SHIPPED:
        return SHIPPED_WEIGHTS
    if network in names():
        return _WEIGHTS / f"{network}.npz"
    if Path(network).is_file():
        return Path(network)
    expected = suggestion(str(network), names())
    raise ValueError(f"{option}={network}: no such network or file{expected}, or a file's path")
