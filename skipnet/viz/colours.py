"""One palette for all pictures and pages."""

from __future__ import annotations

import numpy as np

from skipnet.types import FeatureClass, FloatArray, IntArray

SOURCE_COLOUR = "#D55E00"
TARGET_COLOUR = "#0072B2"
SCAN_COLOURS = (TARGET_COLOUR, SOURCE_COLOUR, "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#555555")
CLASS_COLOURS = {
    FeatureClass.FIRST_CORNER: "#D55E00",
    FeatureClass.SECOND_CORNER: "#0072B2",
    FeatureClass.OTHER_CORNER: "#CC79A7",
    FeatureClass.EDGE: "#009E73",
    FeatureClass.PLANE: "#D0D0D0",
}
CLASS_NAMES = {kind: kind.name.replace("_", " ").lower() for kind in FeatureClass}

CURVATURE_OF_BRIGHTEST = 0.12
"""Curvature shown as the brightest yellow: about that of a right-angled corner's neighbourhood."""


def scan_colour(index: int) -> str:
    """Colour of the scan with this number, as ``#RRGGBB``."""
    return SCAN_COLOURS[index % len(SCAN_COLOURS)]


def curvature_colours(curvatures: FloatArray) -> IntArray:
    """(V, 3) uint8 red, green, blue: dark blue for 0, yellow for ``CURVATURE_OF_BRIGHTEST``."""
    from matplotlib import colormaps

    share = np.clip(np.asarray(curvatures) / CURVATURE_OF_BRIGHTEST, 0, 1)
    return colormaps["plasma"](share, bytes=True)[:, :3]


def class_colours(classes: IntArray) -> IntArray:
    """(V, 3) uint8 red, green, blue of (V,) ``FeatureClass`` values."""
    from matplotlib.colors import to_rgb

    palette = np.array([to_rgb(CLASS_COLOURS[kind]) for kind in FeatureClass])
    return (palette * 255).round().astype(np.uint8)[np.asarray(classes)]
