"""Mutual nearest descriptors of many, without comparing all with all.

Most of how histograms differ lies along a few directions. Turned into their principal axes and
sorted along the first three of these, descriptors fall into blocks of like ones, and how near a
block can be is a bound from its extent along some axes: one in fifteen blocks is looked into.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import FloatArray, IntArray

_BLOCK = 64
"""Descriptors looked at together."""
_BOUNDED = 6
"""Axes along which blocks have an extent."""
_AT_ONCE = 4
"""Coordinates taken together ..."""
_EARLY = 8
"""... and those after which a block is left that can no longer have a nearer one."""
_FAR = 1e9
"""Where a block has room left."""


def nearest_of_many(source: FloatArray, target: FloatArray) -> tuple[IntArray, IntArray]:
    """(K,) rows of (V, D) and (K,) rows of (W, D) descriptors that are each other's nearest.

    Rows of the source ascend; of equally near ones one is taken.
    """
    turned_s, turned_t = _in_principal_axes(source, target)
    blocks_s, blocks_t = _Blocks.of(turned_s), _Blocks.of(turned_t)
    rows_s = blocks_s.rows[blocks_s.rows >= 0]  # one after the other they look into the same blocks
    rows_t, squared = blocks_t.nearer(turned_s[rows_s], np.full(len(rows_s), np.inf, np.float32))
    order = np.lexsort((rows_s, squared, rows_t))
    is_first = np.append(True, np.diff(rows_t[order]) > 0)
    rows_s, rows_t, squared = (one[order[is_first]] for one in (rows_s, rows_t, squared))
    mutual = blocks_s.nearer(turned_t[rows_t], squared)[0] < 0
    rows_s, rows_t = rows_s[mutual], rows_t[mutual]
    ascending = np.argsort(rows_s)
    return rows_s[ascending], rows_t[ascending]


def _in_principal_axes(source: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Both float32 in the axes along which they spread, the widest first, with coordinates of 0
    up to a multiple of ``_AT_ONCE``: the same distances."""
    both = np.concatenate([source, target])
    both -= both.mean(axis=0)
    axes = np.linalg.eigh(both.T @ both)[1][:, ::-1]
    both = both @ np.pad(axes, ((0, 0), (0, -len(axes) % _AT_ONCE))).astype(np.float32)
    return both[: len(source)], both[len(source) :]


@dataclass(frozen=True)
class _Blocks:
    """Descriptors in B blocks of like ones."""

    rows: IntArray
    """(B * 64,) which descriptor is in each place; -1 for none."""
    columns: FloatArray
    """(B, D, 64) their coordinates."""
    low: FloatArray
    """(6, B) from where ..."""
    high: FloatArray
    """... to where each block reaches along the first axes."""

    @staticmethod
    def of(turned: FloatArray) -> _Blocks:
        """Of (V, D) descriptors in their principal axes: slabs along the first axis, these divided
        along the second, and these along the third, as they spread."""
        blocks, spread = -(-len(turned) // _BLOCK), turned[:, :3].std(axis=0) + 1e-9
        first = int(np.clip(np.cbrt(blocks * spread[0] ** 2 / spread[1] / spread[2]), 1, blocks))
        left = -(-blocks // first)
        second = int(np.clip(np.sqrt(left * spread[1] / spread[2]), 1, left))
        shape = first, second, -(-left // second) * _BLOCK
        rows: IntArray = np.full(np.prod(shape), -1)
        rows[: len(turned)] = np.arange(len(turned))
        for axis in range(3):
            rows = rows.reshape(int(np.prod(shape[:axis])), -1)
            along = np.where(rows < 0, np.inf, turned[rows, axis])
            rows = np.take_along_axis(rows, np.argsort(along, axis=1, kind="stable"), axis=1)
        rows = rows.reshape(-1, _BLOCK)
        rows = rows[rows[:, 0] >= 0]
        columns = np.ascontiguousarray(turned[rows].transpose(0, 2, 1))
        leading, is_room = columns[:, :_BOUNDED].transpose(1, 0, 2), rows < 0
        low = np.where(is_room, np.inf, leading).min(axis=2)
        high = np.where(is_room, -np.inf, leading).max(axis=2)
        columns[:, 0][is_room] = _FAR
        return _Blocks(rows.ravel(), columns, low.astype(np.float32), high.astype(np.float32))

    def nearer(self, turned: FloatArray, limits: FloatArray) -> tuple[IntArray, FloatArray]:
        """(Q,) row of the nearest to each of (Q, D) others, of those nearer than its limit, a
        squared distance, -1 for none; and (Q,) how near that is."""
        places, squared = np.empty(len(turned), np.int64), limits.copy()
        room = np.empty(len(self.columns), np.float32), np.empty(_BLOCK, np.float32)
        _search(turned, self.columns, (self.low, self.high), room, places, squared)
        return np.where(places < 0, -1, self.rows[places]), squared


@compiled
def _search(
    turned: FloatArray,
    columns: FloatArray,
    extent: tuple[FloatArray, FloatArray],
    room: tuple[FloatArray, FloatArray],
    places: IntArray,
    squared: FloatArray,
) -> None:
    """The nearest place of (Q, D) others nearer than (Q,) ``squared``, which becomes how near it
    is; -1 for none. The block that may have the nearest comes first, then those that may have a
    nearer one."""
    bounds, apart = room
    (low, high), zero = extent, np.float32(0)
    for q in range(len(turned)):
        own = turned[q]
        for b in range(len(bounds)):
            bounds[b] = zero
        for k in range(len(low)):
            value, low_k, high_k = own[k], low[k], high[k]
            for b in range(len(bounds)):
                away = max(max(low_k[b] - value, value - high_k[b]), zero)
                bounds[b] += away * away
        first = 0
        for b in range(len(bounds)):
            first = b if bounds[b] < bounds[first] else first
        best, place = squared[q], -1
        for turn in range(-1, len(bounds)):
            b = first if turn < 0 else turn
            if turn != first and bounds[b] < best:
                _measure(own, columns[b], best, apart)
                for c in range(len(apart)):
                    if apart[c] < best:
                        best, place = apart[c], b * len(apart) + c
        places[q], squared[q] = place, best


@compiled
def _measure(own: FloatArray, block: FloatArray, best: float, apart: FloatArray) -> None:
    """(64,) squared distances of one descriptor from those of a (D, 64) block; where none is less
    than the best one, what they come to after a few coordinates, which is no less either."""
    for c in range(len(apart)):
        apart[c] = np.float32(0)
    for d in range(0, len(own), _AT_ONCE):
        if d == _EARLY:
            is_near = False
            for c in range(len(apart)):
                is_near |= apart[c] < best
            if not is_near:
                return
        v_0, v_1, v_2, v_3 = own[d], own[d + 1], own[d + 2], own[d + 3]
        for c in range(len(apart)):
            away_0, away_1 = block[d, c] - v_0, block[d + 1, c] - v_1
            away_2, away_3 = block[d + 2, c] - v_2, block[d + 3, c] - v_3
            apart[c] += (away_0 * away_0 + away_1 * away_1) + (away_2 * away_2 + away_3 * away_3)
