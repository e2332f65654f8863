"""What the judge says of poses, and how strictly."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

from skipnet.types import FloatArray, IntArray

MISMATCH_WEIGHT = 2.0
"""How fast mismatches devalue a pose: by exp(-weight * mismatch / support)."""
CHANCE_SCORE = 0.05
"""What some pose always scores: a lead counts against this, though no rival be found."""
STRAY_SHARE = 0.0003
"""Share of voxels that may contradict by chance: one of 4000 samples."""


@dataclass(frozen=True)
class Strictness:
    """What counts as agreement and what as a contradiction."""

    max_distance_voxels: float
    """Largest distance from the other scan's local plane."""
    min_normal_cosine: float
    """Smallest cosine between matching normals."""
    max_beside_voxels: float
    """A surface at a greater distance, up to this one, is another surface: a mismatch."""
    free_share: float
    """A point in front of what was seen there by this share of the range ..."""
    free_voxels: float
    """... and by this many voxels is in free space ..."""
    min_facing_cosine: float = 0.0
    """... if its surface is turned to the other sensor so far: along a wall seen at a grazing angle
    neighbouring directions differ much in range."""


ROUGH = Strictness(1.0, 0.8, 1.5, 0.03, 1.5)
"""For candidates, which may be a voxel off."""
FINE = Strictness(0.5, 0.8, 1.5, 0.02, 1.0)
"""For poses after fine alignment."""


@dataclass(frozen=True)
class Score:
    """The judge's figures for C candidates; every array is (C,)."""

    total: FloatArray
    """Support, discounted for contradictions and mismatches, 0 to 1."""
    overlap: FloatArray
    """Mean of both ways' matched shares of the voxels, 0 to 1."""
    violation: FloatArray
    """Mean of both ways' shares of the voxels in seen free space, 0 to 1, by how far the viewpoints
    are to be trusted."""
    support: FloatArray
    """As ``overlap``, voxels counted by what they are worth."""
    contradiction: FloatArray
    """As ``violation``, likewise."""
    mismatch: FloatArray
    """Mean of both ways' shares of the worth that lies beside the other scan's surface."""

    def __getitem__(self, rows: IntArray | slice) -> Score:
        """The figures of some rows."""
        return Score(*(getattr(self, one.name)[rows] for one in fields(self)))

    def replaced(self, rows: IntArray, others: Score) -> Score:
        """The figures of others in some rows."""
        figures = {one.name: getattr(self, one.name).copy() for one in fields(self)}
        for name, values in figures.items():
            values[rows] = getattr(others, name)
        return Score(**figures)

    def joined(self, others: Score) -> Score:
        """These candidates' figures, then the others'."""
        pairs = ((getattr(self, one.name), getattr(others, one.name)) for one in fields(self))
        return Score(*(np.concatenate(pair) for pair in pairs))

    @property
    def mismatch_rate(self) -> FloatArray:
        """Share of what comes near the other scan's surface that lies beside it."""
        return self.mismatch / np.maximum(self.mismatch + self.support, 1e-9)


def violation_cost(violation: FloatArray) -> FloatArray:
    """How much shares of violating voxels say against a pose.

    It grows as the square root does: the first few contradictions say most, because right poses of
    still scenes have none at all, while in a busy street even the right one has some per cent. A
    stray voxel or two say little.

    >>> violation_cost(np.array([0.0, 0.0001, 0.01])).round(3)
    array([0.   , 0.003, 0.084])
    """
    return np.sqrt(violation + STRAY_SHARE) - np.sqrt(STRAY_SHARE)
