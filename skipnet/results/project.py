"""Results of many scans as JSON and as a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.provenance import versions
from skipnet.results.pair import footer, registration_fields, residual_section
from skipnet.storage import plain
from skipnet.types import FloatArray, Status
from skipnet.viz import html
from skipnet.viz.lengths import Lengths

if TYPE_CHECKING:
    from skipnet.projects.assembly import Assembly


def poses_json(result: Assembly, names: Sequence[str], seed: int, lengths: Lengths) -> str:
    """``poses.json``: groups, each scan's pose in its group, and every pair that was tried.

    ``T_group_scan`` maps a scan into the frame of its group's first scan. A scan that is
    ``ambiguous`` is a group of its own; ``places`` lists where it may stand. A pair's
    ``T_target_source`` maps scan number ``source`` into the frame of scan number ``target``;
    ``word`` says what became of it, and ``closure_m`` how far the final poses put the middle of its
    overlap from where the pair alone does (null: no link of a group). Poses are in metres; where
    the files are not, ``T_group_scan_in_unit`` has them in ``unit``.
    """
    content = {
        "status": result.outcome,
        "reason": result.reason,
        "groups": result.groups,
        "unit": lengths.unit,
        "scans": [_scan(result, number, name, lengths) for number, name in enumerate(names)],
        "pairs": [_pair(result, key) for key in sorted(result.pairs)],
        "reliability": result.reliability,
        "timings_s": result.timings_s,
        "seed": seed,
        "versions": versions(),
    }
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def scans_page(
    result: Assembly,
    names: Sequence[str],
    view: tuple[str, FloatArray],
    pictures: tuple[bytes, bytes],
    seed: int,
    lengths: Lengths,
    inputs: Sequence[str],
) -> str:
    """``report.html`` of many scans: where each stands, what is in doubt, what every pair said.

    Args:
        result: of the registration.
        names: of the scans.
        view: the scans of the largest group in 3-D, as HTML, and the residuals of their points.
        pictures: of the same, and of the scans' places from above, with the links between them.
        seed: of the run.
        lengths: how to speak of them.
        inputs: what was read of every scan.
    """
    png, plan = pictures
    in_doubt = result.outcome is not Status.REGISTERED
    doubts = html.section("In doubt", *_doubts(result, names))
    voxel_size_m = next(iter(result.pairs.values())).voxel_size_m
    return html.page(
        f"Registration of {len(names)} scans",
        html.status_banner(result.outcome, result.reason),
        doubts if in_doubt else "",
        html.section("In 3-D", view[0]),
        residual_section(_FROM_OTHERS, view[1], voxel_size_m, lengths),
        html.picture(png, "The scans of the largest group, in the frame of its first."),
        html.picture(
            plan,
            "Every group from above, with its links. Thick: much overlap. Red: contradicts the "
            "others and has no say. Dashed: a pair that registered, but that other scans refute.",
        ),
        "" if in_doubt else doubts,
        html.section("Scans", _scans_table(result, names, lengths), _SCANS_HELP),
        html.section("Links", _links_table(result, lengths), _LINKS_HELP),
        html.section("Pairs", _pairs_table(result), _PAIRS_HELP),
        html.section("Inputs", html.bullets(inputs)),
        html.section(
            "Time",
            html.table(
                ["stage", "seconds"],
                [(stage, f"{time_s:.3f}") for stage, time_s in result.timings_s.items()],
            ),
        ),
        footer(seed),
    )


def _scan(result: Assembly, number: int, name: str, lengths: Lengths) -> dict[str, Any]:
    places = result.places.get(number, [])
    in_unit = {"T_group_scan_in_unit": lengths.pose(result.T_group_scan[number])}
    return {
        "path": name,
        "group": result.group_of[number],
        "status": result.status[number],
        "T_group_scan": result.T_group_scan[number],
        **({} if lengths.unit == "m" else in_unit),
        "position_std_m": result.position_std_m[number],
        "rotation_std_rad": result.rotation_std_rad[number],
        "places": [{"group": place.group, "T_group_scan": place.T_group_scan} for place in places],
    }


def _pair(result: Assembly, key: tuple[int, int]) -> dict[str, Any]:
    link = result.links.get(key)
    return {
        "target": key[0],
        "source": key[1],
        **registration_fields(result.pairs[key]),
        "word": result.words[key],
        "overlap": link and link.overlap,
        "violation": link and link.violation,
        "closure_m": link and link.closure_m,
        "weight": link and link.weight,
    }


def _doubts(result: Assembly, names: Sequence[str]) -> list[str]:
    """What is in doubt, and what would settle it, as paragraphs."""
    parts = []
    if result.reliability < _SURE and any(len(group) > 1 for group in result.groups):
        parts.append(
            f"Only {result.reliability:.0%} of the registered pairs hold: much looks alike here. "
            "A place that rests on one pair alone is therefore not believed."
        )
    for scan in [group[0] for group in result.groups if len(group) == 1]:
        count = len(result.places.get(scan, []))
        told = f"Scan {scan} ({names[scan]}) "
        if count == 0:
            told += "shares nothing with the others that would hold it. A scan between helps."
        elif count == 1:
            told += "may stand where the 3-D view shows it, but too little confirms it. "
            told += "A scan that sees this place and more of the others settles it."
        else:
            told += f"fits in {count} places about equally well. A scan from between them helps."
        parts.append(told)
    if sum(len(group) > 1 for group in result.groups) > 1:
        parts.append(
            "Nothing joins the groups for sure: they are of different places, or a scan between "
            "them is missing."
        )
    return [html.paragraph(part) for part in parts] or [html.paragraph("Nothing.")]


def _scans_table(result: Assembly, names: Sequence[str], lengths: Lengths) -> str:
    rows = [
        (
            number,
            name,
            result.group_of[number],
            result.status[number],
            *(f"{place:.3f}" for place in lengths.pose(result.T_group_scan[number])[:3, 3]),
            f"{lengths.in_small(result.position_std_m[number]):.2g}",
            f"{np.rad2deg(result.rotation_std_rad[number]):.3f}",
        )
        for number, name in enumerate(names)
    ]
    heads = ["number", "file", "group", "status"]
    heads += [f"{axis} ({lengths.unit})" for axis in "xyz"]
    heads += [f"+- ({lengths.small_unit})", "+- (deg)"]
    return html.table(heads, rows)


def _links_table(result: Assembly, lengths: Lengths) -> str:
    rows = [
        (
            f"{source} into {target}",
            f"{link.overlap:.3f}",
            f"{link.violation:.4f}",
            f"{lengths.in_small(link.closure_m):.3g}",
            f"{link.weight:.2f}",
        )
        for (target, source), link in sorted(result.links.items())
    ]
    return html.table(
        ["pair", "overlap", "violation", f"closure ({lengths.small_unit})", "weight"], rows
    )


def _pairs_table(result: Assembly) -> str:
    rows = [
        (
            f"{source} into {target}",
            pair.status,
            f"{pair.confidence:.2f}",
            result.words[target, source],
            pair.reason,
        )
        for (target, source), pair in sorted(result.pairs.items())
    ]
    return html.table(["pair", "status", "confidence", "word", "reason"], rows)


_SURE = 0.9
_FROM_OTHERS = "How far points of every scan in its place lie from the nearest point of another. "
_SCANS_HELP = html.paragraph(
    "x, y, z: the scan's origin in the frame of its group's first scan. +-: standard deviation "
    "against that scan, from what the links determine and how well they agree."
)
_LINKS_HELP = html.paragraph(
    "Scans of one group that overlap, in their final poses. closure: how far these put the middle "
    "of the overlap from where the pair alone does. weight: its say, 0 where it contradicts others."
)
_PAIRS_HELP = html.paragraph(
    "What every pair said by itself, and what became of it: holds, refuted by other scans, open "
    "(nothing else confirms it), none (it did not register)."
)
