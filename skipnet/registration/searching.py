"""The search on one screen: propose, verify, refine, until the verdict is clear."""

from __future__ import annotations

from itertools import zip_longest

import numpy as np

from skipnet.geometry import invert
from skipnet.parallel.threads import side_by_side
from skipnet.registration.aligners import Aligner
from skipnet.registration.answer import Answer
from skipnet.registration.contenders import Contenders
from skipnet.registration.findings import BLIND_BOTH, MAX_BLIND
from skipnet.registration.generators import propose
from skipnet.registration.hypotheses.repeats import from_repeats
from skipnet.registration.judging.judge import Judge
from skipnet.registration.judging.riding import silence_riders
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.registration.settling import (
    aligner_of,
    conclude,
    enter,
    realigned,
    rivalled,
    settle,
    weigh,
)
from skipnet.registration.stopwatch import Stopwatch
from skipnet.registration.verdict import MIN_CONFIDENCE, may_be_registered
from skipnet.scans.scan import Scan
from skipnet.types import FloatArray, Status

CLEAR_CONFIDENCE = 0.95
"""With this much confidence in a registered pose no further generator is asked."""


LAST_RESORTS = (Generator.deep, Generator.fpfh)
"""Asked only while nothing is registered."""


def search(
    source: Scan,
    target: Scan,
    config: RegistrationConfig,
    clock: Stopwatch,
    guesses: FloatArray | None = None,
    only_registered: bool = False,
) -> Answer:
    """Propose, verify and refine, one generator after the other until the verdict is clear.

    (C, 4, 4) guesses stand among what the first generator proposes. Where a registered pose alone
    is of use, no more is found out of the others once none can be registered.
    """
    with clock("classes"):
        evidence_s, evidence_t = side_by_side(
            lambda scan: scan.valued_evidence(config.feature_weight), (source, target)
        )
    if min(len(source.skipmap), len(target.skipmap)) == 0:
        return Answer.none()
    judge = Judge(evidence_s, evidence_t, config.final_samples, config.violation_weight)
    judge = silence_riders(judge, invert(target.T_given_own) @ source.T_given_own)
    aligner = aligner_of(source, target, judge, config.refine_samples)
    running, answer = Contenders.none(), None
    for generator, coming in zip_longest(config.generators, config.generators[1:]):
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
    return _with_repeats(answer, running, aligner, clock)


def _settled(running: Contenders, aligner: Aligner, coming: Generator | None) -> Answer | None:
    """The answer, but for one with which the coming generator is asked in any case: all are weighed
    again then, and None will do."""
    if coming is None:
        return settle(running, aligner)
    blind = aligner.judge.blind
    if coming not in LAST_RESORTS and blind > MAX_BLIND:
        return None
    weighed = weigh(running, aligner)
    may_do = weighed.may_be_registered(blind, needed(coming))
    return conclude(weighed, aligner) if may_do else None


def _with_repeats(
    answer: Answer,
    running: Contenders,
    aligner: Aligner,
    clock: Stopwatch,
) -> Answer:
    """The answer after a look at what repeats: generators propose what agrees most, and where a
    pattern brings both sensors to the same place of it, the true pose may not be among that.

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
    if len(fresh) == 0:
        return answer
    with clock("fine alignment"):
        return rivalled(answer, fresh, running, aligner)


def _joined(guesses: FloatArray | None, proposed: FloatArray) -> FloatArray:
    """(C, 4, 4) guesses before what a generator proposes."""
    return proposed if guesses is None else np.concatenate([guesses, proposed])


def is_enough(answer: Answer, coming: Generator) -> bool:
    """Whether the coming generator need not be asked; the last resorts take longer than the others.

    Where a viewpoint is unknown nothing contradicts a wrong pose but a better one: all others are
    asked for rivals.
    """
    is_last = coming in LAST_RESORTS
    if not is_last and answer.findings is not None and answer.findings.is_blind:
        return False
    verdict = answer.verdict
    return verdict.status is Status.REGISTERED and verdict.confidence >= needed(coming)


def needed(coming: Generator) -> float:
    """The confidence in a registered pose with which the coming generator need not be asked."""
    return MIN_CONFIDENCE if coming in LAST_RESORTS else CLEAR_CONFIDENCE
