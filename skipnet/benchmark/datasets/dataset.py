"""What a data set is to a benchmark: its pairs, and the words and settings that tell it apart."""

from __future__ import annotations

from typing import Any, Protocol

from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.options import EvaluateConfig, ProtocolKind
from skipnet.checks import find_object


class Dataset(Protocol):
    """Pairs with their truth. ``EvaluateConfig.dataset`` names what makes one of the options."""

    @property
    def protocol(self) -> ProtocolKind:
        """The rule by which results on it are published."""

    def pairs(self) -> PairSet:
        """The pairs that the options ask for.

        Raises:
            ValueError, FileNotFoundError: there are none such; the message says what to do.
        """

    def describe(self) -> dict[str, str]:
        """What they are, for the head of a report: name to description."""

    def key(self) -> list[Any]:
        """All settings that decide what a pair of a given name is, as JSON knows them.

        Not how many there are: a run may be extended.
        """


def make_dataset(config: EvaluateConfig) -> Dataset:
    """The data set that the options name.

    Raises:
        ValueError: there is no such thing.
    """
    dataset: Dataset = find_object("dataset", config.dataset)(config)
    return dataset
