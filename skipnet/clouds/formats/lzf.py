"""LZF, the compression inside PCD files (M. Lehmann, liblzf): unpacking alone."""

from __future__ import annotations

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import IntArray

LARGEST_RATIO = 88
"""Three bytes become 264 at most."""


def decompress(packed: IntArray, size: int) -> IntArray | None:
    """``size`` bytes out of (n,) packed ones, or None if these do not hold just so many.

    >>> decompress(np.array([1, 7, 8, 0x20, 1], np.uint8), 5).tolist()
    [7, 8, 7, 8, 7]
    """
    content = np.zeros(size, np.uint8)
    return content if _unpack(np.ascontiguousarray(packed), content) == size else None


@compiled
def _unpack(packed: IntArray, content: IntArray) -> int:
    """Fill ``content``; how many bytes it took, -1 if the packed ones are damaged."""
    read, written = 0, 0
    while read < len(packed):
        control = int(packed[read])
        read += 1
        if control < 32:  # so many bytes and one as they are
            length = control + 1
            if read + length > len(packed) or written + length > len(content):
                return -1
            for k in range(length):
                content[written + k] = packed[read + k]
            read += length
        else:  # bytes that stood before, some way back
            length = control >> 5
            if length == 7:
                if read >= len(packed):
                    return -1
                length += int(packed[read])
                read += 1
            length += 2
            if read >= len(packed):
                return -1
            start = written - ((control & 31) << 8) - int(packed[read]) - 1
            read += 1
            if start < 0 or written + length > len(content):
                return -1
            for k in range(length):  # one by one: the two may overlap
                content[written + k] = content[start + k]
        written += length
    return written
