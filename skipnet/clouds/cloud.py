"""The one noun for points with what else is known of them: readers return it, writers take it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from typing import Any

import numpy as np
import numpy.typing as npt

from skipnet.checks import METRES_PER_UNIT, check_known
from skipnet.geometry import transform_points
from skipnet.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Cloud:
    """Points, and per point whatever its file holds."""

    points_m: FloatArray
    """(N, 3) float64, in the frame of the file, large offsets included: doubles keep a surveyed
    coordinate to a nanometre."""
    colour: IntArray | None = None
    """(N, 3) uint8, or uint16 where the file has finer ones: red, green, blue."""
    intensity: FloatArray | IntArray | None = None
    """(N,) numbers, of the kind and range that the file has."""
    normals: FloatArray | None = None
    """(N, 3) directions."""
    columns: Mapping[str, np.ndarray] = field(default_factory=dict)
    """(N,) arrays by the names they have in the file: labels, times, returns, ..."""
    offset_m: FloatArray = field(default_factory=lambda: np.zeros(3))
    """(3,) a place near the points, from which formats of whole numbers (LAS) count; the points
    hold it already."""
    viewpoint_m: FloatArray | None = None
    """(3,) the sensor's position in the frame of the points, if the file says so."""
    name: str = ""
    """What to call it in messages: the file's path, perhaps with the scan's name in it."""
    unit: str = "m"
    """Unit of the file's coordinates, a key of ``skipnet.checks.METRES_PER_UNIT``; the points are
    in metres all the same."""
    crs: str = ""
    """The coordinate reference system as the file has it (WKT), or nothing."""
    notes: tuple[str, ...] = ()
    """What a reader of the file had to decide: columns taken, rows dropped, a mesh sampled."""

    def __post_init__(self) -> None:
        what = self.name or "cloud"
        points_m = numbers(self.points_m, (3,), what)
        if points_m.dtype.kind == "b":
            raise ValueError(f"{what}: got bool: expected numbers of shape (N, 3)")
        if points_m.dtype != np.float32:  # which is as good as it was
            points_m = points_m.astype(np.float64, copy=False)
        facts: dict[str, object] = {"points_m": points_m}
        for name, shape in (("colour", (3,)), ("intensity", ()), ("normals", (3,))):
            if getattr(self, name) is not None:
                values = numbers(getattr(self, name), shape, f"{what}: {name}", len(points_m))
                facts[name] = _whole_colour(values, what) if name == "colour" else values
        facts["columns"] = {
            name: numbers(values, (), f"{what}: column {name}", len(points_m))
            for name, values in self.columns.items()
        }
        check_known("unit", self.unit, tuple(METRES_PER_UNIT))
        for name, value in facts.items():
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.points_m)

    def __array__(self, dtype: npt.DTypeLike | None = None, copy: bool | None = None) -> np.ndarray:
        """The points alone, for functions that take arrays."""
        return np.array(self.points_m, dtype, copy=True if copy else None)

    def __str__(self) -> str:
        held = f" with {', '.join(self.holds)}" if self.holds else ""
        return f"{self.name or 'a cloud'}: {len(self):,} points{held}"

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self}>"

    def __getitem__(self, rows: IntArray | BoolArray | slice) -> Cloud:
        """The same cloud with some of its points."""
        return replace(
            self,
            points_m=self.points_m[rows],
            colour=None if self.colour is None else self.colour[rows],
            intensity=None if self.intensity is None else self.intensity[rows],
            normals=None if self.normals is None else self.normals[rows],
            columns={name: values[rows] for name, values in self.columns.items()},
        )

    def moved(self, T_new_old: FloatArray) -> Cloud:
        """The cloud in another frame: points, normals and viewpoint moved by a (4, 4) transform."""
        T_new_old = np.asarray(T_new_old)
        if T_new_old.shape != (4, 4) or T_new_old.dtype.kind not in "iuf":
            raise ValueError(
                f"T_new_old: got {T_new_old.dtype} {T_new_old.shape}: expected a pose (4, 4)"
            )
        rotation = T_new_old[:3, :3]
        viewpoint_m = self.viewpoint_m
        if viewpoint_m is not None:
            viewpoint_m = transform_points(T_new_old, np.array([viewpoint_m], np.float64))[0]
        return replace(
            self,
            points_m=transform_points(T_new_old, self.points_m),
            normals=None if self.normals is None else self.normals @ rotation.T,
            viewpoint_m=viewpoint_m,
        )

    def finite(self) -> Cloud:
        """Without the rows of NaN or infinity, which stand for beams that met nothing; a note says
        how many there were."""
        usable = np.asarray(np.isfinite(self.points_m).all(axis=1))
        dropped = len(self) - int(np.count_nonzero(usable))
        if not dropped:
            return self
        note = f"dropped {dropped:,} of {len(self):,} rows without a finite place"
        return replace(self[usable], notes=(*self.notes, note))

    @property
    def colour_8bit(self) -> IntArray | None:
        """(N, 3) uint8 colours, as they are drawn; writers of 8 bits into 16 may not scale them."""
        if self.colour is None or self.colour.dtype != np.uint16:
            return self.colour
        scaled = self.colour.max(initial=0) > 255
        return (self.colour >> 8 if scaled else self.colour).astype(np.uint8)

    @property
    def holds(self) -> list[str]:
        """Names of what there is beside the points."""
        named = {"colour": self.colour, "intensity": self.intensity, "normals": self.normals}
        return [*(name for name, values in named.items() if values is not None), *self.columns]


def numbers(values: object, shape: tuple[int, ...], what: str, count: int | None = None) -> Any:
    """An array of numbers, one row per point.

    Args:
        values: what was given.
        shape: of a row.
        what: to call it in the error.
        count: rows that it must have; None allows any number.

    Raises:
        ValueError: it is none.
    """
    try:
        array = np.asarray(values)
    except (TypeError, ValueError) as error:  # rows of different lengths
        raise ValueError(f"{what}: expected numbers: {error}") from error
    rows = "N" if count is None else f"{count}"
    fits = array.ndim == 1 + len(shape) and array.shape[1:] == shape
    if not fits or count not in (None, len(array)) or array.dtype.kind not in "iufb":
        expected = f"({rows},{''.join(f' {size}' for size in shape)})"
        raise ValueError(
            f"{what}: got {array.dtype} of shape {array.shape}: "
            f"expected numbers of shape {expected}"
        )
    return array


def _whole_colour(colour: np.ndarray, what: str) -> IntArray:
    """Colours as they are kept: whole numbers of 8 or 16 bits."""
    if colour.dtype in (np.uint8, np.uint16):
        return colour
    low, high = colour.min(initial=0), colour.max(initial=0)
    if colour.dtype.kind not in "iu" or low < 0 or high > 65535:
        raise ValueError(
            f"{what}: colours are {colour.dtype} from {low} to {high}: expected whole numbers, "
            "0 to 255 or 65535"
        )
    return colour.astype(np.uint8 if high <= 255 else np.uint16)


def as_cloud(points: npt.ArrayLike | Cloud, name: str = "") -> Cloud:
    """A Cloud of (N, 3) points; one that is a Cloud already comes back as it is.

    Raises:
        ValueError: neither.
    """
    if isinstance(points, Cloud):
        return points
    return Cloud(points, name=name)  # type: ignore[arg-type]


def concatenate(clouds: Sequence[Cloud]) -> Cloud:
    """One cloud of all, with what all of them have; facts on which they differ are left out."""
    if len(clouds) == 1:
        return clouds[0]
    first = clouds[0]
    shared = reduce(lambda known, cloud: known & set(cloud.columns), clouds, set(first.columns))
    same_place = all(_same(first.viewpoint_m, cloud.viewpoint_m) for cloud in clouds)
    notes = dict.fromkeys(note for cloud in clouds for note in cloud.notes)
    return replace(
        first,
        points_m=np.concatenate([cloud.points_m for cloud in clouds]),
        colour=_joined(of_one_depth([cloud.colour for cloud in clouds])),
        intensity=_joined([cloud.intensity for cloud in clouds]),
        normals=_joined([cloud.normals for cloud in clouds]),
        columns={
            name: np.concatenate([cloud.columns[name] for cloud in clouds])
            for name in first.columns
            if name in shared
        },
        viewpoint_m=first.viewpoint_m if same_place else None,
        crs=first.crs if all(cloud.crs == first.crs for cloud in clouds) else "",
        notes=tuple(notes),
    )


def of_one_depth(colours: Sequence[IntArray | None]) -> Sequence[IntArray | None]:
    """Colours of 8 bits as ones of 16 where they stand beside such."""
    if len({colour.dtype for colour in colours if colour is not None}) < 2:
        return colours
    return [
        colour * np.uint16(257) if colour is not None and colour.dtype == np.uint8 else colour
        for colour in colours
    ]


def _joined(arrays: Sequence[np.ndarray | None]) -> np.ndarray | None:
    present = [array for array in arrays if array is not None]
    return np.concatenate(present) if len(present) == len(arrays) else None


def _same(one: FloatArray | None, other: FloatArray | None) -> bool:
    return one is other or (one is not None and other is not None and np.array_equal(one, other))
