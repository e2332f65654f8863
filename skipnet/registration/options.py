"""Options of the registration: generators, samples, the weights of the judge."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum
from numbers import Integral, Real

from skipnet.checks import check_known, require
from skipnet.networks.names import DEEP, MATCHER, SHIPPED, matcher_file, weights_file


class Generator(Enum):
    """Where candidate poses come from."""

    corners = "corners"
    edges = "edges"
    planes = "planes"
    slides = "slides"
    descriptors = "descriptors"
    """The learned ones."""
    deep = "deep"
    """Those of the deep network, from finer patches; slower."""
    fpfh = "fpfh"
    """Descriptors computed by a fixed rule, for comparison; slower, and Open3D's."""


@dataclass
class RegistrationConfig:
    """Options of the registration itself; the defaults serve any scan."""

    generators: list[Generator] = field(
        default_factory=lambda: [
            Generator.planes,
            Generator.slides,
            Generator.descriptors,
            Generator.fpfh,
            Generator.deep,
        ]
    )
    """Asked in this order; a later one only while the verdict is not clear yet."""
    network: str = SHIPPED
    """What recognises and classifies voxels: shipped, another name, or the path of a file of
    weights that ``train.py`` wrote."""
    deep_network: str = DEEP
    """What the generator deep describes voxels with; likewise."""
    matcher: str | None = MATCHER
    """What then matches them, seen together: its name, or the path of a file that ``train.py
    experiment=matcher`` wrote; null takes descriptors that are near each other."""
    device: str = "cpu"
    """Where a network computes that needs torch: cpu, cuda or mps. On the processor none does."""
    denoise: bool = False
    """Drop outliers first, as the paper does. Effective voxels do without."""
    denoise_neighbours: int = 4
    """Nearest neighbours whose mean distance is looked at."""
    denoise_sigma: float = 1.0
    """Standard deviations above the mean from which a point is dropped."""
    same_class_corners: bool = True
    """Only corners of equal class correspond, as in the paper; false lets any two."""
    feature_weight: float = 1.0
    """Weight of edge and corner voxels in the judge, where planes have 1; 1 asks no network."""
    violation_weight: float = 10.0
    """How fast voxels in seen free space devalue a pose: 1 / weight of all leave it 37 %."""
    max_correspondences: int = 1500
    """Descriptor matches that enter the compatibility graph."""
    refine_samples: int = 1500
    """Voxels with which candidates are refined before the final judgement."""
    final_samples: int = 4000
    """Voxels of each scan that the final judgement looks at."""

    def __post_init__(self) -> None:
        require(bool(self.generators), "generators", self.generators, "at least one generator")
        are_some = isinstance(self.generators, Sequence)
        known = are_some and all(isinstance(generator, Generator) for generator in self.generators)
        require(known, "generators", self.generators, "members of Generator")
        weights_file(self.network, "network")
        if Generator.deep in self.generators:
            weights_file(self.deep_network, "deep_network")
            if self.matcher is not None:
                matcher_file(self.matcher)
        check_known("device", self.device, ("cpu", "cuda", "mps"))
        for name in ("denoise_sigma", "feature_weight", "violation_weight"):
            value = getattr(self, name)
            is_number = isinstance(value, Real) and 0 <= float(value) < math.inf
            require(is_number, name, value, "a number of 0 or more")
        require(self.feature_weight > 0, "feature_weight", self.feature_weight, "above 0")
        for name in ("max_correspondences", "refine_samples", "final_samples"):
            _require_whole(name, getattr(self, name), 50)
        _require_whole("denoise_neighbours", self.denoise_neighbours, 1)


def _require_whole(option: str, value: object, least: int) -> None:
    is_whole = isinstance(value, Integral) and int(value) >= least
    require(is_whole, option, value, f"a whole number of {least} or more")


def as_config(config: RegistrationConfig | None) -> RegistrationConfig:
    """The options that were given, or the defaults.

    Raises:
        ValueError: something else was given, or a matcher of another network than is asked.
    """
    given = RegistrationConfig() if config is None else config
    require(isinstance(given, RegistrationConfig), "config", config, "a RegistrationConfig")
    if Generator.deep in given.generators and given.matcher is not None:
        _check_matcher(given.matcher, given.deep_network)
    return given


def _check_matcher(matcher: str, deep_network: str) -> None:
    """Refuse a matcher of another network at once, not when the first hard pair needs it; the
    shipped ones belong together."""
    if (matcher, deep_network) != (MATCHER, DEEP):
        from skipnet.networks.catalog import find_deep, find_matcher

        find_matcher(matcher, find_deep(deep_network, "deep_network"))
