"""What a registration writes for programs (JSON) and for people (one HTML file)."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from skipnet.provenance import versions
from skipnet.registration.result import Registration
from skipnet.results.views import advice, words_of
from skipnet.storage import plain
from skipnet.types import FloatArray
from skipnet.viz import html
from skipnet.viz.lengths import Lengths

_LONGEST_DETAIL = 200
_FROM_THE_TARGET = (
    "How far the source's points lie from the nearest point of the target in the pose above. "
)


def result_json(
    result: Registration,
    inputs: Mapping[str, str],
    facts: Mapping[str, Sequence[str]],
    seed: int,
    lengths: Lengths,
) -> str:
    """``result.json``: every field of the result, transforms as lists, and where it came from.

    Args:
        result: of the registration.
        inputs: "source" and "target" with their paths.
        facts: what was read of each, beside its points.
        seed: of the run.
        lengths: the unit of the target's file; where that is not the metre, the pose is given in
            it, too, as ``T_target_source_in_unit``.
    """
    in_unit = lengths.pose(result.T_target_source)
    content = {
        **registration_fields(result),
        "unit": lengths.unit,
        **({} if lengths.unit == "m" else {"T_target_source_in_unit": in_unit}),
        "inputs": dict(inputs),
        "read": {name: list(words) for name, words in facts.items()},
        "seed": seed,
        "versions": versions(),
    }
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


def pair_page(
    result: Registration,
    inputs: Mapping[str, str],
    view: str,
    residuals_m: FloatArray,
    png: bytes,
    seed: int,
    lengths: Lengths,
) -> str:
    """``report.html`` of a pair.

    Args:
        result: of the registration.
        inputs: "source" and "target" with their descriptions.
        view: the HTML of both scans in 3-D.
        residuals_m: (N,) distances of the source's points from the target.
        png: the picture before and after.
        seed: of the run.
        lengths: how to speak of them.
    """
    words = words_of(result)
    tips = advice(result)
    seconds = [(stage, f"{time_s:.3f}") for stage, time_s in result.timings_s.items()]
    seconds.append(("total", f"{sum(result.timings_s.values()):.3f}"))
    details = [(name, _brief(value)) for name, value in result.details.items()]
    return html.page(
        "Registration of two scans",
        html.status_banner(result.status, result.reason, result.confidence),
        html.section("What to try", html.bullets(tips)) if tips else "",
        html.section("In 3-D", view),
        residual_section(_FROM_THE_TARGET, residuals_m, result.voxel_size_m, lengths),
        html.section(
            "From above and from the side",
            html.picture(png, f"Both scans in the target's frame. After: {words.note}"),
        ),
        _pose_section(words.heading, result, lengths),
        html.section("Inputs", html.table(["", ""], list(inputs.items()))),
        html.section("Time", html.table(["stage", "seconds"], seconds)),
        html.section("Details", html.table(["", ""], details)) if details else "",
        footer(seed),
    )


def residual_section(
    of_what: str, residuals_m: FloatArray, voxel_size_m: float, lengths: Lengths
) -> str:
    """How far points lie from others, in words and as a histogram."""
    return html.section(
        "Residuals",
        html.paragraph(of_what + _residuals(residuals_m, voxel_size_m, lengths)),
        html.histogram(
            lengths.in_small(1.0) * residuals_m,
            lengths.in_small(voxel_size_m),
            lengths.small_unit,
        ),
    )


def _pose_section(heading: str, result: Registration, lengths: Lengths) -> str:
    return html.section(
        heading,
        html.paragraph("p_target = T_target_source p_source, in metres, after fine alignment:"),
        html.matrix(result.T_target_source),
        *_in_unit(result.T_target_source, lengths),
        html.paragraph(_uncertainty(result, lengths)),
        html.paragraph("Before fine alignment:"),
        html.matrix(result.T_target_source_coarse),
    )


def registration_fields(result: Registration) -> dict[str, Any]:
    """What JSON keeps of a registration."""
    return {
        "status": result.status,
        "confidence": result.confidence,
        "reason": result.reason,
        "T_target_source": result.T_target_source,
        "T_target_source_coarse": result.T_target_source_coarse,
        "timings_s": result.timings_s,
        "details": result.details,
    }


def _in_unit(T_target_source: FloatArray, lengths: Lengths) -> list[str]:
    """The pose in the unit of the files, where that is another than the metre."""
    if lengths.unit == "m":
        return []
    return [
        html.paragraph(f"The same in {lengths.unit}, the unit of the target's file:"),
        html.matrix(lengths.pose(T_target_source)),
    ]


def _residuals(residuals_m: FloatArray, voxel_size_m: float, lengths: Lengths) -> str:
    """The residuals in words."""
    near_m = residuals_m[residuals_m < voxel_size_m]
    share = len(near_m) / max(len(residuals_m), 1)
    text = f"{share:.0%} lie within one voxel ({lengths.small(voxel_size_m)})"
    return (
        f"{text}, half of these within {lengths.small(float(np.median(near_m)))}."
        if share
        else text + "."
    )


def _uncertainty(result: Registration, lengths: Lengths) -> str:
    """How exact the pose is, if it is right; empty where nothing was matched."""
    found = result.findings
    if found is None:
        return ""
    turn_deg = math.degrees(found.rotation_std_rad)
    return (
        "If the pose is right, the scatter of the matched surfaces leaves a standard deviation of "
        f"{lengths.small(found.position_std_m)} at their centre and of {turn_deg:.2g} deg."
    )


def _brief(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    text = (
        np.array2string(value, precision=4, threshold=12)
        if isinstance(value, np.ndarray)
        else str(value)
    )
    text = " ".join(text.split())
    return text if len(text) <= _LONGEST_DETAIL else text[:_LONGEST_DETAIL] + " ..."


def footer(seed: int) -> str:
    """The end of a page: seed and versions."""
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return html.footer(f"seed {seed}; {used}")
