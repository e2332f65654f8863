"""skipnet: markerless registration of 3D scans.

>>> import skipnet
>>> " ".join(sorted(skipnet.__all__)[:5])
'Assembly Cloud Project Registration __version__'
>>> " ".join(sorted(skipnet.__all__)[5:])
'read_cloud read_points register register_many write_cloud'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from skipnet.provenance import __version__

if TYPE_CHECKING:
    from skipnet.clouds.cloud import Cloud
    from skipnet.clouds.formats.reading import read_cloud, read_points
    from skipnet.clouds.formats.writing import write_cloud
    from skipnet.projects.assembly import Assembly
    from skipnet.projects.project import Project
    from skipnet.projects.register import register_many
    from skipnet.registration.pipeline import register
    from skipnet.registration.result import Registration

__all__ = [
    "Assembly",
    "Cloud",
    "Project",
    "Registration",
    "__version__",
    "read_cloud",
    "read_points",
    "register",
    "register_many",
    "write_cloud",
]

_HOME_OF = {
    "Cloud": "skipnet.clouds.cloud",
    "read_cloud": "skipnet.clouds.formats.reading",
    "read_points": "skipnet.clouds.formats.reading",
    "Assembly": "skipnet.projects.assembly",
    "Project": "skipnet.projects.project",
    "register": "skipnet.registration.pipeline",
    "register_many": "skipnet.projects.register",
    "write_cloud": "skipnet.clouds.formats.writing",
    "Registration": "skipnet.registration.result",
}


def __getattr__(name: str) -> object:
    """Import the public names when they are first used: ``import skipnet`` itself stays instant."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'skipnet' has no attribute {name!r}")
    return getattr(import_module(_HOME_OF[name]), name)
