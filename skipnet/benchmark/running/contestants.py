"""From a benchmark's config to its pairs, its methods, and the words that describe it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

from skipnet.benchmark.datasets import DATASETS, PairSet, folder_pairs, simulated_pairs
from skipnet.benchmark.datasets.disturbed import disturbed_pairs
from skipnet.benchmark.datasets.overlapping import KINDS, overlapping_pairs
from skipnet.benchmark.methods import Method, make_method
from skipnet.benchmark.options import DatasetKind, EvaluateConfig, ProtocolKind
from skipnet.benchmark.running.isolation import isolated
from skipnet.benchmark.scoring.protocols import PROTOCOLS
from skipnet.networks.names import SHIPPED, weights_file

LEARNED_ADAPTERS = ("skipnet", "matching")
"""Those whose answers depend on weights."""


@dataclass(frozen=True)
class Contestant:
    """A method as it enters a benchmark."""

    name: str
    """Key in the predictions; unique."""
    label: str
    """Name in tables and figures."""
    run: Method
    settings_hash: str
    """Changes with the pairs' and the method's settings."""
    start_from: str = ""
    """The contestant whose coarse pose is this one's start; empty for identity."""


def describe(config: EvaluateConfig) -> dict[str, str]:
    """What was run, for the head of the report."""
    about = {"benchmark": config.benchmark, "methods": ", ".join(config.methods)}
    if config.dataset is DatasetKind.simulated:
        family = "every family" if config.family == "all" else f"family {config.family}"
        about["pairs from"] = f"{config.pairs} simulated scenes of {family}"
        about["scanner"] = f"{config.scanner}, rotation {config.rotation}"
    elif config.dataset is DatasetKind.overlapping:
        about["pairs from"] = f"{config.pairs} simulated pairs of each of {len(KINDS)} kinds"
    else:
        sets = ", ".join(config.sets) or "all sets"
        most = "" if config.most_per_set is None else f", at most {config.most_per_set} of each"
        about["pairs from"] = f"{config.dataset.name} in {config.data} ({sets}{most})"
        rotation = "a random rotation" if config.turn else "no rotation"
        about["sources moved by"] = f"{rotation}, a shift of {config.shift_m:g} m"
    if config.disturbances:
        about["conditions"] = "; ".join(
            f"{one.name}: noise {one.noise_m:g} m, {one.keep:.0%} of the points, {one.crop:.0%} cut"
            for one in config.disturbances
        )
    protocol = PROTOCOLS[protocol_of(config)]
    about["protocol"] = f"{protocol.label}. {protocol.sentence}"
    about["seed"] = str(config.seed)
    limit_s = config.time_limit_s
    about["time limit"] = "none" if limit_s is None else f"{limit_s:g} s per pair and method"
    about["threads"] = f"{config.threads}; each method in a process of its own"
    return about


def protocol_of(config: EvaluateConfig) -> ProtocolKind:
    """The protocol that the config names, otherwise the data set's own."""
    if config.protocol is not None:
        return config.protocol
    if config.dataset in (DatasetKind.simulated, DatasetKind.overlapping):
        return ProtocolKind.own
    return DATASETS[config.dataset].protocol


def make_pair_set(config: EvaluateConfig) -> PairSet:
    """The pairs that the config asks for."""
    if config.dataset is DatasetKind.simulated:
        pairs = simulated_pairs(
            config.family, config.pairs, config.seed, config.scanner, config.rotation, config.points
        )
    elif config.dataset is DatasetKind.overlapping:
        pairs = overlapping_pairs(config.pairs, config.seed)
    else:
        pairs = folder_pairs(
            config.data,
            config.sets,
            config.turn,
            config.shift_m,
            config.seed,
            config.dataset,
            config.most_per_set,
        )
    return disturbed_pairs(pairs, config.disturbances)


def make_contestants(config: EvaluateConfig) -> list[Contestant]:
    """The chosen methods, each to run in a process of its own, in the order in which they run."""
    contestants = []
    for name in config.methods:
        variant = config.variants[name]
        make = partial(make_method, variant.adapter, dict(variant.options))
        make()  # though it will run in a child: a missing package must stop the run here
        contestants.append(
            Contestant(
                name=name,
                label=variant.label or name,
                run=isolated(make, config.time_limit_s, config.threads),
                settings_hash=settings_hash(config, name),
                start_from=variant.start_from,
            )
        )
    return contestants


def group_of(config: EvaluateConfig) -> dict[str, str]:
    """Method to its group, for the chosen methods that have one."""
    groups = {name: config.variants[name].group for name in config.methods}
    return {name: group for name, group in groups.items() if group}


def _weights_digest(adapter: str, options: Mapping[str, Any]) -> str:
    """Hash of the weights' file that a method uses; empty for one that uses none."""
    if adapter not in LEARNED_ADAPTERS:
        return ""
    content = weights_file(options.get("weights") or options.get("network") or SHIPPED).read_bytes()
    return hashlib.sha256(content).hexdigest()[:12]


def settings_hash(config: EvaluateConfig, method: str) -> str:
    """Hash of all settings that an answer of ``method`` depends on.

    Not of how many pairs there are, nor of the other methods: a run can be extended by both. Nor of
    the protocol: answers are scored anew in every run.
    """
    pairs: list[Any] = [config.dataset.name, [asdict(one) for one in config.disturbances]]
    if config.dataset is DatasetKind.simulated:
        pairs += [config.scanner, config.rotation, config.points]
    elif config.dataset is DatasetKind.overlapping:
        # A pair's goal follows from the number of pairs.
        pairs += [config.pairs, config.seed]
    else:
        folder = Path(str(config.data)).resolve()
        pairs += [str(folder), config.turn, config.shift_m, config.seed]
    chain = [asdict(config.variants[method])]
    while chain[-1]["start_from"]:
        chain.append(asdict(config.variants[chain[-1]["start_from"]]))
    answers = [
        {name: variant[name] for name in ("adapter", "start_from", "options")}
        | {"weights": _weights_digest(variant["adapter"], variant["options"])}
        for variant in chain
    ]
    text = json.dumps([pairs, answers, config.time_limit_s, config.threads], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]
