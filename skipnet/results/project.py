"""Results of many scans as JSON and as a page."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING

from skipnet.provenance import versions
from skipnet.results.pair import footer, registration_fields
from skipnet.storage import plain
from skipnet.types import FloatArray
from skipnet.viz import html

if TYPE_CHECKING:
    from skipnet.projects.project import MultiviewResult


def poses_json(result: MultiviewResult, names: Sequence[str], seed: int) -> str:
    """``poses.json``: each scan's transform into the first's frame (null: no place), and the pairs.

    A pair's ``T_target_source`` maps scan number ``source`` into the frame of scan number
    ``target``. ``rejected`` says that it contradicts more trusted pairs and had no say, and
    ``closure_m`` how far the final poses put the scans from where the pair itself does (null:
    not registered, or without a place).
    """
    scans = [
        {"path": name, "T_first_scan": T_first_scan}
        for name, T_first_scan in zip(names, result.T_first_scan, strict=True)
    ]
    pairs = [
        {
            "target": target,
            "source": source,
            **registration_fields(pair),
            "rejected": (target, source) in result.rejected,
            "closure_m": result.closures_m.get((target, source)),
        }
        for (target, source), pair in result.pairs.items()
    ]
    content = {
        "status": result.status,
        "reason": result.reason,
        "scans": scans,
        "pairs": pairs,
        "timings_s": result.timings_s,
        "seed": seed,
        "versions": versions(),
    }
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def scans_page(result: MultiviewResult, names: Sequence[str], png: bytes, seed: int) -> str:
    """``report.html`` of many scans: where each stands, and what every pair said."""
    places = [
        (number, name, *_origin(T_first_scan))
        for number, (name, T_first_scan) in enumerate(zip(names, result.T_first_scan, strict=True))
    ]
    pairs = [
        (
            f"{source} into {target}",
            f"{pair.status}, rejected" if key in result.rejected else pair.status,
            f"{pair.confidence:.2f}",
            pair.reason,
            f"{1000 * result.closures_m[key]:.1f}" if key in result.closures_m else "",
        )
        for key, pair in result.pairs.items()
        for target, source in [key]
    ]
    seconds = [(stage, f"{time_s:.3f}") for stage, time_s in result.timings_s.items()]
    return html.page(
        f"Registration of {len(names)} scans",
        html.status_banner(result.status, result.reason),
        html.picture(png, "Every placed scan in the frame of the first."),
        html.section("Scans", html.table(["number", "file", "x (m)", "y (m)", "z (m)"], places)),
        html.paragraph(
            "x, y, z: the scan's origin in the frame of the first; empty where it found no place."
        ),
        html.section(
            "Pairs",
            html.table(["pair", "status", "confidence", "reason", "closure (mm)"], pairs),
            html.paragraph(
                "closure: how far the final poses put the two scans from where the pair itself "
                "does. rejected: the pair contradicts more trusted ones and had no say."
            ),
        ),
        html.section("Time", html.table(["stage", "seconds"], seconds)),
        footer(seed),
    )


def _origin(T_first_scan: FloatArray | None) -> list[str]:
    if T_first_scan is None:
        return ["", "", ""]
    return [f"{coordinate_m:.3f}" for coordinate_m in T_first_scan[:3, 3]]
