"""From a benchmark's config to its pairs, its methods, and the words that describe it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from skipnet.benchmark.datasets.dataset import make_dataset
from skipnet.benchmark.datasets.disturbed import disturbed_pairs
from skipnet.benchmark.datasets.pairset import PairSet
from skipnet.benchmark.methods import Method, make_method
from skipnet.benchmark.options import EvaluateConfig, MethodConfig, ProtocolKind
from skipnet.benchmark.running.isolation import isolated
from skipnet.benchmark.scoring.protocols import PROTOCOLS
from skipnet.checks import require
from skipnet.networks.names import SHIPPED, weights_file

USE_A_NETWORK = ("skipnet.benchmark.methods.ours.make", "skipnet.benchmark.methods.matching.make")
"""What makes methods whose answers depend on weights."""


@dataclass(frozen=True)
class NamedMethod:
    """A method as it enters a benchmark."""

    name: str
    """Key in the predictions; unique."""
    label: str
    """Name in tables and figures."""
    run: Method
    settings_hash: str
    """Changes with the pairs' and the method's settings."""
    start_from: str = ""
    """The method whose coarse pose is this one's start; empty for identity."""


def head_of_report(config: EvaluateConfig) -> dict[str, str]:
    """What was run, for the head of the report."""
    about = {"benchmark": config.benchmark, "methods": ", ".join(config.methods)}
    about |= make_dataset(config).describe()
    if config.disturbances:
        about["conditions"] = "; ".join(
            f"{one.name}: noise {one.noise_m:g} m, {one.keep:.0%} of the points, "
            f"{one.crop:.0%} cut, {one.passers_by} passers-by"
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
    return make_dataset(config).protocol if config.protocol is None else config.protocol


def make_pair_set(config: EvaluateConfig) -> PairSet:
    """The pairs that the config asks for."""
    return disturbed_pairs(make_dataset(config).pairs(), config.disturbances)


def make_methods(config: EvaluateConfig) -> list[NamedMethod]:
    """The chosen methods, each to run in a process of its own, in the order in which they run."""
    require(bool(config.methods), "methods", [], "at least one, methods=[NAME,NAME]")
    methods = []
    for name, method in config.methods.items():
        make = partial(make_method, method.make, dict(method.options))
        make()  # though it will run in a child: a missing package must stop the run here
        methods.append(
            NamedMethod(
                name=name,
                label=method.label or name,
                run=isolated(make, config.time_limit_s, config.threads),
                settings_hash=settings_hash(config, name),
                start_from=method.start_from,
            )
        )
    return methods


def group_of(config: EvaluateConfig) -> dict[str, str]:
    """Method to its group, for the chosen methods that have one."""
    return {name: method.group for name, method in config.methods.items() if method.group}


def settings_hash(config: EvaluateConfig, method: str) -> str:
    """Hash of all settings that an answer of ``method`` depends on.

    Not of how many pairs there are, nor of the other methods: a run can be extended by both. Nor of
    the protocol: answers are scored anew in every run.
    """
    pairs = [*make_dataset(config).key(), [asdict(one) for one in config.disturbances]]
    chain = [config.methods[method]]
    while chain[-1].start_from:
        chain.append(config.methods[chain[-1].start_from])
    answers = [_settings(one) for one in chain]
    text = json.dumps([pairs, answers, config.time_limit_s, config.threads], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def _settings(method: MethodConfig) -> dict[str, Any]:
    """All of a method that decides its answers."""
    return {
        "make": method.make,
        "start_from": method.start_from,
        "options": method.options,
        "weights": _weights_digest(method.make, method.options),
    }


def _weights_digest(make: str, options: Mapping[str, Any]) -> str:
    """Hash of the weights' file that a method uses; empty for one that uses none."""
    if make not in USE_A_NETWORK:
        return ""
    content = weights_file(options.get("weights") or options.get("network") or SHIPPED).read_bytes()
    return hashlib.sha256(content).hexdigest()[:12]
