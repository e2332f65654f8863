"""Many scans in one frame: register pairs, trust the best of them, balance what is left over."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations

from skipnet.networks.catalog import find_network
from skipnet.projects.graph import PairKey, Poses, closure_m, measure, solve
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.pipeline import clean, register_scans
from skipnet.registration.result import Registration
from skipnet.registration.stopwatch import Stopwatch
from skipnet.scans.given import ScanLike, taken
from skipnet.scans.scan import Scan, Viewpoint, describe
from skipnet.types import FloatArray

MAX_CLOSURE_VOXELS = 1.0
"""A pair that puts the centre of its overlap farther off than the more trusted ones do is wrong."""


@dataclass(frozen=True)
class MultiviewResult:
    """Where every scan stands, and what that rests on."""

    T_first_scan: list[FloatArray | None]
    """Per scan the (4, 4) pose in the first scan's frame; None where nothing connects it."""
    pairs: dict[PairKey, Registration]
    """What registering each pair (target, source) gave."""
    closures_m: dict[PairKey, float]
    """Of every registered pair among placed scans: how far its own pose and the final poses put
    the centre of its overlap apart, metres. 0 where nothing else constrains it."""
    rejected: list[PairKey]
    """Registered pairs that contradict more trusted ones and had no say."""
    status: str
    """"registered" when every scan has its place, else "failed"."""
    reason: str
    """One sentence for a person."""
    timings_s: dict[str, float] = field(default_factory=dict)
    """Seconds per stage."""


def register_many(
    scans: Sequence[ScanLike],
    *,
    viewpoints: Sequence[Viewpoint] | None = None,
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
) -> MultiviewResult:
    """Bring scans of one scene into the frame of the first, without a guess.

    Every scan is described once and every pair registered. The registered pairs of most confidence
    that connect the scans place them; the others, where they do not contradict these, balance the
    poses (pose graph, weighted by what each pair determines). Time grows with the square of the
    number of scans.

    Args:
        scans: two or more (N, 3) point clouds, each in its own frame, metres; see
            ``skipnet.register``.
        viewpoints: of each scan as in ``skipnet.register``; None finds all of them out.
        voxel_size_m: edge of a voxel; None chooses it from the data.
        seed: of every random choice.
        config: everything else; None takes the defaults.

    Raises:
        ValueError: fewer than two scans, one that is no point cloud, or viewpoints that do not fit.
    """
    config = config or RegistrationConfig()
    clock = Stopwatch()
    with clock("skip-map"):
        described = _describe_all(scans, viewpoints, voxel_size_m, seed, config)
    with clock("pairs"):
        pairs = {
            (target, source): register_scans(
                described[source], described[target], config, Stopwatch()
            )
            for target, source in combinations(range(len(described)), 2)
        }
    with clock("pose graph"):
        links = {
            (target, source): measure(described[source], described[target], pair.T_target_source)
            for (target, source), pair in pairs.items()
            if pair.status == "registered"
        }
        limit_m = MAX_CLOSURE_VOXELS * described[0].skipmap.voxel_size_m
        poses, agreeing = solve(links, {key: _trust(pairs[key]) for key in links}, limit_m)
        links = {key: link for key, link in links.items() if key[0] in poses and key[1] in poses}
    rejected = [key for key in links if key not in agreeing]
    status, reason = _verdict(poses, len(described), pairs, len(rejected))
    return MultiviewResult(
        T_first_scan=[poses.get(scan) for scan in range(len(described))],
        pairs=pairs,
        closures_m={key: closure_m(link, key, poses) for key, link in links.items()},
        rejected=rejected,
        status=status,
        reason=reason,
        timings_s=clock.seconds,
    )


def _describe_all(
    scans: Sequence[ScanLike],
    viewpoints: Sequence[Viewpoint] | None,
    voxel_size_m: float | None,
    seed: int,
    config: RegistrationConfig,
) -> list[Scan]:
    if len(scans) < 2:
        raise ValueError(f"got {len(scans)} scans: expected two or more")
    if viewpoints is None:
        viewpoints = ["auto"] * len(scans)
    if len(viewpoints) != len(scans):
        raise ValueError(
            f"got {len(viewpoints)} viewpoints for {len(scans)} scans: expected one each"
        )
    given = [
        taken(scan, viewpoint, f"scans[{number}]", f"viewpoints[{number}]")
        for number, (scan, viewpoint) in enumerate(zip(scans, viewpoints, strict=True))
    ]
    clouds_m = [clean(cloud_m, config) for cloud_m, _ in given]
    found = [viewpoint for _, viewpoint in given]
    network = find_network(config.network, config.device)
    return describe(clouds_m, found, voxel_size_m, seed, network)


def _trust(pair: Registration) -> tuple[float, float]:
    """Confidence to two digits, then overlap: near-certain pairs differ in what they share."""
    return round(pair.confidence, 2), pair.findings.overlap if pair.findings else 0.0


def _verdict(
    poses: Poses, count: int, pairs: Mapping[PairKey, Registration], rejected: int
) -> tuple[str, str]:
    lost = [scan for scan in range(count) if scan not in poses]
    registered = sum(pair.status == "registered" for pair in pairs.values())
    found = f"{registered} of {len(pairs)} pairs registered"
    if rejected:
        found += f", {rejected} of them rejected because others contradict them"
    if not lost:
        return "registered", f"{found}; they connect all {count} scans"
    names = ", ".join(str(scan) for scan in lost)
    plural = "scans" if len(lost) > 1 else "scan"
    return "failed", f"{found}; nothing connects {plural} {names} with scan 0"
