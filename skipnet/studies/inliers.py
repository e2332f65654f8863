"""How many right correspondences? ``skipnet study inliers data=FOLDER``.

The descriptor of the shipped network, and of others by name or file, beside FPFH on the same
keypoints of every pair of a folder with a pairs.json, each source turned at random. Nothing is
registered. Where a viewpoint is unknown FPFH's normals look to the given origin, which suits it
better than the principal frame's, to which those of the pipeline's own FPFH look.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from skipnet.benchmark.datasets.listed import FOLDER
from skipnet.geometry import invert
from skipnet.metrics.correspondences import (
    Correspond,
    Match,
    TwoScans,
    by_fpfh,
    by_matcher,
    by_network,
    keypoints_of,
    match,
    summarise,
)
from skipnet.networks.catalog import find_deep, find_matcher, find_network
from skipnet.networks.model import Model
from skipnet.scans.describing import describe
from skipnet.scans.scan import Scan, checked
from skipnet.skipmap.skipmap import SkipMap
from skipnet.studies.options import InliersConfig
from skipnet.studies.study import report
from skipnet.types import Pair
from skipnet.viz.tables import Table

FPFH = "FPFH"
LOW_OVERLAP = 0.35
NOTHING: Mapping[str, Correspond] = {}

Matches = dict[str, dict[str, list[Match]]]
"""Of each descriptor and set."""


def compare(
    pairs: Iterable[Pair],
    descriptors: dict[str, Model],
    matching: Mapping[str, Correspond] = NOTHING,
) -> Matches:
    """Let each descriptor, each matcher, and FPFH on the first one's keypoints, find
    correspondences."""
    matches: Matches = {name: {} for name in (*descriptors, *matching, FPFH)}
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
        found |= {name: match(scans, find) for name, find in matching.items()}
        found[FPFH] = match(turned, partial(by_fpfh, keypoints=keypoints))
        for name, one in found.items():
            known = one if pair.overlap is None else replace(one, overlap=pair.overlap)
            matches[name].setdefault(pair.set_name, []).append(known)
    return matches


def _with_sides(scan: Scan) -> SkipMap:
    """For FPFH, which needs sides."""
    if scan.viewpoint_m is not None:
        return scan.skipmap
    return scan.skipmap.seen_from(invert(scan.T_given_own)[:3, 3])


def run(config: InliersConfig) -> dict[str, Any]:
    """Compare networks on a folder's pairs and report; the summary comes back."""
    networks = {"skipnet": find_network()} | {name: find_network(name) for name in config.networks}
    pairs = FOLDER.pairs(config.data, config.sets, seed=config.seed)
    matching: dict[str, Correspond] = {}
    for name in config.matchers:
        deep = find_deep(config.networks[0], "networks")
        matcher = find_matcher(name, deep)
        matching[name] = partial(by_matcher, network=deep, matcher=matcher)
    matches = compare(pairs, networks, matching)
    return report(
        config,
        "Inliers: how many right correspondences does the descriptor find?",
        {"pairs from": str(config.data), "sets": ", ".join(matches[FPFH])},
        [ratios_table(matches), totals_table(matches)],
        inlier_ratio={name: ratios_of(matches[name]) for name in matches},
    )


def ratios_of(of_sets: dict[str, list[Match]]) -> dict[str, float]:
    """Mean inlier ratio of each set."""
    return {name: summarise(ones)["inlier_ratio"] for name, ones in of_sets.items()}


def ratios_table(matches: Matches) -> Table:
    """Inlier ratio per set and descriptor, the mean over sets, and over pairs that share little."""
    ratios = {name: ratios_of(of_sets) for name, of_sets in matches.items()}
    rows = [
        (name, str(len(ones)), *_cells(ratio[name] for ratio in ratios.values()))
        for name, ones in matches[FPFH].items()
    ]
    means = (float(np.mean(list(ratio.values()))) for ratio in ratios.values())
    rows.append(("mean of sets", str(sum(map(len, matches[FPFH].values()))), *_cells(means)))
    low = {
        name: [one.inlier_ratio for ones in of_sets.values() for one in ones if is_low(one)]
        for name, of_sets in matches.items()
    }
    if low[FPFH]:
        shares = (float(np.mean(ones)) for ones in low.values())
        rows.append((f"overlap under {LOW_OVERLAP:.0%}", str(len(low[FPFH])), *_cells(shares)))
    return Table("Inlier ratio", ("set", "pairs", *matches), tuple(rows))


def is_low(match: Match) -> bool:
    """Whether the two scans share little."""
    return match.overlap < LOW_OVERLAP


def totals_table(matches: Matches) -> Table:
    """Over all pairs: matched ones, and seconds, also as a share of FPFH's."""
    everything = {name: sum(of_sets.values(), []) for name, of_sets in matches.items()}
    matched = [summarise(ones)["matched_pairs"] for ones in everything.values()]
    seconds = [sum(one.seconds for one in ones) for ones in everything.values()]
    rows = (
        ("pairs with 5 % inliers", *_cells(matched)),
        ("seconds, describing and matching", *_cells(seconds)),
        ("share of FPFH's time", *_cells(one / seconds[-1] for one in seconds)),
    )
    return Table("All pairs", ("", *matches), rows)


def _cells(values: Iterable[float]) -> tuple[str, ...]:
    return tuple(f"{value:.3f}" for value in values)
