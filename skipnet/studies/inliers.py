"""How many right correspondences: ``python -m skipnet.studies.inliers FOLDER [NETWORK ...]``.

The descriptor of the shipped network, and of others by name or file, beside FPFH on the same
keypoints of every pair of a folder with a pairs.json, each source turned at random. Nothing is
registered. Where a viewpoint is unknown FPFH's normals look to the given origin, which suits it
better than the principal frame's, to which those of the pipeline's own FPFH look.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from dataclasses import replace
from functools import partial

import numpy as np

from skipnet.benchmark.datasets import folder_pairs
from skipnet.geometry import invert
from skipnet.metrics.correspondences import (
    Match,
    TwoScans,
    by_fpfh,
    by_network,
    keypoints_of,
    match,
    summarise,
)
from skipnet.networks.catalog import find_network
from skipnet.networks.model import Model
from skipnet.scans.scan import Scan, checked, describe
from skipnet.skipmap.skipmap import SkipMap
from skipnet.types import Pair

FPFH = "FPFH"

Matches = dict[str, dict[str, list[Match]]]
"""Of each descriptor and set."""


def compare(pairs: Iterable[Pair], descriptors: dict[str, Model]) -> Matches:
    """Let each descriptor, and FPFH on the first one's keypoints, find correspondences."""
    matches: Matches = {name: {} for name in (*descriptors, FPFH)}
    first = next(iter(descriptors.values()))
    for index, pair in enumerate(pairs):
        clouds = [
            checked(points_m, f"{pair.name}, {which}")
            for which, points_m in (("source", pair.source_m), ("target", pair.target_m))
        ]
        source, target = describe(clouds, ("auto", "auto"))
        if min(len(source.skipmap), len(target.skipmap)) == 0:
            raise ValueError(f"{pair.name}: a scan has no voxel with enough points around it")
        T = invert(target.T_given_own) @ pair.T_target_source @ source.T_given_own
        oriented = source.viewpoint_m is not None and target.viewpoint_m is not None
        scans = TwoScans(source.skipmap, target.skipmap, T, oriented)
        turned = replace(scans, source=_with_sides(source), target=_with_sides(target))
        keypoints = keypoints_of(scans, first)
        if index == 0:  # imports and loops to compile shall not count
            by_network(scans, first)
            by_fpfh(turned, keypoints)
        found = {
            name: match(scans, partial(by_network, descriptor=descriptor))
            for name, descriptor in descriptors.items()
        }
        found[FPFH] = match(turned, partial(by_fpfh, keypoints=keypoints))
        for name, one in found.items():
            matches[name].setdefault(pair.set_name, []).append(one)
    return matches


def _with_sides(scan: Scan) -> SkipMap:
    """For FPFH, which needs sides."""
    if scan.viewpoint_m is not None:
        return scan.skipmap
    return scan.skipmap.seen_from(invert(scan.T_given_own)[:3, 3])


def table(matches: Matches) -> str:
    """Markdown: inlier ratio per set and descriptor; then over all sets, with matched pairs, and
    seconds for all pairs, also as a share of FPFH's."""
    names = list(matches)
    lines = [f"| set | pairs | {' | '.join(names)} |", "|---|---:|" + "---:|" * len(names)]
    for set_name, of_set in matches[FPFH].items():
        ratios = [summarise(matches[name][set_name])["inlier_ratio"] for name in names]
        lines.append(_line(set_name, len(of_set), ratios))
    everything = {name: [one for ones in matches[name].values() for one in ones] for name in names}
    count = len(everything[FPFH])
    means = [
        float(np.mean([summarise(ones)["inlier_ratio"] for ones in matches[name].values()]))
        for name in names
    ]
    matched = [summarise(everything[name])["matched_pairs"] for name in names]
    seconds = [sum(one.seconds for one in everything[name]) for name in names]
    lines.append(_line("mean of sets", count, means))
    lines.append(_line("pairs with 5 % inliers", count, matched))
    lines.append(_line("seconds, describing and matching", count, seconds))
    lines.append(_line("share of FPFH's time", count, [one / seconds[-1] for one in seconds]))
    return "\n".join(lines)


def _line(title: str, pairs: int, values: list[float]) -> str:
    return f"| {title} | {pairs} | {' | '.join(f'{value:.3f}' for value in values)} |"


def main(folder: str, *weights: str) -> None:
    """Print the table."""
    descriptors = {"skipnet": find_network()} | {name: find_network(name) for name in weights}
    print(table(compare(folder_pairs(folder), descriptors)))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit("usage: python -m skipnet.studies.inliers FOLDER [NETWORK ...]")
    try:
        main(*sys.argv[1:])
    except (ImportError, OSError, ValueError) as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        sys.exit(2)
