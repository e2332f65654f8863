"""Fine alignment with the judge beside it: dense scans by normals, sparse ones by GICP."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Union

import numpy as np

from skipnet.parallel.threads import side_by_side
from skipnet.registration.alignment.normal_equations import Surfaces, match_surfaces
from skipnet.registration.alignment.refinement import Refinement, refine
from skipnet.registration.alignment.sparse import finish_sparse, refine_sparse
from skipnet.registration.alignment.thin_planes import lay_on_planes
from skipnet.registration.contenders import Contenders
from skipnet.registration.judging.judge import HOPELESS, Judge
from skipnet.registration.judging.likeness import odd_share
from skipnet.registration.judging.score import ROUGH, Score
from skipnet.registration.judging.sliding import (
    ON_ITSELF_SUPPORT,
    gains_much,
    holds_against,
    slide,
    weak_motions,
)
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray

MIN_POLISHED = 0.85
"""A final fine alignment that leaves a pose less than this share of its score is undone."""
SPARSE_FINALISTS = 6
"""Candidates of sparse scans that are worth fine alignment by GICP."""
SLIDING_FINALISTS = 6
"""So many candidates are slid along motions that few normals hold ..."""
WORTH_SLIDING = 0.5
"""... if they score this share of the best one: a slide adds two thirds to a score at most."""
MIRROR_SAMPLES = 1500
"""Voxels with which mirror images are aligned."""
MIN_MIRRORED = 0.3
"""How clearly the mirror image must be the better one, of ``Judge.decisiveness``."""
ALIKE_VOXELS, MIN_NORMAL_COSINE = 0.05, 0.85
"""How far each voxel's centroid errs where all count alike; which normals may be of one surface."""
MAX_STEPS = 5
"""Of each candidate's first alignment, at each level."""

LATTICE_DOUBT = 90.0
"""Where points lie on a lattice the steps of all surfaces err together: by this, times the cube of
its edge in fine voxels, is the covariance larger. Chosen on some 200 simulated pairs rounded to
10 to 100 mm."""
HELD_DOUBT = 20.0
"""Where few voxels hold a pose their errors do not average out either: by this over the voxels that
hold its weakest motion is the covariance larger. Chosen on 34 simulated doorways and 25 views of
little overlap."""
SPARSE_DOUBT = 2.5
"""Times that the covariance of sparse scans is larger: across the direction that arcs of floors
hold the errors have heavy tails. Chosen on some 200 simulated pairs of 16 lines."""

Aligner = Union["DenseAligner", "SparseAligner"]


@dataclass(frozen=True)
class DenseAligner:
    """Aligns by the normals of voxels, and slides along motions that few normals hold."""

    source: Scan
    target: Scan
    judge: Judge
    samples: int
    """Voxels of the source with which candidates are refined."""
    is_sparse = False

    def prepare(self, coarse: FloatArray, start: FloatArray, rival_total: float) -> Contenders:
        """Refine candidates a little, from (C, 4, 4) ``start``, proposed as ``coarse``."""
        fine = _refine_roughly(start, self.source, self.target, self.samples)
        score = self.judge.score(fine.T_target_source)
        return Contenders(coarse, fine, fine.T_target_source, score)

    def finish(self, best: Refinement, T_target_source: FloatArray, total: float) -> Refinement:
        """The final fine alignment of one pose, undone if the judge likes its result less.

        Args:
            best: the pose as prepared.
            T_target_source: (4, 4) the same after slides.
            total: its score.
        """
        fine = polish(T_target_source[None], self.source, self.target)
        # What hardly anything holds may drift: then the judge likes it less than before.
        if self.judge.score(fine.T_target_source).total[0] < MIN_POLISHED * total:
            return replace(best, T_target_source=T_target_source[None])
        return fine

    def doubt(self, held_voxels: float) -> float:
        """Times that the covariance is larger than the matched surfaces' scatter predicts, where so
        many voxels hold the weakest motion."""
        few = 1 + HELD_DOUBT / max(held_voxels, 1.0)
        return few * _lattice_doubt(self.source, self.target)

    def evenly_held(self, T_target_source: FloatArray) -> float:
        """Voxels that hold the weakest motion of a (4, 4) pose, however well each knows its place.

        On gentle ground dense voxels before the sensor outweigh a thousandfold the slopes that hold
        it; bare walls are held by none, whatever weighs most.
        """
        variance_m2 = (ALIKE_VOXELS * self.judge.voxel_size_m) ** 2
        every, table = slice(None), self.target.skipmap.table
        source, target = (
            replace(one, variance_m2=np.full_like(one.variance_m2, variance_m2))
            for one in (Surfaces.of(scan.skipmap, every) for scan in (self.source, self.target))
        )
        found = match_surfaces(T_target_source[None], source, target, table, MIN_NORMAL_COSINE)
        share, _ = holds_against(found.information[0], found.matched[0], found.spread_m[0])
        return float(share[0] * found.matched[0])

    def odd_share(self, T_target_source: FloatArray) -> float:
        """Share of what agrees under a (4, 4) pose that lies off by far more than the rest."""
        return odd_share(T_target_source, self.source, self.target)

    def is_mirrored(self, T_target_source: FloatArray) -> bool:
        """Whether the source's mirror image explains the target clearly better than a (4, 4) pose.

        What is nearly its own mirror image can be laid on that, so its images about the principal
        planes, from where the pose puts them, are tried.
        """
        centre_m, judge = self.judge.source.centre_m, self.judge
        images = np.repeat(np.eye(4)[None], 3, axis=0)
        for axis, image in enumerate(images):
            image[axis, axis] = -1
            image[axis, 3] = 2 * centre_m[axis]
        start = T_target_source @ images
        T = _refine_roughly(start, self.source, self.target, MIRROR_SAMPLES).T_target_source
        best = T[judge.score(T).total.argmax()]
        total = judge.score(np.stack([T_target_source, best])).total
        if total[1] <= total[0]:
            return False
        return bool(judge.decisiveness(best, T_target_source[None])[0] > MIN_MIRRORED)

    def slid(self, aligned: Contenders, rival_total: float, is_hopeless: bool) -> Contenders:
        """The best of them moved along their weak directions, with new scores.

        Not what scores far less than what is in the running already; and where nothing is near
        being registered, only what gains much by it, as a tenth of the voxels says.
        """
        fine, total, T = aligned.fine, aligned.score.total, aligned.T_target_source.copy()
        support = aligned.score.support
        rows = self.judge.distinct(T, aligned.score)[:SLIDING_FINALISTS]
        for row in rows[total[rows] >= WORTH_SLIDING * max(aligned.best_total, rival_total)]:
            hold = fine.information[row], fine.matched[row], fine.spread_m[row]
            for motion in weak_motions(*hold, may_turn=support[row] >= ON_ITSELF_SUPPORT):
                case = motion, fine.centre_m[row], self.judge
                if not is_hopeless or gains_much(T[row], *case):
                    T[row] = slide(T[row], *case)
        slid = np.flatnonzero((fine.T_target_source != T).any(axis=(1, 2)))
        if len(slid) == 0:
            return aligned
        score = aligned.score.replaced(slid, self.judge.score(T[slid]))
        return replace(aligned, T_target_source=T, score=score)


@dataclass(frozen=True)
class SparseAligner:
    """Aligns scans of few lines: by GICP, then by the planes that one has and the other touches."""

    source: Scan
    target: Scan
    judge: Judge
    samples: int
    """Voxels of the source with which candidates are refined before GICP."""
    may_count: Callable[[Score], bool] = lambda score: True
    """Whether half aligned poses with these scores are near enough to being registered to be
    aligned on; by default all are."""
    is_sparse = True

    def doubt(self, held_voxels: float) -> float:
        """Times that the covariance is larger than the matched surfaces' scatter predicts."""
        return SPARSE_DOUBT * _lattice_doubt(self.source, self.target)

    def evenly_held(self, T_target_source: FloatArray) -> float:
        """0: the normals of scan lines err, each alike."""
        return 0.0

    def odd_share(self, T_target_source: FloatArray) -> float:
        """0: scan lines lie too far apart to tell."""
        return 0.0

    def is_mirrored(self, T_target_source: FloatArray) -> bool:
        """Likewise."""
        return False

    def prepare(self, coarse: FloatArray, start: FloatArray, rival_total: float) -> Contenders:
        """Refine candidates a little, from (C, 4, 4) ``start``; they were proposed as ``coarse``.

        The best few are aligned by GICP, but none that scores far less than what is in the running
        already.
        """
        judge, voxel_size_m = self.judge, self.judge.voxel_size_m
        fine = _refine_roughly(start, self.source, self.target, self.samples)
        rough = judge.score(fine.T_target_source, ROUGH)
        rows = judge.distinct(fine.T_target_source, rough)[:SPARSE_FINALISTS]
        rows = rows[rough.total[rows] >= HOPELESS * max(rough.total.max(), rival_total)]
        source, target = side_by_side(lambda scan: scan.thinned, (self.source, self.target))
        fine = refine_sparse(
            fine[rows], source, target, voxel_size_m, lambda T: self.may_count(judge.score(T))
        )
        score = judge.score(fine.T_target_source)
        return Contenders(coarse[rows], fine, fine.T_target_source, score)

    def slid(self, aligned: Contenders, rival_total: float, is_hopeless: bool) -> Contenders:
        """As they are: scan lines hold no place along a surface."""
        return aligned

    def finish(self, best: Refinement, T_target_source: FloatArray, total: float) -> Refinement:
        """The final fine alignment of one prepared pose; nothing slid it, and its score stays."""
        thinned = self.source.thinned, self.target.thinned
        return lay_on_planes(
            finish_sparse(best, *thinned, self.judge.voxel_size_m),
            self.source.fine_tree.centroids_m,
            self.target.fine_tree.centroids_m,
            self.source.viewpoint_m,
            self.target.viewpoint_m,
            self.judge.voxel_size_m,
        )


def polish(T_target_source: FloatArray, source: Scan, target: Scan) -> Refinement:
    """The final fine alignment of (C, 4, 4) poses, with every voxel of the two finer levels."""
    levels = [
        (source.skipmap, target.skipmap),
        (source.fine_skipmap, target.fine_skipmap),
    ]
    return refine(T_target_source, levels)


def _lattice_doubt(source: Scan, target: Scan) -> float:
    edges = [one.lattice_step_m / one.fine_skipmap.voxel_size_m for one in (source, target)]
    return 1 + LATTICE_DOUBT * max(edges) ** 3


def _refine_roughly(start: FloatArray, source: Scan, target: Scan, samples: int) -> Refinement:
    levels = [(source.coarse, target.coarse), (source.skipmap, target.skipmap)]
    return refine(start, levels, samples=samples, max_steps=MAX_STEPS)
