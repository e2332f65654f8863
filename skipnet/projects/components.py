"""How a graph hangs together."""

from __future__ import annotations

from collections.abc import Iterable

from skipnet.projects.ways import PairKey


def components(nodes: Iterable[int], edges: Iterable[PairKey]) -> list[list[int]]:
    """Connected components, the largest first.

    >>> components([0, 1, 2, 3], [(1, 3)])
    [[1, 3], [0], [2]]
    """
    root = {node: node for node in nodes}
    for a, b in edges:
        low, high = sorted((root[a], root[b]))
        root = {node: low if r == high else r for node, r in root.items()}
    parts = [[n for n in root if root[n] == r] for r in sorted(set(root.values()))]
    return sorted((sorted(part) for part in parts), key=lambda part: (-len(part), part))
