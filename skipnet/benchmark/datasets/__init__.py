"""Where the pairs come from: simulated families, folders of real scans, public data sets.

A pair set knows its names at once and makes or reads its pairs one at a time, so that a resumed run
loads only what is missing. The truth is inside each ``Pair``; only the scorer looks at it.
"""

from skipnet.benchmark.datasets.pairset import Listed, PairSet, select
from skipnet.benchmark.datasets.public import DATASETS, Dataset, folder_pairs
from skipnet.benchmark.datasets.simulated import simulated_pairs

__all__ = ["DATASETS", "Dataset", "Listed", "PairSet", "folder_pairs", "select", "simulated_pairs"]
