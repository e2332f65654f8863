"""Compile ahead of time, for images and installations: ``skipnet compile``."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from skipnet.commands.errors import EXIT_BAD_INPUT, EXIT_OK
from skipnet.geometry import invert
from skipnet.progress import counted, in_words, shown
from skipnet.types import FloatArray

if TYPE_CHECKING:
    from skipnet.registration.result import Registration

USAGE = """skipnet compile: makes the machine code that registering two scans needs, and keeps it.

It takes half a minute where nothing is kept yet; the first registration then starts at once.
NUMBA_CACHE_DIR names the folder; otherwise it is the package's own or the user's cache."""
ROOM_M = (-4.0, -3.0, -1.5), (5.0, 3.5, 1.2)
"""Two corners of what the simulated scanner stands in."""
WIDE = 1 << 12
"""Voxels along every axis: so far that blocks of a table share places."""
HISTOGRAM = 33
"""Figures of a descriptor: of scans as small as those here few are compared one by one."""
_DPI = 30
DENSE_BEAMS = 20_000
RINGS, RING_BEAMS = 16, 1000


def main(arguments: Sequence[str] | None = None) -> int:
    """The command: its exit code."""
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given in (["--help"], ["-h"]):
        print(USAGE)
        return EXIT_OK
    if given:
        print(f"compile: takes no {given[0]!r}", file=sys.stderr)
        return EXIT_BAD_INPUT
    start_s = time.monotonic()
    with shown("compile"):
        compile_usual()
    print(f"compiled what registering two scans needs: {in_words(time.monotonic() - start_s)}")
    return EXIT_OK


def compile_usual() -> None:
    """Register pairs of several kinds, so that what they call is compiled and kept.

    What is compiled hangs on the kind of scan and of number, not on how many points there are.
    """
    from skipnet.features.nearest import nearest_of_many
    from skipnet.registration.judging.states import facing
    from skipnet.registration.pipeline import register
    from skipnet.results.skipmaps import skipmaps_of
    from skipnet.skipmap.cell_table import CellTable
    from skipnet.viz.pictures import draw_before_after

    wide = CellTable(np.array([[0, 0, 0], [WIDE, WIDE, WIDE]]), 1.0, np.zeros(3))
    for precision in (np.float64, np.float32):  # as few scans are
        wide.find_moved(np.eye(4)[None], np.zeros((1, 3), precision))
    facing(np.stack([np.eye(4)] * 2), *np.ones((2, 1, 3), dtype=np.float32))
    nearest_of_many(*np.eye(2 * HISTOGRAM, HISTOGRAM, dtype=np.float32).reshape(2, HISTOGRAM, -1))
    pairs = list(_pairs())
    for source_m, target_m, options in counted("pairs", pairs, len(pairs)):
        result = register(source_m, target_m, **options)
        _doubt(result)
        skipmaps_of(result)
        draw_before_after(source_m, target_m, result.T_target_source).image(dpi=_DPI)


def _doubt(result: Registration) -> None:
    """Ask what is asked where two scans may show two things that are alike, or share little."""
    from skipnet.registration.generators import propose
    from skipnet.registration.judging.forks import find_forks
    from skipnet.registration.judging.furnishing import compare_things
    from skipnet.registration.judging.pieces import compare_pieces
    from skipnet.registration.options import Generator, RegistrationConfig

    assert result.given is not None and result.given.described is not None
    source, target = result.given.described
    T_own = invert(target.T_given_own) @ result.T_target_source @ source.T_given_own
    compare_things(T_own, source, target)
    compare_pieces(T_own, source, target)
    find_forks(T_own, source, target)
    propose(Generator.deep, source, target, RegistrationConfig())


def _pairs() -> Iterator[tuple[FloatArray, FloatArray, dict[str, Any]]]:
    """Easy, sparse and hopeless ones in both precisions; the sensor's place and a voxel given."""
    rng = np.random.default_rng(0)
    dense = rng.normal(size=(DENSE_BEAMS, 3))
    azimuths_rad, slopes = np.linspace(-np.pi, np.pi, RING_BEAMS), np.linspace(-0.3, 0.3, RINGS)
    x, y, z = np.broadcast_arrays(np.cos(azimuths_rad), np.sin(azimuths_rad), slopes[:, None])
    rings = np.stack([x, y, z], axis=-1).reshape(-1, 3)
    room, other = (rng.uniform(*ROOM_M, (10, 3)) for _ in range(2))
    precisions: tuple[Any, ...] = (np.float64, np.float32)
    for precision in precisions:
        source_m, target_m, other_m, *sparse = (
            _scan(corners_m, beams, x_m).astype(precision)
            for corners_m, beams, x_m in (
                (room, dense, -1.0), (room, dense, 0.5), (other, dense, 0.0),
                (room, rings, -1.0), (room, rings, 0.5),
            )
        )  # fmt: skip
        yield source_m, target_m, {}
        yield source_m, target_m, {"source_viewpoint": (0.0, 0.0, 0.0), "voxel_size_m": 0.1}
        yield source_m, target_m[::4], {"target_viewpoint": None}
        yield source_m, other_m, {}
        yield sparse[0], sparse[1], {}


def _scan(corners_m: FloatArray, beams: FloatArray, x_m: float) -> FloatArray:
    """What beams (N, 3) from (x_m, 0, 0) meet in a room with boxes at (K, 3), in its own frame."""
    sensor_m = np.array([x_m, 0.0, 0.0])
    with np.errstate(divide="ignore"):
        walls = (np.array(ROOM_M)[:, None] - sensor_m) / beams
        low, high = ((corners_m[:, None] + size_m - sensor_m) / beams for size_m in (0.0, 0.8))
    nearest = walls.max(axis=0).min(axis=1)
    enters, leaves = np.minimum(low, high).max(axis=2), np.maximum(low, high).min(axis=2)
    hits = np.where((enters < leaves) & (enters > 0.3), enters, np.inf)
    return beams * np.minimum(nearest, hits.min(axis=0))[:, None]
