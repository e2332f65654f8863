"""Where networks are trained and evaluated: the processor, or an accelerator that torch knows."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch

CPU = torch.device("cpu")
THREADS = 2
"""Threads of a training, whatever the machine has: their number decides in which order they add up,
and so the last bits."""


def find_device(name: str) -> torch.device:
    """The device of that name.

    Args:
        name: "cpu", "cuda" or "mps".

    Raises:
        ValueError: torch finds no such device here.
    """
    available = ["cpu"]
    if torch.cuda.is_available():
        available.append("cuda")
    if torch.backends.mps.is_available():
        available.append("mps")
    if name not in available:
        raise ValueError(
            f"device={name}: torch {torch.__version__} finds no such device here; "
            f"expected {' or '.join(available)}"
        )
    return torch.device(name)


@contextmanager
def fixed_threads(count: int = THREADS) -> Iterator[None]:
    """Let torch compute with so many threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)
