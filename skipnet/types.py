"""The nouns that every room of skipnet shares: plain data, no behaviour.

Frames: ``T_a_b`` maps a point of frame b into frame a. Points are rows, lengths metres, angles
radians.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, IntEnum

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.floating]
IntArray = npt.NDArray[np.integer]
BoolArray = npt.NDArray[np.bool_]


class FeatureClass(IntEnum):
    """The paper's five classes of feature voxels; the definitions are this project's (README).

    The sensor's side decides between first and second class: the same three faces are concave when
    seen from inside a room and convex when seen from outside a box.
    """

    FIRST_CORNER = 0
    """Three surfaces, all concave towards the sensor: a room's corner seen from inside."""
    SECOND_CORNER = 1
    """Three surfaces, all convex towards the sensor: a box's corner."""
    OTHER_CORNER = 2
    """Three or more surfaces, mixed: a box standing on the floor, a window's corner."""
    EDGE = 3
    """Two surfaces."""
    PLANE = 4
    """One surface."""


class Status(str, Enum):
    """The word on a result; it is a string like any other.

    >>> Status.REGISTERED == "registered", f"{Status.REGISTERED}"
    (True, 'registered')
    """

    REGISTERED = "registered"
    """The pose is more likely right than wrong, and nothing explains the scans as well."""
    AMBIGUOUS = "ambiguous"
    """Several poses explain the scans about equally well, or nothing holds the one."""
    FAILED = "failed"
    """No pose explains both scans."""

    def __str__(self) -> str:
        return self.value

    def __format__(self, format_spec: str) -> str:
        return format(self.value, format_spec)


@dataclass(frozen=True)
class Pair:
    """Two scans of one scene and, for the scorer alone, the true motion between them."""

    name: str
    """Unique within its set; stable between runs."""
    set_name: str
    """The data set or simulated family it belongs to."""
    source_m: FloatArray
    """(N, 3) points in the source's own frame."""
    target_m: FloatArray
    """(M, 3) points in the target's own frame."""
    T_target_source: FloatArray
    """(4, 4) float64, the truth. Never handed to a method."""
    source_viewpoint_m: FloatArray | None = None
    """(3,) sensor position in the source's frame; None when unknown."""
    target_viewpoint_m: FloatArray | None = None
    """(3,) sensor position in the target's frame; None when unknown."""
    success_rotation_rad: float = float(np.deg2rad(0.5))
    """A result counts as right below this rotation error ..."""
    success_translation_m: float = 0.03
    """... and below this translation error."""
    overlap: float | None = None
    """Share of the source that lies near the target under the truth, if known."""
    information: FloatArray | None = None
    """(6, 6) of a gt.info: with e = (translation, vector part of the unit quaternion) of
    inv(truth) @ estimate, e^T information e / information[0, 0] is the pair's squared RMSE."""
    consecutive: bool = False
    """The scans follow each other in a sequence; some protocols leave such pairs out."""
