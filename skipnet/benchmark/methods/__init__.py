"""Registration methods behind one call: ``Task -> Estimate``.

Each module has a ``make(**options) -> Method``. It imports its package there, not at the top, so
that a missing one stops with the pip command, and so that imports never count in a method's time.
A new method is a module here, or one of yours, and a file of configs/methods that names its
``make``.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skipnet.checks import find_object
from skipnet.types import FloatArray

STAGES = ("map", "transform", "fine")
"""The paper's split of the time: voxels and map (all preparation), coarse transform, fine match."""


@dataclass(frozen=True)
class Task:
    """All that a method may see of a pair: never the truth."""

    source_m: FloatArray
    """(N, 3) points in the source's own frame."""
    target_m: FloatArray
    """(M, 3) points in the target's own frame."""
    source_viewpoint_m: FloatArray | None = None
    """(3,) sensor position in the source's frame; None when unknown."""
    target_viewpoint_m: FloatArray | None = None
    """(3,) sensor position in the target's frame; None when unknown."""
    T_target_source_start: FloatArray = field(default_factory=lambda: np.eye(4))
    """(4, 4) pose from which a local method starts; the others do not look at it."""


@dataclass(frozen=True)
class Estimate:
    """What a method answers."""

    T_target_source: FloatArray
    """(4, 4) float64, the method's final pose."""
    stage_s: Mapping[str, float]
    """Seconds of each of ``STAGES`` that the method has."""
    T_target_source_coarse: FloatArray | None = None
    """(4, 4) pose before fine alignment; None for a method without a coarse stage."""
    status: str = "registered"
    """The method's own opinion: "registered", "ambiguous" or "failed"."""
    confidence: float | None = None
    """In [0, 1]: the share of such answers that are right; None if the method does not say."""
    margin: float | None = None
    """By what share of its score it beats its best rival, 0 to 1; None if it knows no rivals."""
    reason: str = ""
    """One sentence for a person."""
    timings_s: Mapping[str, float] = field(default_factory=dict)
    """The method's own, finer stages, if it has any."""
    time_s: float | None = None
    """Wall time of the whole call as measured beside the method; None: not measured there."""
    correspondences: tuple[FloatArray, FloatArray] | None = None
    """(K, 3) points of the source and (K, 3) of the target that it holds for the same, if it
    works with such."""


Method = Callable[[Task], Estimate]


def make_method(make: str, options: Mapping[str, Any] | None = None) -> Method:
    """Build a method from the dotted path of its ``make`` and that function's options.

    Raises:
        ValueError: if there is no such function or option, or an option's value of a wrong kind.
        ImportError: if the method's package is missing; the message has the pip command.
    """
    build = find_object("make", make)
    _check_options(make, build, options or {})
    try:
        method: Method = build(**(options or {}))
    except TypeError as error:
        raise ValueError(f"{make} cannot take {dict(options or {})}: {error}") from error
    return method


def _check_options(make: str, build: Callable[..., Method], options: Mapping[str, Any]) -> None:
    parameters = inspect.signature(build).parameters.values()
    if any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters):
        return
    known = [parameter.name for parameter in parameters]
    unknown = sorted(set(options) - set(known))
    if unknown:
        raise ValueError(f"{make} has no option {unknown}; it has {known}")
