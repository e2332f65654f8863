"""The search on one screen: propose, verify, refine, until the verdict is clear."""

from __future__ import annotations

from dataclasses import replace
from itertools import zip_longest

import numpy as np

from skipnet.geometry import invert
from skipnet.parallel.threads import side_by_side
from skipnet.registration.aligners import Aligner
from skipnet.registration.answer import Answer
from skipnet.registration.contenders import Contenders
from skipnet.registration.findings import BLIND_BOTH, MAX_BLIND
from skipnet.registration.generators import asked, propose
from skipnet.registration.hypotheses.repeats import VOTERS, from_repeats
from skipnet.registration.judging.forks import find_forks, surfaces_part
from skipnet.registration.judging.furnishing import compare_things
from skipnet.registration.judging.judge import LAST_ROUND, ROUNDS, Judge
from skipnet.registration.judging.likeness import typical_offset
from skipnet.registration.judging.pieces import compare_pieces
from skipnet.registration.judging.riding import silence_riders
from skipnet.registration.judging.score import CHANCE_SCORE
from skipnet.registration.judging.sides import stands_before
from skipnet.registration.judging.sliding import GAIN_SAMPLES, ROUGH_SAMPLES
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.settling import (
    aligner_of,
    conclude,
    enter,
    realigned,
    rivalled,
    settle,
    still_rivals,
)
from skipnet.registration.stopwatch import Stopwatch
from skipnet.registration.verdict import MIN_CONFIDENCE, decide, may_be_registered
from skipnet.registration.weighing import weigh
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status

CLEAR_CONFIDENCE = 0.95
"""With this much confidence in a registered pose no further generator is asked."""
EXACT = 0.93
"""Surfaces part where the scans are exact: where so much of what agrees does so closely. What depth
cameras fuse (0.67 to 0.79) has second layers, and so has what drifts by more than a voxel (0.91);
other specimens have 0.95 and more."""
FEW_CONTRADICT = 0.001
"""Where less contradicts a pose, by its worth, hardly any small thing can be gone: of 42 simulated
rooms that are alike but for these 0.0026 and more does, of 100 others 0.0013 (three of these were
looked at when the study had registered them, see docs/judge.md)."""

ASKED_ABOUT = {*dict((*ROUNDS, LAST_ROUND)), GAIN_SAMPLES, ROUGH_SAMPLES, VOTERS}
"""So many voxels are asked about, besides as many as the options say."""
LAST_RESORTS = (Generator.deep, Generator.fpfh)
"""Asked only while nothing is registered."""


def search(
    source: Scan,
    target: Scan,
    config: RegistrationConfig,
    clock: Stopwatch,
    guesses: FloatArray | None = None,
    rivals: FloatArray | None = None,
    only_registered: bool = False,
) -> Answer:
    """Propose, verify and refine, one generator after the other until the verdict is clear.

    (C, 4, 4) guesses stand among what the first generator proposes; a registered pose has to stand
    against (K, 4, 4) known rivals, which a look in larger voxels found, so that normals are firm,
    few points as the voxels have. Where a registered pose alone is of use, no more is found out of
    the others once none can be registered.
    """
    with clock("classes"):
        evidence_s, evidence_t = side_by_side(
            lambda scan: scan.valued_evidence(config.feature_weight).gathered(
                ASKED_ABOUT | {config.final_samples}
            ),
            (source, target),
        )
    if min(len(source.skipmap), len(target.skipmap)) == 0:
        return Answer.none()
    judge = Judge(evidence_s, evidence_t, config.final_samples, config.violation_weight)
    judge = silence_riders(judge, invert(target.T_given_own) @ source.T_given_own)
    known = np.zeros((0, 4, 4)) if rivals is None else rivals
    aligner = aligner_of(source, target, judge, config.refine_samples, by_normals=len(known) > 0)
    running, answer = Contenders.none(), None
    generators = asked(config, source, target)
    for generator, coming in zip_longest(generators, generators[1:]):
        with clock("hypotheses"):
            hypotheses = propose(generator, source, target, config)
        with clock("verification"):
            fresh = judge.shortlist(_joined(guesses, hypotheses.T_target_source))
            guesses = None
        with clock("fine alignment"):
            before, running, answer = len(running), enter(running, fresh, aligner), None
            if may_be_registered(running.score, judge.blind):
                running = realigned(running, aligner) if before else running
                answer = _settled(running, aligner, coming)
        if answer is not None and coming is not None and is_enough(answer, coming):
            break
    if answer is None and only_registered:
        return Answer.none()
    if answer is None:  # no pose can be registered: which is the best one, and why not?
        with clock("fine alignment"):
            return settle(running, aligner, is_refused=True)
    answer = _with_rivals(answer, known, running, aligner, clock)
    with clock("verification"):
        return _of_one_thing(_without_forked(answer, aligner), source, target)


def _settled(running: Contenders, aligner: Aligner, coming: Generator | None) -> Answer | None:
    """The answer, but for one with which the coming generator is asked in any case: all are weighed
    again then, and None will do. What is a mirror image shows in the answer alone: of blind scans,
    of which it often is one, it is asked before the last resort brings rivals."""
    if coming is None:
        return settle(running, aligner)
    blind = aligner.judge.blind
    if coming not in LAST_RESORTS and blind > MAX_BLIND:
        return None
    may_do = coming is Generator.deep and blind > BLIND_BOTH
    weighed = weigh(running, aligner, one_will_do=not may_do)
    may_do = may_do or weighed.may_be_registered(blind, needed(coming))
    return conclude(weighed, aligner) if may_do else None


def _with_rivals(
    answer: Answer,
    known: FloatArray,
    running: Contenders,
    aligner: Aligner,
    clock: Stopwatch,
) -> Answer:
    """The answer after a look at (K, 4, 4) known rivals and at what repeats: generators propose
    what agrees most, and where a pattern brings both sensors to the same place of it, the true pose
    may not be among that.

    Scans that are both blind are not asked: nothing would contradict such rivals, and smooth shapes
    have many.
    """
    found, registered = answer.findings, answer.verdict.status is Status.REGISTERED
    if not registered or found is None or found.blind > BLIND_BOTH:
        return answer
    best, judge = answer.T_target_source, aligner.judge
    with clock("hypotheses"):
        hypotheses = from_repeats(best, judge.source, judge.target)
    with clock("verification"):
        fresh = judge.apart(best, judge.shortlist(hypotheses.T_target_source))
    if len(known):
        with clock("fine alignment"):
            fresh = np.concatenate([still_rivals(best, known, aligner), fresh])
    if len(fresh) == 0:
        return answer
    with clock("fine alignment"):
        return rivalled(answer, fresh, running, aligner)


def _without_forked(answer: Answer, aligner: Aligner) -> Answer:
    """An answer in doubt between poses, after these were asked whether surfaces part under them:
    where that is so under all its rivals that explain as much, they are none."""
    found, T, judge = answer.findings, answer.T_target_source, aligner.judge
    if found is None or not found.is_blind or aligner.is_sparse or found.closeness < EXACT:
        return answer
    if answer.verdict.status is not Status.AMBIGUOUS or len(found.alternatives) == 0:
        return answer

    def part(T_rival: FloatArray) -> bool:
        return surfaces_part(T_rival, aligner.source, aligner.target)

    if part(T) or not all(part(rival) for rival in found.alternatives):
        return answer
    others = answer.finalists[judge.others(T, answer.finalists)]
    left = np.stack([T, *(other for other in others if not part(other))])
    total = judge.closer(left, judge.score(left)).total
    closest = max(total[1:].max(initial=0.0), CHANCE_SCORE)
    found = replace(
        found,
        margin=float(max(1 - closest / max(total[0], CHANCE_SCORE), 0.0)),
        alternatives=np.zeros((0, 4, 4)),
        odd_share=aligner.odd_share(T),
        is_mirrored=aligner.is_mirrored(T),
    )
    return replace(answer, verdict=decide(found), findings=found)


def _of_one_thing(answer: Answer, source: Scan, target: Scan) -> Answer:
    """A registered answer after a look at whether the scans show one thing, or two that are alike:
    at small things that are there in one alone, and, where no sensor's place is known, at surfaces
    that part and at what stands before the side that is shown."""
    found, T = answer.findings, answer.T_target_source
    if answer.verdict.status is not Status.REGISTERED or found is None:
        return answer
    found = replace(found, before=stands_before(T, source, target))
    if found.is_blind and not found.is_sparse:
        found = replace(found, typical_offset=typical_offset(T, source, target))
    if found.blind > BLIND_BOTH and found.closeness >= EXACT:
        found = replace(found, forks_m=find_forks(T, source, target))
    elif not found.is_blind:
        if found.contradiction > FEW_CONTRADICT:
            found = replace(found, furnishing=compare_things(T, source, target))
        if found.closeness >= EXACT and not found.furnishing.is_another:
            found = replace(found, pieces=compare_pieces(T, source, target))
    return replace(answer, verdict=decide(found), findings=found)


def _joined(guesses: FloatArray | None, proposed: FloatArray) -> FloatArray:
    """(C, 4, 4) guesses before what a generator proposes."""
    return proposed if guesses is None else np.concatenate([guesses, proposed])


def is_enough(answer: Answer, coming: Generator) -> bool:
    """Whether the coming generator need not be asked; the last resorts take longer than the others.

    Where a viewpoint is unknown nothing contradicts a wrong pose but a better one: all others are
    asked for rivals.
    """
    found = answer.findings
    if coming is Generator.deep and found is not None and found.is_mirrored:
        return True  # what explains a mirror image is no answer, and rivals would hide the reason
    is_last = coming in LAST_RESORTS
    if not is_last and found is not None and found.is_blind:
        return False
    verdict = answer.verdict
    return verdict.status is Status.REGISTERED and verdict.confidence >= needed(coming)


def needed(coming: Generator) -> float:
    """The confidence in a registered pose with which the coming generator need not be asked."""
    return MIN_CONFIDENCE if coming in LAST_RESORTS else CLEAR_CONFIDENCE
