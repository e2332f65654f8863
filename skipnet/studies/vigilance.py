"""Is the judge ever fooled? ``skipnet study vigilance``.

Registers pairs of simulated families, pairs of scans that share nothing (half of them from one
shell, with other furniture and openings), pairs that are alike and not the same, and scenes that
leave the answer open; counts who was right, what came back registered, and how far confidences are
from the shares that are right. The scenes are those of no fit.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from skipnet.geometry import pose_error
from skipnet.metrics.calibration import expected_calibration_error
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.degrading import add_passers_by
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import VIGILANCE, VIGILANCE_ALIKE, VIGILANCE_APART
from skipnet.simulation.situations.alike import KINDS, alike
from skipnet.studies.options import VigilanceConfig
from skipnet.studies.study import do_all, report
from skipnet.types import Pair
from skipnet.viz.tables import Table


class Setting(NamedTuple):
    """How a scene is scanned."""

    family: str
    scanner: str = "terrestrial"
    rotation: str = "any"
    passers_by: int = 0
    """Obstacles that stand in the way of each scan, other ones in each."""


POSITIVES = {
    "paper room": Setting("paper_room", rotation="yaw"),
    "paper room, any rotation": Setting("paper_room"),
    "paper room, passers-by": Setting("paper_room", passers_by=6),
    "rings": Setting("paper_room", "rings"),
    "rings, oblique rooms": Setting("oblique", "rings"),
    "oblique": Setting("oblique"),
    "doorway": Setting("doorway"),
}
SAME_SHELL = Setting("paper_room")
OTHERS = (
    Setting("oblique"),
    Setting("closed"),
    Setting("curved"),
    Setting("doorway"),
    Setting("paper_room", "rings"),
    Setting("paper_room", passers_by=6),
)
OPEN = {"symmetric": Setting("symmetric"), "corridor": Setting("corridor")}
NEVER_RIGHT: dict[str, Any] = {"success_rotation_rad": 0.0, "success_translation_m": 0.0}
STATUSES = ("registered", "ambiguous", "failed")


@dataclass(frozen=True)
class Case:
    """One registration to make."""

    group: str
    setting: Setting
    source_seed: int
    target_seed: int
    """The same scene where these are equal."""

    @property
    def name(self) -> str:
        """All that the outcome depends on."""
        setting = "/".join(map(str, self.setting))
        return f"{self.group}: {setting} {self.source_seed}-{self.target_seed}"


@dataclass(frozen=True)
class Alike:
    """Two to register that are alike and not the same."""

    kind: str
    seed: int

    @property
    def group(self) -> str:
        """Row of the table."""
        return f"alike, {self.kind}"

    @property
    def name(self) -> str:
        """All that the outcome depends on."""
        return f"{self.group}: {self.seed}"


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    status: str
    confidence: float
    right: bool
    rotation_deg: float
    translation_mm: float


Judged = tuple[Case | Alike, Outcome]


def run(config: VigilanceConfig) -> dict[str, Any]:
    """Try every case and report; the summary comes back."""
    every: list[Case | Alike] = [*cases(config.pairs, config.negatives, config.seed)]
    every += alike_cases(config.alike, config.seed)
    chosen = {case.name: case for case in every}
    found = do_all(chosen, try_case, Path(config.output_dir), config.workers)
    judged = [(case, Outcome(**one)) for case, one in zip(chosen.values(), found, strict=True)]
    error = calibration_error(judged)
    fooled = sum(o.status == "registered" and not o.right for _, o in judged)
    return report(
        config,
        "Vigilance: is the judge ever fooled?",
        {
            "scans": f"{config.pairs} pairs of each kind, {config.negatives} that share nothing, "
            f"{config.alike} that are alike",
            "scenes": f"from number {config.seed} of {VIGILANCE.first}, {VIGILANCE_APART.first} "
            f"and {VIGILANCE_ALIKE.first}",
        },
        [counts_table(judged), surprises_table(judged)],
        sentences=[
            f"{fooled} of {len(judged)} came back registered with a wrong pose.",
            f"Expected calibration error: {error:.3f}.",
        ],
        calibration_error=error,
        registered_wrong=fooled,
        cases=len(judged),
    )


def cases(pairs: int, negatives: int, skip: int = 0) -> list[Case]:
    """Every registration of a run; negatives are half from one shell, half from all families.

    Args:
        pairs: of each group of one right answer.
        negatives: of scans that share nothing.
        skip: scenes of either range to pass over.
    """
    seeds = VIGILANCE.take(pairs, skip if pairs else 0)
    chosen = [
        Case(group, setting, seed, seed)
        for group, setting in (*POSITIVES.items(), *OPEN.items())
        for seed in seeds[: None if group in POSITIVES else max(pairs // 5, 1)]
    ]
    # A negative takes the next scene, too: that of the target.
    apart = VIGILANCE_APART.take(negatives + 1, skip)
    for index, seeds_of_two in enumerate(zip(apart, apart[1:], strict=False)):
        setting = SAME_SHELL if index % 2 == 0 else OTHERS[index // 2 % len(OTHERS)]
        group = "negatives, one shell" if index % 2 == 0 else "negatives, other rooms"
        chosen.append(Case(group, setting, *seeds_of_two))
    return chosen


def alike_cases(count: int, skip: int = 0) -> list[Alike]:
    """So many of all kinds in turn, each with a seed of its own; none has a right answer."""
    seeds, kinds = VIGILANCE_ALIKE.take(count, skip), list(KINDS)
    return [Alike(kinds[k % len(kinds)], seed) for k, seed in enumerate(seeds, skip)]


def try_case(case: Case | Alike) -> dict[str, Any]:
    """Register one case; the fields of an ``Outcome``."""
    pair = _of_one_kind(case) if isinstance(case, Alike) else _of_scenes(case)
    result = register(pair.source_m, pair.target_m)
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    right = rotation_rad < pair.success_rotation_rad and translation_m < pair.success_translation_m
    rotation_deg, translation_mm = float(np.rad2deg(rotation_rad)), 1000 * translation_m
    outcome = Outcome(str(result.status), result.confidence, right, rotation_deg, translation_mm)
    return asdict(outcome)


def _of_one_kind(case: Alike) -> Pair:
    two = alike(case.kind, case.seed)
    return Pair(case.name, case.kind, two.source_m, two.target_m, np.eye(4), **NEVER_RIGHT)


def _of_scenes(case: Case) -> Pair:
    pair, other = (_pair(case.setting, seed) for seed in (case.source_seed, case.target_seed))
    never = {} if case.source_seed == case.target_seed else NEVER_RIGHT
    return replace(pair, target_m=other.target_m, **never)


def _pair(setting: Setting, seed: int) -> Pair:
    family, scanner, rotation, passers_by = setting
    pair = simulate_pair(family, seed, scanner=scanner, rotation=rotation).pair
    rng = np.random.default_rng([seed, 4])
    scans_m = [add_passers_by(p, passers_by, rng) for p in (pair.source_m, pair.target_m)]
    return replace(pair, source_m=scans_m[0], target_m=scans_m[1])


def counts_table(judged: Iterable[Judged]) -> Table:
    """One row per group: right and wrong by status, median error of the right ones."""
    groups: dict[str, list[Outcome]] = {}
    for case, outcome in judged:
        groups.setdefault(case.group, []).append(outcome)
    headers = (
        *("scans", "right", "registered, right", "registered, wrong", "ambiguous", "failed"),
        "median error (mm)",
    )
    rows = tuple((group, *_counts(members)) for group, members in groups.items())
    note = "Right: within 0.5 degrees and 30 mm. Median error: of the right ones."
    return Table("What came back", headers, rows, note)


def _counts(members: Sequence[Outcome]) -> tuple[str, ...]:
    counts = Counter((o.status, o.right) for o in members)
    errors_mm = [o.translation_mm for o in members if o.right]
    return (
        f"{sum(o.right for o in members)} of {len(members)}",
        str(counts["registered", True]),
        str(counts["registered", False]),
        *(str(counts[status, True] + counts[status, False]) for status in STATUSES[1:]),
        f"{np.median(errors_mm):.2f}" if errors_mm else "–",
    )


def surprises_table(judged: Iterable[Judged]) -> Table:
    """Every answer that is right and not registered, or registered and wrong."""
    rows = tuple(
        (
            case.name,
            outcome.status,
            f"{outcome.confidence:.2f}",
            f"{outcome.rotation_deg:.2f}",
            f"{outcome.translation_mm:.1f}",
        )
        for case, outcome in judged
        if (outcome.status == "registered") != outcome.right
    )
    headers = ("scans", "status", "confidence", "rotation (deg)", "translation (mm)")
    return Table("Not as it should be", headers, rows, folded=True)


def calibration_error(judged: Sequence[Judged]) -> float:
    """Expected calibration error of all that has one right answer, or none."""
    outcomes = [outcome for case, outcome in judged if case.group not in OPEN]
    return expected_calibration_error(
        np.array([o.confidence for o in outcomes]), np.array([float(o.right) for o in outcomes])
    )
