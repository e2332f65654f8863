"""What a registration writes for programs (JSON) and for people (one HTML file)."""

from __future__ import annotations

import json
import math
import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING, Any

import numpy as np

import skipnet
from skipnet.types import FloatArray, Registration
from skipnet.viz import html

if TYPE_CHECKING:
    from skipnet.registration.multiview import MultiviewResult

_LONGEST_DETAIL = 200
_PACKAGES = ("numpy", "numba", "scipy", "small_gicp", "torch", "open3d")


def result_json(result: Registration, inputs: Mapping[str, str], seed: int) -> str:
    """``result.json``: every field of the result, transforms as lists, and where it came from."""
    content = {
        **_registration(result),
        "inputs": dict(inputs),
        "seed": seed,
        "versions": versions(),
    }
    return json.dumps(plain(content), indent=2, allow_nan=False) + "\n"


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
            **_registration(pair),
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


def pair_page(result: Registration, inputs: Mapping[str, str], png: bytes, seed: int) -> str:
    """``report.html`` of a pair.

    Args:
        result: of the registration.
        inputs: "source" and "target" with their descriptions.
        png: the picture before and after.
        seed: of the run.
    """
    seconds = [(stage, f"{time_s:.3f}") for stage, time_s in result.timings_s.items()]
    seconds.append(("total", f"{sum(result.timings_s.values()):.3f}"))
    details = [(name, _brief(value)) for name, value in result.details.items()]
    return html.page(
        "Registration of two scans",
        html.status_banner(result.status, result.reason, result.confidence),
        html.picture(
            png, "Both scans in the target's frame, as they came and with the motion found."
        ),
        html.section(
            "The motion found",
            html.paragraph("p_target = T_target_source p_source, in metres, after fine alignment:"),
            html.matrix(result.T_target_source),
            html.paragraph(_uncertainty(result)),
            html.paragraph("Before fine alignment:"),
            html.matrix(result.T_target_source_coarse),
        ),
        html.section("Inputs", html.table(["", ""], list(inputs.items()))),
        html.section("Time", html.table(["stage", "seconds"], seconds)),
        html.section("Details", html.table(["", ""], details)) if details else "",
        _footer(seed),
    )


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
        _footer(seed),
    )


def versions() -> dict[str, str]:
    """Version of skipnet, Python and the packages that decide the numbers."""
    found = {"skipnet": skipnet.__version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "not installed"
    return found


def plain(value: Any) -> Any:
    """Values as JSON knows them: arrays as lists, NaN and infinity as null, the rest as text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, bool | int | str) else str(value)


def _registration(result: Registration) -> dict[str, Any]:
    return {
        "status": result.status,
        "confidence": result.confidence,
        "reason": result.reason,
        "T_target_source": result.T_target_source,
        "T_target_source_coarse": result.T_target_source_coarse,
        "timings_s": result.timings_s,
        "details": result.details,
    }


def _uncertainty(result: Registration) -> str:
    """How exact the pose is, if it is right; empty where nothing was matched."""
    position_m = result.details.get("position_std_m")
    rotation_rad = result.details.get("rotation_std_rad")
    if not isinstance(position_m, float) or not isinstance(rotation_rad, float):
        return ""
    return (
        "If the pose is right, the scatter of the matched surfaces leaves a standard deviation of "
        f"{1000 * position_m:.3g} mm at their centre and of {math.degrees(rotation_rad):.2g} deg."
    )


def _origin(T_first_scan: FloatArray | None) -> list[str]:
    if T_first_scan is None:
        return ["", "", ""]
    return [f"{coordinate_m:.3f}" for coordinate_m in T_first_scan[:3, 3]]


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


def _footer(seed: int) -> str:
    used = ", ".join(f"{name} {number}" for name, number in versions().items())
    return html.footer(f"seed {seed}; {used}")
