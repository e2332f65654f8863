"""Registration: from two point clouds to a pose, a verdict and what both rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from skipnet.checks import check_seed
from skipnet.clouds.cleaning import denoise
from skipnet.geometry import invert, transform_points
from skipnet.networks.catalog import find_network
from skipnet.parallel.threads import one_blas_thread
from skipnet.registration.options import RegistrationConfig, as_config
from skipnet.registration.prior import Prior, as_prior, compare, poses_about
from skipnet.registration.result import Asked, Registration, ScanFacts
from skipnet.registration.searching import LAST_RESORTS, search
from skipnet.registration.second_look import is_sure, is_worth_it, poses_in_doubt
from skipnet.registration.stopwatch import Stopwatch
from skipnet.registration.units import likeliest_unit, reason_for, size_of
from skipnet.scans.describing import describe
from skipnet.scans.given import ScanLike, opened, taken
from skipnet.scans.scan import Scan, Viewpoint
from skipnet.skipmap.tree import Points, check_voxel_size, points_of
from skipnet.types import FloatArray, Status

HOPELESS_CONFIDENCE = 0.05
"""With less than this in the best pose, other units are worth a try."""


def register(
    source: ScanLike,
    target: ScanLike,
    *,
    source_viewpoint: Viewpoint = "auto",
    target_viewpoint: Viewpoint = "auto",
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
    prior: Prior | npt.ArrayLike | None = None,
) -> Registration:
    """Find the rigid motion that brings the source scan into the target's frame, without a guess.

    Args:
        source: (N, 3) points in the source's own frame, metres; a Cloud, the path of a file, or, of
            a scan too large to hold, what ``skipnet.skipmap.streaming.thin_chunks`` makes of it.
        target: likewise (M, 3), in the target's own frame.
        source_viewpoint: sensor position in the source's frame: (3,), None when unknown, "auto" to
            take the file's, if it has one, and else to find out.
        target_viewpoint: likewise for the target.
        voxel_size_m: edge of a voxel; None chooses it from the data.
        seed: of every random choice: the same input and seed give the same result.
        config: everything else; None takes the defaults.
        prior: a pose that somebody believes in, (4, 4) or a ``Prior`` that says how far it may be
            off; judged like any other hypothesis, without a say in the verdict.

    Returns:
        The pose before and after fine alignment, the verdict, the time of each stage. To find no
        pose is a result ("failed").

    Raises:
        ValueError: not two clouds of finite points that span a surface, or a bad option.
    """
    check_seed(seed)
    config, prior, clock = as_config(config), as_prior(prior), Stopwatch()
    with clock("validate"):
        source, target = opened(source, "source"), opened(target, "target")
        source_m, source_at = taken(source, source_viewpoint, "source", "source_viewpoint")
        target_m, target_at = taken(target, target_viewpoint, "target", "target_viewpoint")
        if voxel_size_m is not None:
            check_voxel_size(voxel_size_m)
    with clock("denoise"):
        both_m = clean(source_m, config), clean(target_m, config)
    with clock("skip-map"):
        network = find_network(config.network, config.device)
        scans = describe(both_m, (source_at, target_at), voxel_size_m, seed, network)
    result = register_scans(scans[0], scans[1], config, clock, prior)
    if voxel_size_m is None and is_worth_it(result, *scans):
        with clock("skip-map"):
            finer = describe(both_m, (source_at, target_at), result.voxel_size_m / 2, seed, network)
        known = poses_in_doubt(result)
        again = register_scans(finer[0], finer[1], _quick(config), clock, prior, known)
        result, scans = (again, finer) if is_sure(again) else (result, scans)
    if result.status is not Status.REGISTERED:
        result = _naming_units(result, points_of(both_m[0]), points_of(both_m[1]), config, seed)
    return replace(result, given=Asked(source, target, seed, (scans[0], scans[1])))


def register_scans(
    source: Scan,
    target: Scan,
    config: RegistrationConfig,
    clock: Stopwatch,
    prior: Prior | None = None,
    rivals: FloatArray | None = None,
) -> Registration:
    """As ``register``, for scans that are described already, with one voxel size; (K, 4, 4) known
    rivals are compared with the pose that is found.

    The search knows neither which scan is called the source nor the frames they were given in, so
    swapping the scans gives the inverse and moving one of them moves the answer along.
    """
    return register_with_finalists(source, target, config, clock, prior, rivals)[0]


@one_blas_thread
def register_with_finalists(
    source: Scan,
    target: Scan,
    config: RegistrationConfig,
    clock: Stopwatch,
    prior: Prior | None = None,
    rivals: FloatArray | None = None,
) -> tuple[Registration, FloatArray]:
    """As ``register_scans``, with the (K, 4, 4) distinct poses that were in the last round."""
    moving, fixed = sorted((source, target), key=lambda scan: scan.rank)
    poses = _guesses(prior, source, target), _between_own(rivals, source, target)
    guesses, known = poses if moving is source else map(invert, poses)
    answer = search(moving, fixed, config, clock, guesses, known)
    if moving is not source:
        answer = answer.mapped(invert, invert(answer.T_target_source))
    answer = answer.mapped(
        lambda T_own: target.T_given_own @ T_own @ invert(source.T_given_own),
        target.T_given_own,
    )
    check = None
    if prior is not None:
        check = compare(prior, answer.T_target_source, *_middle(source))
    reason = f"{answer.verdict.reason}; {check}" if check else answer.verdict.reason
    result = Registration(
        T_target_source=answer.T_target_source,
        T_target_source_coarse=answer.T_target_source_coarse,
        status=answer.verdict.status,
        confidence=answer.verdict.confidence,
        reason=_with_strays(reason, source.record.strays + target.record.strays),
        voxel_size_m=source.skipmap.voxel_size_m,
        source=_facts(source),
        target=_facts(target),
        findings=answer.findings,
        prior=check,
        timings_s=clock.seconds,
        network=source.network.digest,
    )
    return result, answer.finalists


def _guesses(prior: Prior | None, source: Scan, target: Scan) -> FloatArray:
    """(C, 4, 4) poses about a prior, between the frames in which the scans are searched."""
    given = None if prior is None else poses_about(prior, *_middle(source))
    return _between_own(given, source, target)


def _between_own(given: FloatArray | None, source: Scan, target: Scan) -> FloatArray:
    """(C, 4, 4) poses between the frames as given, made those between which is searched."""
    if given is None:
        return np.zeros((0, 4, 4))
    return invert(target.T_given_own) @ given @ source.T_given_own


def _middle(source: Scan) -> tuple[FloatArray, float]:
    """(3,) the source's centre in the frame that it was given in, and the voxel size."""
    centre_m = transform_points(source.T_given_own, source.evidence.centre_m[None])[0]
    return centre_m, source.skipmap.voxel_size_m


def _naming_units(
    result: Registration,
    source_m: FloatArray,
    target_m: FloatArray,
    config: RegistrationConfig,
    seed: int,
) -> Registration:
    """The same result, its reason naming the units if the scans only agree in different ones.

    Units are tried, by the cheaper generators; where that does not help, what may be a part and its
    whole is left as it is.
    """
    source_size, target_size = size_of(source_m), size_of(target_m)
    guess = likeliest_unit(source_size, target_size)
    hopeless = result.status is not Status.REGISTERED and result.confidence < HOPELESS_CONFIDENCE
    if guess is None or not (hopeless or guess.is_worth_trying):
        return result
    clouds_m = guess.factor * source_m, target_m
    scans = describe(
        clouds_m, ("auto", "auto"), None, seed, find_network(config.network, config.device)
    )
    registers = _register(scans[0], scans[1], _quick(config))
    if not (registers or guess.is_surely_apart):
        return result
    return replace(result, status=Status.FAILED, reason=reason_for(guess, registers))


def _quick(config: RegistrationConfig) -> RegistrationConfig:
    """The same without the generators that are asked last, if it has others."""
    cheap = [one for one in config.generators if one not in LAST_RESORTS]
    return replace(config, generators=cheap or config.generators)


@one_blas_thread
def _register(source: Scan, target: Scan, config: RegistrationConfig) -> bool:
    """Whether two scans can be registered."""
    moving, fixed = sorted((source, target), key=lambda scan: scan.rank)
    answer = search(moving, fixed, config, Stopwatch(), only_registered=True)
    return answer.verdict.status is Status.REGISTERED


def _facts(scan: Scan) -> ScanFacts:
    """What is known about one scan, for the result."""
    extent_m = np.ptp(scan.evidence.points_m, axis=0) if len(scan.skipmap) else None
    known = extent_m, scan.viewpoint_given_m, scan.record.trust, scan.record.strays
    return ScanFacts(*known, _side_given(scan))


def _side_given(scan: Scan) -> FloatArray | None:
    """(3,) unit direction to where a thing was seen from, in the frame that the scan was given in;
    None where that was not found out."""
    side = scan.record.side
    if side is None:
        return None
    way = scan.T_given_own[:3, :3] @ (side.viewpoint_m - scan.evidence.centre_m)
    unit: FloatArray = way / np.linalg.norm(way)
    return unit


def _with_strays(reason: str, strays: int) -> str:
    """The reason, and how many points had no say."""
    return f"{reason}; {strays} points far from all others were left out" if strays else reason


def clean(cloud_m: Points, config: RegistrationConfig) -> Points:
    """The paper's denoising, where the config asks for it."""
    if not config.denoise:
        return cloud_m
    kept = denoise(points_of(cloud_m), config.denoise_neighbours, config.denoise_sigma)
    return cloud_m[kept]
