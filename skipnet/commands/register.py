"""Bring scans into one frame: ``skipnet register source=a.ply target=b.ply output_dir=out``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skipnet.checks import METRES_PER_UNIT, check_known, check_viewpoint, require
from skipnet.commands import hydra_app
from skipnet.commands.errors import EXIT_NOT_REGISTERED, EXIT_OK
from skipnet.progress import Terminal
from skipnet.registration.options import RegistrationConfig

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly
    from skipnet.registration.prior import Prior
    from skipnet.registration.result import Registration


@dataclass
class RegisterConfig:
    """Options of ``register.py``: two scans, many scans, or none: a simulated pair."""

    source: str | None = None
    """The scan to move, in any format that README lists."""
    target: str | None = None
    """The scan that stays."""
    scans: list[str] = field(default_factory=list)
    """Scans to bring into the frame of the first, instead of source and target: two or more files,
    a folder, a pattern such as scans/*.ply, or one E57 or PTX file that holds several."""
    unit: str = "auto"
    """Of the coordinates: m, cm, mm, km, ft, us_ft, in; auto: what the file says, else metres."""
    source_unit: str | None = None
    """Of the source's coordinates, where it is another; null: unit."""
    format: str = "auto"
    """Of aligned and merged clouds, beside PLY: pcd, las, laz, e57, xyz, csv; auto: the inputs'."""
    colour_by_scan: bool = False
    """Merged scans get one colour each, also where they have colours of their own."""
    output_dir: str = "runs/register"
    """Where the results are written, relative to where the user stands; made when missing."""
    source_viewpoint: Any = "auto"
    """Sensor position in the source's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    target_viewpoint: Any = "auto"
    """Sensor position in the target's frame: auto (find out), null (unknown) or [x,y,z] in m."""
    voxel_size_m: float | None = None
    """Voxel edge length in metres; null chooses it from the data."""
    prior: Any = None
    """A pose that somebody believes in, four rows of four numbers, or a file of them (text, or a
    result.json): judged like any other hypothesis, never trusted."""
    prior_position_std_m: float | None = None
    """How far its place may be off; null: three voxels."""
    prior_rotation_std_deg: float | None = None
    """How far its rotation may be off; null: three degrees."""
    priors: str | None = None
    """With scans=[...]: a YAML or CSV file of what is believed of them (rough positions, poses,
    links, non-links): further hypotheses and the order of work, judged and never trusted."""
    workers: int = 1
    """With scans=[...]: processes that search pairs; -1: as many as there are processors."""
    executor: str = "local"
    """Where these are: local, ray (a Ray cluster of this machine) or ray://host:port."""
    seed: int = 0
    """Seed of every random choice: the same input and seed give the same bits."""
    terminal: Terminal = Terminal.table
    """table: a bar, then what came out; quiet: errors alone; json: one line of JSON."""
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    """How to register."""

    def __post_init__(self) -> None:
        check_viewpoint("source_viewpoint", self.source_viewpoint)
        check_viewpoint("target_viewpoint", self.target_viewpoint)
        check_known("unit", self.unit, ("auto", *METRES_PER_UNIT))
        if self.source_unit is not None:
            check_known("source_unit", self.source_unit, ("auto", *METRES_PER_UNIT))
        require(self.seed >= 0, "seed", self.seed, "a whole number of at least 0")
        size_m = self.voxel_size_m
        fits = size_m is None or 0 < size_m < math.inf
        require(fits, "voxel_size_m", size_m, "metres above 0, or null")
        self._check_inputs()

    def _check_inputs(self) -> None:
        if (self.source is None) != (self.target is None):
            given = "source" if self.target is None else "target"
            raise ValueError(f"only {given} was given: give source=FILE and target=FILE together")
        if self.scans and self.source is not None:
            raise ValueError("scans=[...] and source=/target= exclude each other: give only one")
        stds = self.prior_position_std_m, self.prior_rotation_std_deg
        if self.prior is None and stds != (None, None):
            raise ValueError(
                "prior_position_std_m and prior_rotation_std_deg say how far a prior may be off: "
                "give it with prior=FILE"
            )
        if not self.scans and (self.priors, self.workers, self.executor) != (None, 1, "local"):
            raise ValueError("priors, workers and executor are for many scans: give scans=[...]")
        known = self.executor in ("local", "ray") or self.executor.startswith("ray://")
        require(known, "executor", self.executor, "local, ray or ray://host:port")
        require(
            self.workers == -1 or self.workers >= 1, "workers", self.workers, "1 or more, or -1"
        )
        for name in ("prior", "source_unit"):
            if self.scans and getattr(self, name) is not None:
                raise ValueError(f"{name} is for two scans: leave it out with scans=[...]")
        if self.scans and (self.source_viewpoint, self.target_viewpoint) != ("auto", "auto"):
            raise ValueError(
                "source_viewpoint and target_viewpoint are for two scans: with scans=[...] all "
                "viewpoints are found out; leave them out"
            )
        require(bool(self.output_dir), "output_dir", self.output_dir, "a folder")


def register(config: RegisterConfig) -> Registration | Assembly:
    """Register what the options name, write the results and return them.

    Raises:
        FileNotFoundError: an input is missing; said before anything slow is imported.
    """
    pair = [Path(name) for name in (config.source, config.target) if name is not None]
    beliefs = [] if config.priors is None else [Path(config.priors)]
    for path in [*pair, *beliefs]:
        if not path.exists():
            raise FileNotFoundError(f"{path}: no such file")
    from skipnet.results import files
    from skipnet.results.inputs import find_scans

    choices = files.Choices(
        config.source_viewpoint,
        config.target_viewpoint,
        config.voxel_size_m,
        config.seed,
        config.registration,
        config.unit,
        config.format,
        _prior(config),
        config.colour_by_scan,
        config.source_unit,
    )
    folder = Path(config.output_dir)
    if config.scans:
        from skipnet.projects.blocks import Workers
        from skipnet.results.many import register_scan_files

        priors = None if config.priors is None else Path(config.priors)
        workers = Workers(config.workers, config.executor)
        return register_scan_files(find_scans(config.scans), folder, choices, priors, workers)
    if pair:
        return files.register_pair_files(pair[0], pair[1], folder, choices)
    return files.register_simulated_pair(folder, choices)


def _prior(config: RegisterConfig) -> Prior | None:
    """The prior that the options name."""
    from skipnet.registration.prior import Prior
    from skipnet.results.priors import read_pose

    if config.prior is None:
        return None
    T_target_source = read_pose(config.prior)
    return Prior(T_target_source, config.prior_position_std_m, config.prior_rotation_std_deg)


def as_json(result: Registration | Assembly) -> dict[str, Any]:
    """What ``terminal=json`` prints: the fields of result.json, or where each scan stands."""
    from skipnet.projects.assembly import Assembly
    from skipnet.results.pair import registration_fields

    if not isinstance(result, Assembly):
        return registration_fields(result)
    names = ("groups", "T_group_scan", "status", "position_std_m", "rotation_std_rad", "timings_s")
    return {name: getattr(result, name) for name in names} | {
        "outcome": result.outcome,
        "reason": result.reason,
    }


def rows(result: Registration | Assembly) -> list[dict[str, Any]]:
    """What the table of a sweep says of a run."""
    if isinstance(result.status, str):
        confidence = getattr(result, "confidence", None)
        return [{"status": str(result.status), "confidence": confidence, "reason": result.reason}]
    return [{"status": str(result.outcome), "reason": result.reason}]


def exit_code(result: Registration | Assembly) -> int:
    """0 when registered, all scans in one frame if there are many; 3 when ambiguous or failed."""
    outcome = result.status if isinstance(result.status, str) else result.outcome
    return EXIT_OK if outcome == "registered" else EXIT_NOT_REGISTERED


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: its exit code."""
    return hydra_app.run(
        "register",
        RegisterConfig,
        register,
        exit_code,
        arguments,
        as_json=as_json,
        as_rows=rows,
        has_no_presets=True,
    )
