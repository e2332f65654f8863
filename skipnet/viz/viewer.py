"""Scans in 3-D inside a page: turned, measured and coloured in any browser, nothing loaded."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np

from skipnet.checks import METRES_PER_UNIT
from skipnet.geometry import transform_points
from skipnet.types import FeatureClass, FloatArray
from skipnet.viz.colours import CLASS_COLOURS, CLASS_NAMES
from skipnet.viz.lengths import Lengths
from skipnet.viz.viewed import ViewedPose, ViewedScan, pack, pack_pose, some_rows

MOST_POINTS = 200_000
"""Of all scans together: a phone turns so many smoothly, and the page stays below 5 MB."""
_NO_COLOUR = "#A8A8A8"
_DOT_SHARE = 0.004
"""A dot's width as a share of the scans' extent."""
_CEILING_SHARE, _CEILING_POINTS, _BELOW_CEILING = 0.05, 0.12, 0.9
_MODES = ("scan", "own colours", "residual", "height", "curvature", "class")


def viewer(
    scans: Sequence[ViewedScan],
    poses: Sequence[ViewedPose],
    start: int = 0,
    brightest_m: float = 0.05,
    most: int = MOST_POINTS,
    matches: Sequence[tuple[int, int]] = (),
    lengths: Lengths | None = None,
) -> str:
    """The HTML of a view of scans with one button per pose.

    Args:
        scans: at least one; thinned where they are many points.
        poses: at least one.
        start: the pose shown first, to which the residuals belong.
        brightest_m: the residual shown in yellow.
        most: points of all scans together.
        matches: numbers of feature voxels of the first and of the second scan that correspond.
        lengths: in which unit to measure; None: metres.
    """
    lengths = lengths or Lengths()
    rows = [some_rows(scan.points_m, most // len(scans)) for scan in scans]
    thinned_m = [scan.points_m[kept] for scan, kept in zip(scans, rows, strict=True)]
    placed_m = _placed(poses[start], thinned_m)
    low_m, high_m = np.quantile(placed_m, [0.01, 0.99], axis=0)
    centre_m = np.round(0.5 * (low_m + high_m))
    extent_m = max(float(np.linalg.norm(high_m - low_m)), 1e-6)
    content = {
        "scans": [
            pack(scan, kept, points_m, brightest_m)
            for scan, kept, points_m in zip(scans, rows, thinned_m, strict=True)
        ],
        "poses": [pack_pose(pose, thinned_m, centre_m) for pose in poses],
        "start": start,
        "measured": start,
        "centre": centre_m.tolist(),
        "extent": extent_m,
        "bottom": float(low_m[2] - centre_m[2]),
        "top": float(max(high_m[2], low_m[2] + 1e-6) - centre_m[2]),
        "dot": _DOT_SHARE * extent_m,
        "unit": {"name": lengths.unit, "metres": METRES_PER_UNIT[lengths.unit]},
        "matches": [list(match) for match in matches],
        "palette": _palette(),
        "cut": _cut(placed_m[:, 2], low_m[2], high_m[2]),
    }
    return _page(scans, poses, start, lengths.small(brightest_m), content)


def _placed(pose: ViewedPose, clouds_m: Sequence[FloatArray]) -> FloatArray:
    """(N, 3) points of the scans that a pose has a place for, in the common frame."""
    pairs = zip(pose.T_common_scan, clouds_m, strict=True)
    return np.concatenate([transform_points(T, points_m) for T, points_m in pairs if T is not None])


def _page(
    scans: Sequence[ViewedScan],
    poses: Sequence[ViewedPose],
    start: int,
    brightest: str,
    content: dict[str, Any],
) -> str:
    """The canvas with its switches, and what the script draws on it."""
    modes = _modes(scans)
    return "\n".join(
        [
            f"<style>{_text('viewer.css')}</style>",
            # A form of its own: the buttons of several views on a page are apart.
            '<form class="viewer" onsubmit="return false">',
            _choices("pose", "shown", [pose.label for pose in poses], start) if poses[1:] else "",
            '<canvas tabindex="0" aria-label="scans in 3-D"></canvas>',
            '<p class="said"></p>',
            _switches(scans),
            _layers(scans, poses, content["matches"]),
            _choices("mode", "colour", [_MODES[mode] for mode in modes], 0, modes),
            f"<fieldset>{_slider('dot', 'dots', 0.3, 4, 1)}"
            f"{_slider('cut', 'hidden above', 0, 1, content['cut'])}</fieldset>",
            "<small>Drag to turn, wheel or pinch to zoom, shift or two fingers to move, click two "
            f"points to measure.{_scale(brightest) if 2 in modes else ''}</small>",
            f'<script type="application/json" class="scans">{_json(content)}</script>',
            f"<script>{_text('viewer.js')}</script>",
            "</form>",
        ]
    )


def _text(name: str) -> str:
    """A file beside this one."""
    return files("skipnet.viz").joinpath(name).read_text("utf-8")


def _scale(brightest: str) -> str:
    return f" Residuals: dark blue 0, yellow {brightest} and more."


def _json(content: object) -> str:
    """JSON that cannot end the script it stands in, whatever a file is called."""
    return json.dumps(content).replace("<", "\\u003c")


def _modes(scans: Sequence[ViewedScan]) -> list[int]:
    """The colourings for which there is something to show."""
    coloured = any(scan.colour is not None for scan in scans)
    measured = any(scan.residuals_m is not None for scan in scans)
    described = any(scan.skipmap is not None for scan in scans)
    own, residual = [1] if coloured else [], [2] if measured else []
    return [0, *own, *residual, 3, *([4, 5] if described else [])]


def _choices(
    name: str, legend: str, labels: Sequence[str], start: int, values: Sequence[int] | None = None
) -> str:
    buttons = "".join(
        f'<label><input type="radio" name="{name}" value="{value}"'
        f"{' checked' if number == start else ''}> {escape(label)}</label>"
        for number, (value, label) in enumerate(
            zip(values or range(len(labels)), labels, strict=True)
        )
    )
    return f"<fieldset><legend>{escape(legend)}</legend>{buttons}</fieldset>"


def _layers(
    scans: Sequence[ViewedScan], poses: Sequence[ViewedPose], matches: Sequence[object]
) -> str:
    """What can be shown beside the points, as far as there is some of it."""
    described = any(scan.skipmap is not None for scan in scans)
    names = {
        "skipmap": ("Skip-map", described),
        "features": ("feature voxels", described),
        "matches": ("matches", bool(matches)),
        "beside": ("two poses side by side", len(poses) > 1),
    }
    boxes = "".join(
        f'<label><input type="checkbox" name="{name}"> {label}</label>'
        for name, (label, is_there) in names.items()
        if is_there
    )
    legend = " ".join(
        f'<span><span class="swatch" style="background:{CLASS_COLOURS[kind]}"></span> {name}</span>'
        for kind, name in CLASS_NAMES.items()
    )
    classes = f"<br><small>{legend}</small>" if described else ""
    return f"<fieldset><legend>also</legend>{boxes}{classes}</fieldset>" if boxes else ""


def _palette() -> list[float]:
    """Red, green and blue of every class, and of what has none."""
    rows = [CLASS_COLOURS[kind] for kind in FeatureClass] + [_NO_COLOUR]
    return [int(row[k : k + 2], 16) / 255 for row in rows for k in (1, 3, 5)]


def _slider(name: str, label: str, low: float, high: float, start: float) -> str:
    return (
        f'<label>{label} <input type="range" name="{name}" min="{low}" max="{high}" step="0.01" '
        f'value="{start}"></label>'
    )


def _cut(heights_m: FloatArray, low_m: float, high_m: float) -> float:
    """The share of the height up to which points are shown at first: a ceiling hides its room."""
    in_ceiling = np.mean(heights_m > high_m - _CEILING_SHARE * (high_m - low_m))
    return _BELOW_CEILING if in_ceiling > _CEILING_POINTS else 1.0


def _switches(scans: Sequence[ViewedScan]) -> str:
    boxes = "".join(
        f'<label><input type="checkbox" name="scan" value="{number}" checked> '
        f'<span class="swatch" style="background:{scan.tint}"></span> {escape(scan.name)}</label>'
        for number, scan in enumerate(scans)
    )
    return f"<fieldset><legend>scans</legend>{boxes}</fieldset>"
