"""What the matcher learns from: the keypoints of two scans, and which of them are one place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from skipnet.geometry import transform_points
from skipnet.metrics.correspondences import INLIER_VOXELS, TwoScans
from skipnet.networks.catalog import find_deep
from skipnet.networks.on_grids import OnGrids
from skipnet.networks.tokens import BOTH_SIDES_SHARE, Tokens, tokens_of
from skipnet.training.data.factory import make_scans
from skipnet.types import BoolArray, FloatArray, IntArray

SAME_COSINE = 0.4
"""One place is seen with axes that differ by less than the angle of this cosine: frames of
keypoints agree less well than normals."""
LEARNED_KEYPOINTS = 800
"""Of a scan: more than the matcher looks at, so that a step sees others each time."""
LEAST_SHARED = 6
"""Keypoints with a partner in the other scan; fewer teach nothing."""
MOST_CROPPED = 0.5
"""Of a scan's keypoints, where a side of it is cut away."""


@dataclass(frozen=True)
class Hiding:
    """What a step hides of what it shows: so that a few thousand pairs are not learned by heart."""

    cropped_share: float = 0.0
    """So often a side of each scan, in any direction, is cut away."""
    dropped_share: float = 0.0
    """Of the numbers of a keypoint; the others grow by as much."""
    jitter_voxels: float = 0.0
    """Deviation of a keypoint from its place, along each axis."""


NOTHING_HIDDEN = Hiding()


class Lesson(NamedTuple):
    """What a step shows of two scans."""

    source: Tokens
    target: Tokens
    same: torch.Tensor
    """(K, L) which keypoints are one place."""
    oriented: bool


@dataclass(frozen=True)
class TokenPair:
    """The keypoints of two scans."""

    source: Tokens
    """Units in float16."""
    target: Tokens
    """Where the sides of surfaces are not known the second half is the first turned over."""
    true_voxels: FloatArray
    """(K, 3) where the source's keypoints truly lie among the target's places, in voxels."""
    true_axes: FloatArray
    """(K, 3) and their axes."""
    oriented: bool

    def same(self, rows_s: IntArray, rows_t: IntArray) -> BoolArray:
        """(K, L) which of these keypoints are one place."""
        line = self.true_voxels[rows_s][:, None] - self.target.places_voxels[rows_t][None]
        near = (line**2).sum(axis=2) < INLIER_VOXELS**2
        cosine = self.true_axes[rows_s] @ self.target.axes[rows_t].T
        return near & (cosine > SAME_COSINE)

    def draw(self, count: int, rng: np.random.Generator, hiding: Hiding = NOTHING_HIDDEN) -> Lesson:
        """So many keypoints of each scan at random; where sides are unknown a third fewer of the
        target, from both sides. Every other time the scans change places."""
        each = len(self.target.axes) if self.oriented else len(self.target.axes) // 2
        shown = count if self.oriented else int(BOTH_SIDES_SHARE * count)
        places = self.source.places_voxels, self.target.places_voxels[:each]
        is_cropped = rng.random() < hiding.cropped_share
        left = [_cropped(one, rng) if is_cropped else np.arange(len(one)) for one in places]
        rows_s, rows_t = (
            np.sort(rng.permutation(rows)[:most])
            for rows, most in zip(left, (count, shown), strict=True)
        )
        if not self.oriented:
            rows_t = np.concatenate([rows_t, rows_t + each])
        same = torch.from_numpy(self.same(rows_s, rows_t))
        source = _blurred(_some(self.source, rows_s), hiding, rng)
        target = _blurred(_some(self.target, rows_t), hiding, rng)
        if self.oriented and rng.random() < 0.5:
            return Lesson(target, source, same.T, self.oriented)
        return Lesson(source, target, same, self.oriented)

    def whole(self) -> Lesson:
        """All keypoints."""
        rows_s, rows_t = np.arange(len(self.true_voxels)), np.arange(len(self.target.axes))
        same = torch.from_numpy(self.same(rows_s, rows_t))
        return Lesson(_some(self.source, rows_s), _some(self.target, rows_t), same, self.oriented)


def _some(tokens: Tokens, rows: IntArray) -> Tokens:
    """These of them, as float32 tensors."""
    return Tokens(*(torch.from_numpy(values[rows].astype(np.float32)) for values in tokens))


def _cropped(places_voxels: FloatArray, rng: np.random.Generator) -> IntArray:
    """Rows of (K, 3) places that a plane in any direction leaves, half of them or more."""
    along = places_voxels @ rng.normal(size=3)
    rows: IntArray = np.flatnonzero(along >= np.quantile(along, rng.uniform(0, MOST_CROPPED)))
    return rows


def _blurred(tokens: Tokens, hiding: Hiding, rng: np.random.Generator) -> Tokens:
    """The same with some numbers dropped, and moved a little."""
    units, places = tokens.units, tokens.places_voxels
    if hiding.dropped_share:
        kept = rng.random(units.shape, dtype=np.float32) >= hiding.dropped_share
        units = units * torch.from_numpy(kept) / (1 - hiding.dropped_share)
    if hiding.jitter_voxels:
        moves = rng.normal(0, hiding.jitter_voxels, places.shape).astype(np.float32)
        places = places + torch.from_numpy(moves)
    return tokens._replace(units=units, places_voxels=places)


def make_token_pair(
    number: int, describes: str, count: int = LEARNED_KEYPOINTS
) -> TokenPair | None:
    """The keypoints of the factory's pair of scans of that number; None where there is none, or
    where they share too little.

    Args:
        number: of the factory.
        describes: name or file of the deep network.
        count: keypoints of a scan.
    """
    scans, network = make_scans(number), find_deep(describes, "matcher.describes")
    if scans is None:
        return None
    pair = token_pair(scans, network, count)
    rows = np.arange(len(pair.true_voxels)), np.arange(len(pair.target.axes))
    return pair if pair.same(*rows).any(axis=1).sum() >= LEAST_SHARED else None


def token_pair(scans: TwoScans, network: OnGrids, count: int = LEARNED_KEYPOINTS) -> TokenPair:
    """The keypoints of two scans, described by a deep network."""
    rows_s, source = tokens_of(scans.source, network, False, count)
    rows_t, target = tokens_of(scans.target, network, not scans.oriented, count)
    moved_m = transform_points(scans.T_target_source, scans.source.centroids_m[rows_s])
    middle_m = scans.target.centroids_m[rows_t].mean(axis=0)
    return TokenPair(
        source._replace(units=source.units.astype(np.float16)),
        target._replace(units=target.units.astype(np.float16)),
        ((moved_m - middle_m) / scans.target.voxel_size_m).astype(np.float32),
        source.axes @ scans.T_target_source[:3, :3].T.astype(np.float32),
        scans.oriented,
    )
