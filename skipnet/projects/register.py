"""Many scans at once: ``skipnet.register_many``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence

from skipnet.projects.assembly import Assembly
from skipnet.projects.blocks import Workers
from skipnet.projects.priors import Priors
from skipnet.projects.project import Progress, Project
from skipnet.registration.options import RegistrationConfig
from skipnet.scans.given import ScanLike
from skipnet.scans.scan import Viewpoint


def register_many(
    scans: Sequence[ScanLike],
    *,
    viewpoints: Sequence[Viewpoint] | None = None,
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
    folder: str | os.PathLike[str] | None = None,
    progress: Progress | None = None,
    workers: Workers | None = None,
    priors: Priors | None = None,
) -> Assembly:
    """Bring many scans together, in no order and without a guess, as far as they say for sure.

    Scans that nothing connects stay apart, those that fit in several places are named. To add scans
    later, use ``skipnet.Project``.

    Args:
        scans: two or more scans, each in its own frame, metres; as ``skipnet.register`` takes them.
        viewpoints: of each scan as in ``skipnet.register``; None finds all of them out.
        voxel_size_m: edge of a voxel; None chooses it from the data.
        seed: of every random choice.
        config: everything else; None takes the defaults.
        folder: where described scans and searched pairs are kept, so that a run that was ended goes
            on; None: nowhere.
        progress: told about the work as it goes on.
        workers: who searches the pairs; None: this process.
        priors: what somebody believes of the scans, by their numbers: judged, never trusted.

    Raises:
        ValueError: fewer than two scans, one that is no point cloud, or viewpoints that do not fit.
    """
    if isinstance(scans, str | os.PathLike) or not isinstance(scans, Iterable):
        raise ValueError(f"scans={scans!s}: expected two or more in a list")
    scans = list(scans)
    if viewpoints is None:
        viewpoints = ["auto"] * len(scans)
    if len(viewpoints) != len(scans):
        raise ValueError(
            f"got {len(viewpoints)} viewpoints for {len(scans)} scans: expected one each"
        )
    project = Project(
        folder, voxel_size_m=voxel_size_m, seed=seed, config=config, workers=workers, priors=priors
    )
    for scan, viewpoint in zip(scans, viewpoints, strict=True):
        project.add(scan, viewpoint)
    return project.solve(progress)
