"""Registration on one screen: from two point clouds to a pose, a verdict and what both rest on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skipnet.clouds.cleaning import denoise
from skipnet.geometry import invert
from skipnet.networks.catalog import find_network
from skipnet.parallel.threads import one_blas_thread
from skipnet.registration.answer import Answer
from skipnet.registration.generators import propose
from skipnet.registration.hypotheses.repeats import from_repeats
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.riding import silence_riders
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.result import Registration, ScanFacts
from skipnet.registration.settling import settle
from skipnet.registration.stopwatch import Stopwatch
from skipnet.registration.units import likeliest_unit, reason_for, size_of
from skipnet.scans.describing import describe
from skipnet.scans.given import ScanLike, taken
from skipnet.scans.scan import Scan, Viewpoint
from skipnet.skipmap.tree import Points, check_voxel_size, points_of
from skipnet.types import FloatArray, Status

HOPELESS_CONFIDENCE = 0.05
"""With less than this in the best pose, other units are worth a try."""
CLEAR_CONFIDENCE = 0.95
"""With this much confidence in a registered pose no further generator is asked."""


def register(
    source: ScanLike,
    target: ScanLike,
    *,
    source_viewpoint: Viewpoint = "auto",
    target_viewpoint: Viewpoint = "auto",
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
) -> Registration:
    """Find the rigid motion that brings the source scan into the target's frame, without a guess.

    Args:
        source: (N, 3) points in the source's own frame, metres; a Cloud, or the path of a file; of
            a scan too large to hold, the voxels that ``skipnet.skipmap.streaming.thin_chunks``
            reads it into.
        target: (M, 3) points in the target's own frame, metres, or one of these.
        source_viewpoint: sensor position in the source's frame: (3,), None when unknown, "auto" to
            take the file's, if it has one, and else to find out.
        target_viewpoint: likewise for the target.
        voxel_size_m: edge of a voxel; None chooses it from the data.
        seed: of every random choice: the same input and seed give the same result.
        config: everything else; None takes the defaults.

    Returns:
        The pose before and after fine alignment, the verdict and the time of each stage. Not to
        find a pose is a result ("failed"), not an error.

    Raises:
        ValueError: the input is not two clouds of finite points that span a surface, or an option
            is out of its range.
    """
    config = config or RegistrationConfig()
    clock = Stopwatch()
    with clock("validate"):
        source_m, source_viewpoint = taken(source, source_viewpoint, "source", "source_viewpoint")
        target_m, target_viewpoint = taken(target, target_viewpoint, "target", "target_viewpoint")
        if voxel_size_m is not None:
            check_voxel_size(voxel_size_m)
    with clock("denoise"):
        source_m, target_m = clean(source_m, config), clean(target_m, config)
    with clock("skip-map"):
        viewpoints = source_viewpoint, target_viewpoint
        network = find_network(config.network, config.device)
        scans = describe((source_m, target_m), viewpoints, voxel_size_m, seed, network)
    result = register_scans(scans[0], scans[1], config, clock)
    if result.status is Status.REGISTERED:
        return result
    return _naming_units(result, points_of(source_m), points_of(target_m), config, seed)


def register_scans(
    source: Scan, target: Scan, config: RegistrationConfig, clock: Stopwatch
) -> Registration:
    """As ``register``, for scans that are described already, with one voxel size.

    The search knows neither which scan is called the source nor the frames they were given in, so
    swapping the scans gives the inverse and moving one of them moves the answer along.
    """
    return register_with_finalists(source, target, config, clock)[0]


@one_blas_thread
def register_with_finalists(
    source: Scan, target: Scan, config: RegistrationConfig, clock: Stopwatch
) -> tuple[Registration, FloatArray]:
    """As ``register_scans``, with the (K, 4, 4) distinct poses that were in the last round."""
    moving, fixed = sorted((source, target), key=lambda scan: scan.rank)
    answer = search(moving, fixed, config, clock)
    if moving is not source:
        answer = answer.mapped(invert, answer.T_target_source[:3, :3].T)
    answer = answer.mapped(
        lambda T_own: target.T_given_own @ T_own @ invert(source.T_given_own),
        target.T_given_own[:3, :3],
    )
    result = Registration(
        T_target_source=answer.T_target_source,
        T_target_source_coarse=answer.T_target_source_coarse,
        status=answer.verdict.status,
        confidence=answer.verdict.confidence,
        reason=_with_strays(answer.verdict.reason, source.record.strays + target.record.strays),
        voxel_size_m=source.skipmap.voxel_size_m,
        source=_facts(source),
        target=_facts(target),
        findings=answer.findings,
        timings_s=clock.seconds,
        network=source.network.digest,
    )
    return result, answer.finalists


def _naming_units(
    result: Registration,
    source_m: FloatArray,
    target_m: FloatArray,
    config: RegistrationConfig,
    seed: int,
) -> Registration:
    """The same result, its reason naming the units if the scans only agree in different ones.

    Units are tried; where that does not help, what may be a part and its whole is left as it is.
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
    retry = register_scans(scans[0], scans[1], config, Stopwatch())
    registers = retry.status is Status.REGISTERED
    if not (registers or guess.is_surely_apart):
        return result
    return replace(result, status=Status.FAILED, reason=reason_for(guess, registers))


def _facts(scan: Scan) -> ScanFacts:
    """What is known about one scan, for the result."""
    extent_m = np.ptp(scan.evidence.points_m, axis=0) if len(scan.skipmap) else None
    return ScanFacts(extent_m, scan.viewpoint_given_m, scan.record.trust, scan.record.strays)


def _with_strays(reason: str, strays: int) -> str:
    """The reason, and how many points had no say."""
    return f"{reason}; {strays} points far from all others were left out" if strays else reason


def search(source: Scan, target: Scan, config: RegistrationConfig, clock: Stopwatch) -> Answer:
    """Propose, verify and refine, one generator after the other until the verdict is clear."""
    with clock("classes"):
        source, target = (scan.valued(config.feature_weight) for scan in (source, target))
    answer = Answer.none()
    if min(len(source.skipmap), len(target.skipmap)) == 0:
        return answer
    judge = Judge(source.evidence, target.evidence, config.final_samples, config.violation_weight)
    judge = silence_riders(judge, invert(target.T_given_own) @ source.T_given_own)
    for generator in config.generators:
        if is_enough(answer, generator):
            break
        with clock("hypotheses"):
            hypotheses = propose(generator, source, target, config)
        with clock("verification"):
            fresh = judge.shortlist(hypotheses.T_target_source)
        with clock("fine alignment"):
            answer = settle(answer, fresh, source, target, judge, config)
    return _with_repeats(answer, source, target, judge, config, clock)


def _with_repeats(
    answer: Answer,
    source: Scan,
    target: Scan,
    judge: Judge,
    config: RegistrationConfig,
    clock: Stopwatch,
) -> Answer:
    """The answer after a look at what repeats: generators propose what agrees most, and where a
    pattern brings both sensors to the same place of it, the true pose may not be among that.

    Blind scans are not asked: nothing would contradict such rivals, and smooth shapes have many.
    """
    found, registered = answer.findings, answer.verdict.status is Status.REGISTERED
    if not registered or found is None or found.is_blind:
        return answer
    best = answer.T_target_source
    with clock("hypotheses"):
        hypotheses = from_repeats(best, judge.source, judge.target)
    with clock("verification"):
        fresh = judge.apart(best, judge.shortlist(hypotheses.T_target_source))
    if len(fresh) == 0:
        return answer
    with clock("fine alignment"):
        return settle(answer, fresh, source, target, judge, config)


def is_enough(answer: Answer, coming: Generator) -> bool:
    """Whether the coming generator need not be asked; FPFH takes longer than all the others.

    Where a viewpoint is unknown nothing contradicts a wrong pose but a better one: all others are
    asked for rivals.
    """
    if coming is not Generator.fpfh and answer.findings is not None and answer.findings.is_blind:
        return False
    verdict = answer.verdict
    enough = 0.0 if coming is Generator.fpfh else CLEAR_CONFIDENCE
    return verdict.status is Status.REGISTERED and verdict.confidence >= enough


def clean(cloud_m: Points, config: RegistrationConfig) -> Points:
    """The paper's denoising, where the config asks for it."""
    if not config.denoise:
        return cloud_m
    kept = denoise(points_of(cloud_m), config.denoise_neighbours, config.denoise_sigma)
    return cloud_m[kept]
