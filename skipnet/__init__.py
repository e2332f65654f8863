"""skipnet: markerless registration of 3D scans.

>>> import skipnet
>>> " ".join(sorted(skipnet.__all__)[:9])
'Assembly Cloud Prior Priors Project Registration RegistrationConfig SkipMap __version__'
>>> " ".join(sorted(skipnet.__all__)[9:])
'build_skipmap load_network read_cloud read_points register register_many write_cloud'
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

from skipnet.provenance import __version__

if TYPE_CHECKING:
    from skipnet.clouds.cloud import Cloud
    from skipnet.clouds.formats.reading import read_cloud, read_points
    from skipnet.clouds.formats.writing import write_cloud
    from skipnet.networks.catalog import find_network as load_network
    from skipnet.projects.assembly import Assembly
    from skipnet.projects.priors import Priors
    from skipnet.projects.project import Project
    from skipnet.projects.register import register_many
    from skipnet.registration.options import RegistrationConfig
    from skipnet.registration.pipeline import register
    from skipnet.registration.prior import Prior
    from skipnet.registration.result import Registration
    from skipnet.skipmap.skipmap import SkipMap, build_skipmap

__all__ = [
    "Assembly",
    "Cloud",
    "Prior",
    "Priors",
    "Project",
    "Registration",
    "RegistrationConfig",
    "SkipMap",
    "__version__",
    "build_skipmap",
    "load_network",
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
    "RegistrationConfig": "skipnet.registration.options",
    "Prior": "skipnet.registration.prior",
    "Priors": "skipnet.projects.priors",
    "SkipMap": "skipnet.skipmap.skipmap",
    "build_skipmap": "skipnet.skipmap.skipmap",
    "load_network": "skipnet.networks.catalog:find_network",
}


def __getattr__(name: str) -> object:
    """Import the public names when they are first used: ``import skipnet`` itself stays instant."""
    if name not in _HOME_OF:
        raise AttributeError(f"module 'skipnet' has no attribute {name!r}")
    module, _, own_name = _HOME_OF[name].partition(":")
    found = getattr(import_module(module), own_name or name)
    globals()[name] = found  # so that it is looked up once, and help() lists it
    return found


def __dir__() -> list[str]:
    """The public names, for help and completion."""
    return sorted({*__all__, *globals()})
