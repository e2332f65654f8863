"""Scans as dots from above and from the side, painted with NumPy and Pillow.

A pair's picture takes a fifteenth of Matplotlib's time so, of which half goes by before it draws.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from skipnet.compiled import compiled
from skipnet.types import FloatArray, IntArray

if TYPE_CHECKING:
    from PIL import Image

_DOT_PT, _OPACITY = 1.4, 0.7
_TITLE_PT, _TEXT_PT, _LEGEND_DOT_PT = 12.0, 10.0, 8.0
_TITLE_IN, _BELOW_IN, _LEGEND_IN, _PAD_IN, _TICK_IN = 0.34, 0.58, 0.4, 0.09, 0.05
_GRID = "#e6e6e6"
_MOST_TICKS = 8
"""Along a side; fewer where their numbers would meet."""


@dataclass(frozen=True)
class DotView:
    """One view of clouds in a common frame."""

    title: str
    names: tuple[str, str]
    """Of the coordinates that run to the right and up."""
    low_m: FloatArray
    """(2,) where the axes begin; stray points beyond are not shown."""
    high_m: FloatArray
    """(2,)."""
    is_upside_down: bool
    """The second coordinate runs down."""
    clouds_m: Sequence[FloatArray]
    """(N, 2) each."""


@dataclass(frozen=True)
class DotPicture:
    """Views in rows and columns, those of a row alike in size, and which colour is what."""

    rows: Sequence[Sequence[DotView]]
    colours: dict[str, str]
    """Name to #RRGGBB, as many as there are clouds in each view."""
    width_in: float
    """Of a view's axes."""

    def retitled(self, old: str, new: str) -> DotPicture:
        """With other words in its titles."""
        rows = [[replace(v, title=v.title.replace(old, new)) for v in row] for row in self.rows]
        return replace(self, rows=rows)

    def image(self, dpi: float) -> Image.Image:
        """Paint it with so many pixels per inch."""
        return _Painter(self, dpi).painted()


class _Box(NamedTuple):
    """Where a view's axes lie, in pixels."""

    left: int
    top: int
    wide: int
    tall: int


class _Painter:
    """Paints one picture."""

    def __init__(self, picture: DotPicture, dpi: float) -> None:
        from PIL import Image, ImageDraw, ImageFont

        self.picture, self.dpi = picture, dpi
        self.title_font = ImageFont.load_default(_TITLE_PT * dpi / 72)
        self.text = _TEXT_PT * dpi / 72  # in pixels, as all below
        self.font = ImageFont.load_default(self.text)
        self.pad, self.tick = round(_PAD_IN * dpi), round(_TICK_IN * dpi)
        wide = round(picture.width_in * dpi)
        talls = [max(round(wide * _slope(row[0])), 1) for row in picture.rows]
        sides = zip(picture.rows, talls, strict=True)
        texts = [text for row, tall in sides for text in self._marks(row[0], 1, tall).values()]
        widest = max(map(self.font.getlength, texts), default=0.0)
        left = round(widest + 2 * self.text) + 2 * self.pad + self.tick
        above, below = round(_TITLE_IN * dpi), round(_BELOW_IN * dpi)
        self.boxes, top = [], 0
        for row, tall in zip(picture.rows, talls, strict=True):
            for column in range(len(row)):
                lies = left + column * (left + wide + self.pad)
                self.boxes.append(_Box(lies, top + above, wide, tall))
            top += above + tall + below
        size = len(picture.rows[0]) * (left + wide + self.pad), top + round(_LEGEND_IN * dpi)
        self.image = Image.new("RGB", size, "white")
        self.draw = ImageDraw.Draw(self.image)

    def painted(self) -> Image.Image:
        """All of it."""
        views = [view for row in self.picture.rows for view in row]
        for view, box in zip(views, self.boxes, strict=True):
            self._paint_view(view, box)
        self._paint_legend()
        return self.image

    def _paint_view(self, view: DotView, box: _Box) -> None:
        from PIL import Image

        marks = self._marks(view, 0, box.wide), self._marks(view, 1, box.tall)
        canvas = np.full((box.tall, box.wide, 3), 255, np.float32)
        canvas[:, list(marks[0])] = canvas[list(marks[1])] = _rgb(_GRID)
        places = [_places(view, cloud_m, box) for cloud_m in view.clouds_m]
        colours = [_rgb(colour) for colour in self.picture.colours.values()]
        owners = np.repeat(np.arange(len(places)), [len(cloud) for cloud in places])
        order = np.random.default_rng(0).permutation(len(owners))  # so that none hides another
        _stamp(canvas, np.concatenate(places)[order], np.array(colours)[owners[order]], self._dot())
        self.image.paste(Image.fromarray(np.rint(canvas).astype(np.uint8)), (box.left, box.top))
        self._paint_axes(view, box, marks)

    def _dot(self) -> FloatArray:
        """(K, K) how much of each pixel a dot covers."""
        radius = _DOT_PT * self.dpi / 144
        reach = math.ceil(radius - 0.5)
        steps = np.arange(-reach, reach + 1)
        away = np.hypot(steps[:, None], steps)
        return (_OPACITY * np.clip(radius + 0.5 - away, 0, 1)).astype(np.float32)

    def _paint_axes(self, view: DotView, box: _Box, marks: Sequence[dict[int, str]]) -> None:
        left, top, wide, tall = box
        right, bottom = left + wide, top + tall
        self.draw.rectangle((left - 1, top - 1, right, bottom), outline="black")
        for x, text in marks[0].items():
            self.draw.line((left + x, bottom, left + x, bottom + self.tick), "black")
            self._write((left + x, bottom + self.tick + self.pad // 2), text, "mt")
        for y, text in marks[1].items():
            self.draw.line((left - self.tick, top + y, left, top + y), "black")
            self._write((left - self.tick - self.pad // 2, top + y), text, "rm")
        middle, font = left + wide / 2, self.title_font
        self.draw.text((middle, top - self.pad), view.title, "black", font, anchor="mb")
        self._write((middle, bottom + self.tick + self.pad + self.text), view.names[0], "mt")
        self._write_upwards(view.names[1], left, top + tall // 2)

    def _write(self, place: tuple[float, float], text: str, anchor: str) -> None:
        self.draw.text(place, text, "black", self.font, anchor=anchor)

    def _write_upwards(self, text: str, left: int, middle: int) -> None:
        """Beside the numbers at a view's left."""
        from PIL import Image, ImageDraw

        size = round(self.font.getlength(text)) + 2, round(1.4 * self.text)
        line = Image.new("RGB", size, "white")
        place = size[0] / 2, size[1] / 2
        ImageDraw.Draw(line).text(place, text, "black", self.font, anchor="mm")
        column = self.boxes[0].left
        self.image.paste(line.rotate(90, expand=True), (left - column, middle - size[0] // 2))

    def _paint_legend(self) -> None:
        dot, gap = _LEGEND_DOT_PT * self.dpi / 72, 2 * self.text
        names = self.picture.colours
        widths = [dot + self.pad + self.font.getlength(name) for name in names]
        x = (self.image.width - sum(widths) - gap * (len(names) - 1)) / 2
        y = self.image.height - _LEGEND_IN * self.dpi / 2
        for (name, colour), width in zip(names.items(), widths, strict=True):
            self.draw.ellipse((x, y - dot / 2, x + dot, y + dot / 2), fill=colour)
            self._write((x + dot + self.pad, y), name, "lm")
            x += width + gap

    def _marks(self, view: DotView, axis: int, pixels: int) -> dict[int, str]:
        """Pixels along a side at which round numbers stand, and these."""
        low_m, high_m = float(view.low_m[axis]), float(view.high_m[axis])
        for step_m in _round_steps((high_m - low_m) / _MOST_TICKS):
            values_m = step_m * np.arange(math.ceil(low_m / step_m), high_m // step_m + 1)
            digits = max(0, -math.floor(math.log10(step_m) + 1e-9))
            texts = [f"{value_m + 0.0:.{digits}f}" for value_m in values_m]
            takes = self.text if axis else max(map(self.font.getlength, texts), default=0)
            if 1.3 * takes < step_m / (high_m - low_m) * pixels or len(texts) < 3:
                break
        share = (values_m - low_m) / (high_m - low_m)
        if axis and not view.is_upside_down:
            share = 1 - share
        places = np.clip(np.rint(share * pixels - 0.5), 0, pixels - 1).astype(int)
        return dict(zip(places.tolist(), texts, strict=True))


def _round_steps(least_m: float) -> Iterator[float]:
    """1, 2 and 5 times powers of ten, from the first that is not below."""
    power = math.floor(math.log10(least_m))
    steps = (digit * 10.0**exponent for exponent in count(power) for digit in (1, 2, 5))
    return (step_m for step_m in steps if step_m >= least_m)


def _slope(view: DotView) -> float:
    wide_m, tall_m = view.high_m - view.low_m
    return float(tall_m / wide_m)


def _places(view: DotView, cloud_m: FloatArray, box: _Box) -> IntArray:
    """(N, 2) columns and rows of the pixels in which dots have their middles."""
    share = (cloud_m - view.low_m) / (view.high_m - view.low_m)
    if not view.is_upside_down:
        share[:, 1] = 1 - share[:, 1]
    share = share[((share >= 0) & (share < 1)).all(axis=1)]
    return (share * [box.wide, box.tall]).astype(np.int64)


def _rgb(colour: str) -> FloatArray:
    return np.array([int(colour[k : k + 2], 16) for k in (1, 3, 5)], np.float32)


@compiled
def _stamp(canvas: FloatArray, places: IntArray, colours: FloatArray, dot: FloatArray) -> None:
    """Paint (N, 2) dots of (N, 3) colours one over the other."""
    reach = len(dot) // 2
    for number in range(len(places)):
        column, row = places[number, 0] - reach, places[number, 1] - reach
        for down in range(max(0, -row), min(len(dot), canvas.shape[0] - row)):
            for along in range(max(0, -column), min(len(dot), canvas.shape[1] - column)):
                for shade in range(3):
                    old = canvas[row + down, column + along, shade]
                    change = (colours[number, shade] - old) * dot[down, along]
                    canvas[row + down, column + along, shade] = old + change
