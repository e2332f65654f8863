"""Whether a pose that explains both scans shows one thing, or two that are alike."""

from __future__ import annotations

from skipnet.registration.findings import BLIND_BOTH, Findings
from skipnet.types import FloatArray

MAX_ODD_SHARE = 0.035
"""Right poses of simulated dense scans have at most 0.006, of real ones at most 0.024; other
specimens and mirror images of simulated arches 0.05 to 0.14."""
VERY_EXACT, MAX_ODD_IF_EXACT = 0.98, 0.015
"""Where so much of what agrees does so closely (``Findings.closeness``) even less may be odd: there
right simulated poses have at most 0.003, half-blind real ones 0.010, and other specimens whose
blocks stand but a little otherwise 0.024 and more."""
MAX_ODD_IF_BLIND = 0.01
"""... and where neither sensor's place is known 0.0067, of 53 right simulated poses, sensors'
places withheld; a wheel turned by some of its equal teeth has 0.012."""
MAX_TYPICAL_OFFSET = 3.0
"""Under 77 right simulated poses of scans of which one has no known place half of what agrees lies
off by 0.7 standard deviations at most, of real figures on a turntable by 1.3; two blocks of which
one is a thirtieth larger by 7.6."""
LOOSE_OFFSET, LOOSE_CLEAR = 1.4, 0.45
"""... and where both are blind, and what tells the pose from its rivals speaks for it less clearly,
no more than this, ..."""
LOOSER_OFFSET, LOOSER_CLOSENESS = 1.15, 0.92
"""... or this, if less agrees closely. Of 15 wrong poses of parts of arches all lie so loosely, of
some 290 right ones of arches, parts, figures and real figures none."""


def why_another(findings: Findings) -> str | None:
    """What says that the scans show two things that are alike, not the same one; None if nothing
    does."""
    most_odd = MAX_ODD_SHARE
    if findings.closeness >= VERY_EXACT:
        most_odd = MAX_ODD_IF_BLIND if findings.blind > BLIND_BOTH else MAX_ODD_IF_EXACT
    if findings.is_blind and findings.odd_share > most_odd:
        return (
            f"most of them exactly, but {findings.odd_share:.0%} lie off by far more: the "
            "scans may show two things that are alike, not the same one, or parts of it have moved"
        )
    if findings.typical_offset > MAX_TYPICAL_OFFSET:
        return (
            f"but half of them lie off by {findings.typical_offset:.2g} times as much as their "
            "points scatter: the scans may show two things of unlike size or shape, or one is "
            "bent; check the units and scales"
        )
    if _lies_loosely(findings):
        return (
            f"but half of them lie off by {findings.typical_offset:.2g} times as much as their "
            "points scatter, and little speaks against other places: one may be laid on a part of "
            "the other that is merely alike; take scans that share more, or give the places of the "
            "sensors"
        )
    if len(findings.forks_m):
        return (
            f"but at {_place(findings.forks_m)} the scans' surfaces part and go on "
            "differently: they may show two things that are alike, not the same one, or something "
            "was changed there; crop it, or give the places of the sensors"
        )
    if findings.before.is_another:
        return (
            f"but {findings.before.share:.1%} of one scan, such as at "
            f"{_place(findings.before.at_m)}, stands before what the other one shows there: they "
            "may show two things that are alike, or something was moved"
        )
    things, pieces = findings.furnishing, findings.pieces
    if things.is_another_in_bulk:
        return _scattered(things.gone_m, things.bulky_gone, things.bulky_again)
    if things.is_another:
        return _scattered(things.gone_m, len(things.gone_m), things.again)
    if pieces.is_most_gone:
        return (
            f"but {pieces.share:.0%} of what stands out in either scan, such as at "
            f"{_place(pieces.parts_m)}, is not in the other one: they may show two places that are "
            "alike, or nearly all was moved; add a scan, or crop what was moved"
        )
    if pieces.is_another:
        return _scattered(pieces.gone_m, len(pieces.gone_m), pieces.again)
    return None


def _lies_loosely(findings: Findings) -> bool:
    """Whether surfaces of blind scans may be laid on others that are merely alike."""
    offset, closeness = findings.typical_offset, findings.closeness
    is_loose = offset > LOOSE_OFFSET or (offset > LOOSER_OFFSET and closeness < LOOSER_CLOSENESS)
    return is_loose and findings.blind > BLIND_BOTH and findings.decisiveness < LOOSE_CLEAR


def _scattered(gone_m: FloatArray, gone: int, again: int) -> str:
    """Why what lies about says that two rooms are shown."""
    return (
        f"but {gone} small things stand in one scan alone, such as at {_place(gone_m)}, and only "
        f"{again} in both: they may show two rooms that are alike, or nearly all was moved; add a "
        "scan, or crop what was moved"
    )


def _place(places_m: FloatArray) -> str:
    """The first of (P, 3) places, in words."""
    place = ", ".join(f"{coordinate:.3g}" for coordinate in places_m[0])
    return f"({place}) in the target's frame"
