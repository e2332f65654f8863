"""How a graph hangs together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from skipnet.projects.ways import PairKey


def components(nodes: Iterable[int], edges: Iterable[PairKey]) -> list[list[int]]:
    """Connected components, the largest first.

    >>> components([0, 1, 2, 3], [(1, 3)])
    [[1, 3], [0], [2]]
    """
    part_of = {node: [node] for node in nodes}
    for a, b in edges:
        small, large = sorted((part_of[a], part_of[b]), key=len)
        if small is not large:
            large += small
            part_of |= dict.fromkeys(small, large)
    parts = {id(part): sorted(part) for part in part_of.values()}.values()
    return sorted(parts, key=lambda part: (-len(part), part))


def bridges(nodes: Iterable[int], edges: Sequence[PairKey]) -> list[PairKey]:
    """The edges without any of which a graph comes apart further, none being there twice.

    >>> bridges([0, 1, 2, 3], [(0, 1), (0, 2), (1, 2), (2, 3)])
    [(2, 3)]
    """
    beside: dict[int, list[int]] = {node: [] for node in nodes}
    for a, b in edges:
        beside[a].append(b)
        beside[b].append(a)
    reached: dict[int, int] = {}
    lowest: dict[int, int] = {}
    """The earliest reached node to which another way leads from a node or from what is beyond."""
    found = []
    for first in beside:
        way = [] if first in reached else [(first, -1, iter(beside[first]))]
        while way:
            node, before, ahead = way[-1]
            if node not in reached:
                reached[node] = lowest[node] = len(reached)
            to = next((other for other in ahead if other != before), None)
            if to is None:
                way.pop()
                if before >= 0:
                    lowest[before] = min(lowest[before], lowest[node])
                    if lowest[node] > reached[before]:
                        found.append((min(node, before), max(node, before)))
            elif to in reached:
                lowest[node] = min(lowest[node], reached[to])
            else:
                way.append((to, node, iter(beside[to])))
    return sorted(found)
