"""What the deep network is, whoever computes it: how it cuts a scan, and what it does not know."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property
from typing import Any, ClassVar

from skipnet.features.grids import GRID_SHAPE, cylinder_grids, turned_over
from skipnet.networks.model import digest_of, sentence
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray


class OnGrids(ABC):
    """The part of a ``Model`` that NumPy's and torch's network share."""

    architecture: ClassVar[str] = "deep"
    max_keypoints: ClassVar[int] = 1500
    curved_share: ClassVar[float] = 0.5
    """Of the keypoints; with the others spread over the scan poses of low overlap are found
    oftener."""

    weights: dict[str, FloatArray]
    """Of ``DeepNetwork``, with the scaling of its inputs."""
    card: dict[str, Any]
    """With the network's "widths"."""

    @cached_property
    def digest(self) -> str:
        """See ``Model``."""
        return digest_of(self.weights)

    def __repr__(self) -> str:
        """Not its weights."""
        return f"<{type(self).__name__} {sentence(self.digest, self.card)}>"

    def cut(self, skipmap: SkipMap, rows: IntArray) -> FloatArray:
        """(K, 2, 8, 6, 16, 7) grids around (K,) voxels."""
        return cylinder_grids(skipmap, rows)

    @abstractmethod
    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See ``Model``."""

    @abstractmethod
    def units(self, patches: FloatArray) -> FloatArray:
        """(K, hidden) float32 units of (K, 2, 8, 6, 16, 7) grids, of which descriptors are made.

        Raises:
            ValueError: patches of another shape.
        """

    def turned_over(self, patches: FloatArray) -> FloatArray:
        """The grids that the opposite normals would give."""
        return turned_over(patches)

    def classify(self, details: FloatArray, patches: FloatArray) -> FloatArray:
        """Always refused: this network did not learn the classes.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            "the deep network knows no classes: take network=shipped for the generators corners "
            "and edges, and for a feature_weight other than 1"
        )


def check_grids(patches: FloatArray) -> None:
    """Refuse what are no grids of ``OnGrids.cut``."""
    if patches.shape[1:] != GRID_SHAPE:
        raise ValueError(f"patches must be (K, {GRID_SHAPE}), got {patches.shape}")
