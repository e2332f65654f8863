"""Is the judge ever fooled? ``python -m skipnet.studies.vigilance [pairs] [negatives]``.

Registers pairs of simulated families, pairs of scans that share nothing (half of them from one
shell, with other furniture and openings), and scenes that leave the answer open; counts who was
right, what came back registered, and how far confidences are from the shares that are right. The
seeds lie apart from those that the confidence was fitted on.
"""

from __future__ import annotations

import os
import sys
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from skipnet.geometry import pose_error
from skipnet.metrics.calibration import expected_calibration_error
from skipnet.parallel.pools import worker_pool
from skipnet.registration.pipeline import register
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.simulation.seeds import VIGILANCE, VIGILANCE_APART
from skipnet.types import Pair

POSITIVES = {
    "paper room": ("paper_room", "terrestrial", "yaw"),
    "paper room, any rotation": ("paper_room", "terrestrial", "any"),
    "rings": ("paper_room", "rings", "any"),
    "rings, oblique rooms": ("oblique", "rings", "any"),
    "oblique": ("oblique", "terrestrial", "any"),
    "doorway": ("doorway", "terrestrial", "any"),
}
SAME_SHELL = ("paper_room", "terrestrial", "any")
OTHERS = (
    ("oblique", "terrestrial", "any"),
    ("closed", "terrestrial", "any"),
    ("curved", "terrestrial", "any"),
    ("doorway", "terrestrial", "any"),
    ("paper_room", "rings", "any"),
)
OPEN = {
    "symmetric": ("symmetric", "terrestrial", "any"),
    "corridor": ("corridor", "terrestrial", "any"),
}


STATUSES = ("registered", "ambiguous", "failed")


@dataclass(frozen=True)
class Case:
    """One registration to make."""

    group: str
    recipe: tuple[str, str, str]
    """Family, scanner and rotation."""
    source_seed: int
    target_seed: int
    """The same scene where these are equal."""


@dataclass(frozen=True)
class Outcome:
    """What came of it."""

    case: Case
    status: str
    confidence: float
    right: bool
    rotation_rad: float
    translation_m: float


def cases(pairs: int, negatives: int) -> list[Case]:
    """Every registration of a run; negatives are half from one shell, half from all families."""
    seeds = VIGILANCE.take(pairs)
    chosen = [
        Case(group, recipe, seed, seed)
        for group, recipe in (*POSITIVES.items(), *OPEN.items())
        for seed in seeds[: None if group in POSITIVES else max(pairs // 5, 1)]
    ]
    for index, seed in enumerate(VIGILANCE_APART.take(negatives + 1)[:negatives]):
        recipe = SAME_SHELL if index % 2 == 0 else OTHERS[index // 2 % len(OTHERS)]
        group = "negatives, one shell" if index % 2 == 0 else "negatives, other rooms"
        chosen.append(Case(group, recipe, seed, seed + 1))
    return chosen


def try_case(case: Case) -> Outcome:
    """Register one case."""
    pair, other = (_pair(case.recipe, seed) for seed in (case.source_seed, case.target_seed))
    result = register(pair.source_m, other.target_m)
    rotation_rad, translation_m = pose_error(result.T_target_source, pair.T_target_source)
    right = (
        case.source_seed == case.target_seed
        and rotation_rad < pair.success_rotation_rad
        and translation_m < pair.success_translation_m
    )
    return Outcome(case, result.status, result.confidence, right, rotation_rad, translation_m)


def _pair(recipe: tuple[str, str, str], seed: int) -> Pair:
    family, scanner, rotation = recipe
    return simulate_pair(family, seed, scanner=scanner, rotation=rotation).pair


def table(outcomes: Iterable[Outcome]) -> str:
    """Markdown: one row per group, right and wrong by status, median error of the right ones."""
    lines = [
        "| scans | right | registered, right | ... wrong | ambiguous | failed | median error |",
        "|---|---:|---:|---:|---:|---:|---:|",
    ]
    groups: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        groups.setdefault(outcome.case.group, []).append(outcome)
    for group, members in groups.items():
        counts = Counter((o.status, o.right) for o in members)
        errors_mm = [1000 * o.translation_m for o in members if o.right]
        status = {name: counts[name, True] + counts[name, False] for name in STATUSES}
        lines.append(
            f"| {group} | {sum(o.right for o in members)} of {len(members)} "
            f"| {counts['registered', True]} | {counts['registered', False]} "
            f"| {status['ambiguous']} | {status['failed']} "
            f"| {f'{np.median(errors_mm):.2f} mm' if errors_mm else ''} |"
        )
    return "\n".join(lines)


def calibration_error(outcomes: Sequence[Outcome]) -> float:
    """Expected calibration error of all that has one right answer, or none."""
    judged = [o for o in outcomes if o.case.group not in OPEN]
    return expected_calibration_error(
        np.array([o.confidence for o in judged]), np.array([float(o.right) for o in judged])
    )


def main(pairs: int = 50, negatives: int = 500) -> None:
    """Run all cases on all processors; print the table and every result that is not as it should
    be."""
    outcomes = []
    with worker_pool(os.cpu_count() or 1) as pool:
        for outcome in pool.map(try_case, cases(pairs, negatives)):
            outcomes.append(outcome)
            if (outcome.status == "registered") != outcome.right:
                sys.stderr.write(
                    f"{outcome.case.group}, seed {outcome.case.source_seed}: {outcome.status} "
                    f"({outcome.confidence:.2f}), {np.rad2deg(outcome.rotation_rad):.2f} deg, "
                    f"{1000 * outcome.translation_m:.1f} mm\n"
                )
    print(table(outcomes))
    print(f"\nexpected calibration error {calibration_error(outcomes):.3f}")


if __name__ == "__main__":
    main(*(int(argument) for argument in sys.argv[1:3]))
