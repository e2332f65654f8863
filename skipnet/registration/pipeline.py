"""Registration on one screen: from two point clouds to a pose, a verdict and what both rest on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from skipnet.clouds.cleaning import denoise, validate
from skipnet.config import Generator, RegistrationConfig
from skipnet.features.descriptors import fpfh, mutual_nearest
from skipnet.geometry import invert
from skipnet.learning.descriptor import correspond, load_descriptor
from skipnet.registration.feature_hypotheses import from_corners, from_edges
from skipnet.registration.hypotheses import Hypotheses, from_correspondences
from skipnet.registration.plane_hypotheses import from_planes, from_slides
from skipnet.registration.refinement import Refinement, refine
from skipnet.registration.scans import Scan, Viewpoint, check_viewpoint, describe
from skipnet.registration.stopwatch import Stopwatch
from skipnet.registration.verdict import Findings, Verdict, decide, holds, is_free
from skipnet.registration.verification import Score, distinct, judge, shortlist
from skipnet.skipmap.resolution import choose_voxel_size
from skipnet.types import FloatArray, IntArray, Registration

AMBIGUOUS_LEAD = 0.05
"""A rival whose score comes within this share of the best one's explains the data as well."""
CHANCE_SCORE = 0.1
"""What some pose always scores: a lead counts against this, though no rival be found."""
CLEAR_CONFIDENCE = 0.99
"""With this much confidence no further generator is asked."""


def register(
    source: npt.ArrayLike,
    target: npt.ArrayLike,
    *,
    source_viewpoint: Viewpoint = "auto",
    target_viewpoint: Viewpoint = "auto",
    voxel_size_m: float | None = None,
    seed: int = 0,
    config: RegistrationConfig | None = None,
) -> Registration:
    """Find the rigid motion that brings the source scan into the target's frame, without a guess.

    Args:
        source: (N, 3) points in the source's own frame, metres.
        target: (M, 3) points in the target's own frame, metres.
        source_viewpoint: sensor position in the source's frame: (3,), None when unknown, "auto" to
            find out.
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
        clouds = validate(source, "source"), validate(target, "target")
        check_viewpoint(source_viewpoint, "source_viewpoint")
        check_viewpoint(target_viewpoint, "target_viewpoint")
    with clock("denoise"):
        source_m, target_m = (clean(points_m, config) for points_m in clouds)
    with clock("skip-map"):
        size_m = choose_voxel_size(source_m, target_m) if voxel_size_m is None else voxel_size_m
        scans = [
            describe(points_m, size_m, viewpoint, seed)
            for points_m, viewpoint in (
                (source_m, source_viewpoint),
                (target_m, target_viewpoint),
            )
        ]
    return register_scans(scans[0], scans[1], config, clock)


def register_scans(
    source: Scan, target: Scan, config: RegistrationConfig, clock: Stopwatch
) -> Registration:
    """As ``register``, for scans that are described already, with one voxel size.

    The search knows neither which scan is called the source nor the frames they were given in, so
    swapping the scans gives the inverse and moving one of them moves the answer along.
    """
    moving, fixed = sorted((source, target), key=lambda scan: scan.rank)
    answer = search(moving, fixed, config, clock)
    if moving is not source:
        answer = answer.mapped(invert, answer.T_target_source[:3, :3].T)
    answer = answer.mapped(
        lambda T_own: target.T_given_own @ T_own @ invert(source.T_given_own),
        target.T_given_own[:3, :3],
    )
    return Registration(
        T_target_source=answer.T_target_source,
        T_target_source_coarse=answer.T_target_source_coarse,
        status=answer.verdict.status,
        confidence=answer.verdict.confidence,
        reason=answer.verdict.reason,
        timings_s=clock.seconds,
        details=answer.details(source, target),
    )


def search(source: Scan, target: Scan, config: RegistrationConfig, clock: Stopwatch) -> Answer:
    """Propose, verify and refine, one generator after the other until the verdict is clear."""
    with clock("classes"):
        source, target = (
            scan.weighing_features(config.feature_weight) for scan in (source, target)
        )
    answer = Answer.none()
    if min(len(source.skipmap), len(target.skipmap)) == 0:
        return answer
    for generator in config.generators:
        with clock("hypotheses"):
            hypotheses = propose(generator, source, target, config)
        with clock("verification"):
            candidates = np.concatenate([answer.candidates, hypotheses.T_target_source])
            candidates = shortlist(
                candidates, source.evidence, target.evidence, config.violation_weight
            )
        with clock("fine alignment"):
            answer = settle(candidates, source, target, config)
        if answer.verdict.status == "registered" and answer.verdict.confidence >= CLEAR_CONFIDENCE:
            break
    return answer


def clean(points_m: FloatArray, config: RegistrationConfig) -> FloatArray:
    """The paper's denoising, where the config asks for it."""
    if not config.denoise:
        return points_m
    return points_m[denoise(points_m, config.denoise_neighbours, config.denoise_sigma)]


def propose(
    generator: Generator, source: Scan, target: Scan, config: RegistrationConfig
) -> Hypotheses:
    """Candidate poses of one generator."""
    size_m = source.skipmap.voxel_size_m
    if generator is Generator.corners:
        return from_corners(source.corners, target.corners, size_m, config.same_class_corners)
    if generator is Generator.edges:
        return from_edges(source.lines, target.lines, size_m)
    if generator in (Generator.planes, Generator.slides):
        both_seen = source.viewpoint_m is not None and target.viewpoint_m is not None
        planes = source.planes if both_seen else source.planes.with_both_signs()
        if generator is Generator.planes:
            return from_planes(planes, target.planes, size_m)
        voxels = source.skipmap.centroids_m, target.skipmap.centroids_m
        return from_slides(planes, target.planes, *voxels, size_m)
    if generator is Generator.fpfh:
        found = mutual_nearest(fpfh(source.skipmap), fpfh(target.skipmap))
    else:
        found = correspond(source.skipmap, target.skipmap, load_descriptor())
    rows_s, rows_t, distance = found
    best = np.argsort(distance, kind="stable")[: config.max_correspondences]
    source_m = source.skipmap.centroids_m[rows_s[best]]
    target_m = target.skipmap.centroids_m[rows_t[best]]
    return from_correspondences(source_m, target_m, np.ones(len(best)), 1.5 * size_m)


@dataclass(frozen=True)
class Answer:
    """The best pose so far, the verdict on it, and the candidates it was chosen from."""

    candidates: FloatArray
    T_target_source: FloatArray
    T_target_source_coarse: FloatArray
    verdict: Verdict
    findings: Findings | None

    @staticmethod
    def none() -> Answer:
        """Before any candidate: the identity, failed."""
        verdict = Verdict(
            "failed", 0.0, "the scans offered no feature from which to propose a pose"
        )
        return Answer(np.zeros((0, 4, 4)), np.eye(4), np.eye(4), verdict, None)

    def mapped(self, change: Callable[[FloatArray], FloatArray], rotation: FloatArray) -> Answer:
        """The same answer between other frames.

        Args:
            change: maps (..., 4, 4) poses to those between the new frames.
            rotation: (3, 3) from the old target frame to the new one.
        """
        poses = [change(T) for T in (self.candidates, self.T_target_source)]
        coarse = change(self.T_target_source_coarse)
        if self.findings is None:
            return Answer(poses[0], poses[1], coarse, self.verdict, None)
        findings = replace(
            self.findings,
            free_directions=self.findings.free_directions @ rotation.T,
            alternatives=change(self.findings.alternatives),
        )
        return Answer(poses[0], poses[1], coarse, decide(findings), findings)

    def details(self, source: Scan, target: Scan) -> dict[str, object]:
        """What was assumed and found, for reports."""
        found = self.findings
        viewpoints_m = [
            None if scan.viewpoint_given_m is None else scan.viewpoint_given_m.tolist()
            for scan in (source, target)
        ]
        return {
            "voxel_size_m": source.skipmap.voxel_size_m,
            "source_viewpoint_m": viewpoints_m[0],
            "target_viewpoint_m": viewpoints_m[1],
            "overlap": found and found.overlap,
            "violation": found and found.violation,
            "margin": found and found.margin,
            "matched_voxels": found and found.matched,
            "residual_voxels": found and found.residual_voxels,
            "held_voxels": found and found.held_voxels,
            "free_directions": found and found.free_directions.tolist(),
            "alternatives_T_target_source": found and found.alternatives.tolist(),
        }


def settle(
    candidates: FloatArray, source: Scan, target: Scan, config: RegistrationConfig
) -> Answer:
    """Refine the candidates a little, judge them again with all evidence, and decide."""
    if len(candidates) == 0:
        return Answer.none()
    levels = [(source.coarse, target.coarse), (source.skipmap, target.skipmap)]
    fine = refine(candidates, levels, samples=config.refine_samples, max_steps=5)
    score = judge(
        fine.T_target_source,
        source.evidence,
        target.evidence,
        config.final_samples,
        config.violation_weight,
        max_distance_voxels=0.5,
    )
    order = np.argsort(-score.total, kind="stable")
    size_m = source.skipmap.voxel_size_m
    kept = order[distinct(fine.T_target_source[order], source.evidence.points_m, 2 * size_m)]
    best = polish(fine.T_target_source[kept[0]], source, target)
    findings = summarise(best, fine.T_target_source, score, kept, size_m)
    return Answer(
        candidates, best.T_target_source[0], candidates[kept[0]], decide(findings), findings
    )


def summarise(
    fine: Refinement, T_target_source: FloatArray, score: Score, kept: IntArray, voxel_size_m: float
) -> Findings:
    """What the verdict rests on.

    Args:
        fine: the best pose, polished.
        T_target_source: (K, 4, 4) all refined candidates.
        score: the judge's figures for these.
        kept: rows of the distinct ones, best first.
        voxel_size_m: edge of a voxel.
    """
    best, rivals = kept[0], kept[1:]
    top = max(float(score.total[best]), 1e-9)
    lead = 1 - score.total[rivals] / top
    closest = max(score.total[rivals].max(initial=0.0), CHANCE_SCORE)
    share, directions = holds(fine.information[0], fine.matched[0])
    return Findings(
        overlap=float(score.overlap[best]),
        violation=float(score.violation[best]),
        margin=float(max(1 - closest / top, 0.0)),
        matched=int(fine.matched[0]),
        residual_voxels=float(fine.residual_m[0] / voxel_size_m),
        held_voxels=float(share[0] * fine.matched[0]),
        free_directions=directions[is_free(share, fine.matched[0])],
        alternatives=T_target_source[rivals[lead < AMBIGUOUS_LEAD]],
    )


def polish(T_target_source: FloatArray, source: Scan, target: Scan) -> Refinement:
    """The final fine alignment of one (4, 4) pose, with every voxel of the two finer levels."""
    levels = [
        (source.skipmap, target.skipmap),
        (source.fine_skipmap, target.fine_skipmap),
    ]
    return refine(T_target_source[None], levels)
