"""What every network can do that the package uses."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np

from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import FloatArray, IntArray


class Model(Protocol):
    """A trained network: it says where voxels may be recognised again, and what they are."""

    @property
    def card(self) -> Mapping[str, Any]:
        """How it came about: architecture, configuration, hash of the data, seed, scores."""

    @property
    def digest(self) -> str:
        """Hash of its weights (``digest_of``)."""

    @property
    def max_keypoints(self) -> int:
        """Voxels of a scan that it describes at most."""

    @property
    def curved_share(self) -> float:
        """So many of these are the most curved ones, see ``choose_keypoints``."""

    def cut(self, skipmap: SkipMap, rows: IntArray) -> FloatArray:
        """(K, ...) patches: what it reads of (K,) voxels of a scan."""

    def turned_over(self, patches: FloatArray) -> FloatArray:
        """The (K, ...) patches that the opposite normals would give."""

    def read(self, patches: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Descriptors of patches, and how likely each will be found again.

        Args:
            patches: (K, ...) from ``cut``.

        Returns:
            (K, D) float32 of length 1; the nearer two are, the likelier they show the same place.
            (K,) float32 logits: above 0 where a patch of the same place, in another scan, is more
            likely than not to be told from all others.

        Raises:
            ValueError: patches of another shape.
        """

    def classify(self, details: FloatArray, patches: FloatArray) -> FloatArray:
        """Probabilities of the five classes.

        Args:
            details: (K, 125) from ``build_patches``, of kind "surface_frame".
            patches: (K, ...) of the same voxels, from ``cut``.

        Returns:
            (K, 5) float32, columns in the order of ``FeatureClass``; each row sums to 1.

        Raises:
            ValueError: patches of another shape, or a network that did not learn the classes.
        """


def sentence(digest: str, card: Mapping[str, Any]) -> str:
    """What a network is, for a person."""
    learned = card.get("training_data", {})
    pairs = learned.get("pairs_of_scans", learned.get("numbers"))
    of = f", learned from {pairs:,} pairs of simulated scans" if pairs else ""
    return f"{digest}{of}"


def digest_of(weights: Mapping[str, FloatArray]) -> str:
    """Hash of named weights, whatever their order: 16 hexadecimal digits."""
    sha = hashlib.sha256()
    for name in sorted(weights):
        array = np.ascontiguousarray(weights[name], dtype=np.float32)
        sha.update(f"{name} {array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()[:16]
