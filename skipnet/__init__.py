"""skipnet: markerless registration of 3D scans.

>>> import skipnet
>>> sorted(skipnet.__all__)
['Registration', '__version__', 'register']
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from skipnet.provenance import __version__

if TYPE_CHECKING:
    from skipnet.registration.pipeline import register
    from skipnet.registration.result import Registration

__all__ = ["Registration", "__version__", "register"]

_HOME_OF = {
    "register": "skipnet.registration.pipeline",
    "Registration": "skipnet.registration.result",
}


def __getattr__(name: str) -> object:
    """Import the public names when they are first used: ``import skipnet`` itself stays instant."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'skipnet' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)
