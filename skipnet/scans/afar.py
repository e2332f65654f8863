"""Where a thing was seen from that stood before its scanner: found from what was seen of it.

Scanners of things on turntables write their views in the frame of the thing, and nobody knows where
the scanner stood. But of what one sensor saw from afar its points thin out with the cosine of the
angle to it, nothing hides the rest, and a solid thing curls away from who looks at it.
"""

from __future__ import annotations

import numpy as np

from skipnet.scans.viewpoint import (
    MIN_SLANT_COSINE,
    density_falloff,
    diagonal_m,
    most_hidden,
)
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray

MIN_FALLOFF = 0.22
"""Correlation of the density with the cosine; views of figures have 0.40 and more."""
MIN_CONVEXITY = 0.2
"""So much more of it must be bulges than hollows for the near side to be known: simulated figures
have 0.35 and more, sculptures full of folds 0.2, ground, rooms and streets that it tells wrongly
0.15 at most."""
MAX_HIDDEN = 0.15
"""From afar no more of it may be hidden; of simulated figures at most 7 % are."""
MAX_BEHIND = 0.03
"""A place as far behind may not agree by so much more with the density. Of 100 simulated views of
figures it does by 0.002 at most, of a smooth dome by 0.02; of 24 into bowls with things in them,
which are taken for domes seen from below, by 0.055 and more. A smooth dish is still taken so."""
EXPLAINED = 0.45
"""A place that agrees so well with the density is the sensor's: no others are looked for."""
CLEARLY, OUTSIDE_EXTENTS = 0.1, 0.5
"""A sensor's true place agrees with the density no worse than one afar, but for 0.02, and lies at
least so far off; places within a figure agree by 0.02 to 0.6 less."""
_BENT_PER_VOXEL = 0.02
"""What bends by less is flat."""
_STEPS = 2 * (np.stack(np.unravel_index(np.arange(27), (3, 3, 3)), axis=1) - 1)
"""(27, 3) to the voxels whose normals are compared."""
_SAMPLES, _DIRECTIONS = 1000, 150
_AFAR_EXTENTS = 2.5
"""A place so far off, in the scan's own extent, shows the thing as from where a scanner stands."""


def side_seen(skipmap: SkipMap, fine: SkipMap, other_m: FloatArray) -> FloatArray | None:
    """From which side a scan was taken, if it shows one side of a thing.

    Args:
        skipmap: the scan's Skip-map; its own viewpoint does not matter.
        fine: the same scan's at the finest level, as ``trust_in`` wants it.
        other_m: (3,) where the sensor may have stood as well, in the Skip-maps' frame: a place afar
            must agree better with the scan's density.

    Returns:
        (3,) a place afar on that side, in the Skip-maps' frame; the sensor may have stood nearer,
        or somewhat aside. None where nothing tells.
    """
    if len(skipmap) < 3:
        return None
    than = density_falloff(skipmap, other_m)
    if than > EXPLAINED:
        return None
    rows = np.linspace(0, len(skipmap) - 1, min(len(skipmap), _SAMPLES)).astype(np.int64)
    way, falloff = _thinning(skipmap, rows)
    centre_m, extent_m = skipmap.centroids_m.mean(axis=0), diagonal_m(skipmap.centroids_m)
    is_outside = np.linalg.norm(other_m - centre_m) > OUTSIDE_EXTENTS * extent_m
    if falloff < max(MIN_FALLOFF, than + CLEARLY * is_outside):
        return None
    convexity = _convexity(skipmap, rows, way)
    if abs(convexity) < MIN_CONVEXITY:
        return None
    place_m: FloatArray = centre_m + _AFAR_EXTENTS * extent_m * np.sign(convexity) * way
    behind = density_falloff(skipmap, 2 * centre_m - place_m)
    if behind - density_falloff(skipmap, place_m) > MAX_BEHIND:
        return None
    hidden = most_hidden((skipmap, fine), place_m, MAX_HIDDEN)
    return place_m if hidden < MAX_HIDDEN else None


def _thinning(skipmap: SkipMap, rows: IntArray) -> tuple[FloatArray, float]:
    """(3,) unit direction, of either sign, along which K voxels' points thin out the most by the
    cosine, and the correlation of these logarithms, -1 to 1."""
    ways = _half_sphere(_DIRECTIONS)
    cosines = np.abs(skipmap.normals[rows] @ ways.T)
    seen = (cosines > MIN_SLANT_COSINE).astype(np.float64)
    number = np.maximum(seen.sum(axis=0), 1)

    def about_mean(logarithms: FloatArray) -> FloatArray:
        """(K, D) less the mean of what is seen along each direction, 0 for the rest."""
        kept: FloatArray = seen * logarithms
        return kept - seen * (kept.sum(axis=0) / number)

    expected = about_mean(np.log(np.maximum(cosines, MIN_SLANT_COSINE)))
    found = about_mean(np.log(skipmap.counts[rows])[:, None])
    both = np.sqrt((expected**2).sum(axis=0) * (found**2).sum(axis=0))
    falloff = (expected * found).sum(axis=0) / np.maximum(both, 1e-12)
    best = int(falloff.argmax())
    return ways[best], float(falloff[best])


def _half_sphere(count: int) -> FloatArray:
    """(D, 3) unit directions, evenly spread over a half sphere, on a Fibonacci spiral."""
    height = (np.arange(count) + 0.5) / count
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    width = np.sqrt(1 - height**2)
    return np.column_stack([width * np.cos(angle), width * np.sin(angle), height])


def _convexity(skipmap: SkipMap, rows: IntArray, way: FloatArray) -> float:
    """Share of K voxels' surroundings that bulge towards a direction less the share that is hollow
    from there, -1 to 1."""
    near = skipmap.find_around(rows, _STEPS)
    first, second = np.broadcast_to(rows[:, None], near.shape)[near >= 0], near[near >= 0]
    turned = skipmap.normals * np.where(skipmap.normals @ way < 0, -1.0, 1.0)[:, None]
    apart = (skipmap.centroids_m[second] - skipmap.centroids_m[first]) / skipmap.voxel_size_m
    opening = np.einsum("pi,pi->p", apart, turned[second] - turned[first])
    bent = opening / np.maximum(np.einsum("pi,pi->p", apart, apart), 1e-9)
    smooth = np.einsum("pi,pi->p", turned[first], turned[second]) > 0
    if not smooth.any():
        return 0.0
    bulges, hollows = bent[smooth] > _BENT_PER_VOXEL, bent[smooth] < -_BENT_PER_VOXEL
    return float(bulges.mean() - hollows.mean())
