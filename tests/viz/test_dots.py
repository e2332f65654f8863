"""Dots lie where the numbers beside them say, in the colours of the legend."""

from __future__ import annotations

import numpy as np
import pytest

from skipnet.viz.dots import DotPicture, DotView, _Painter, _rgb, _stamp
from skipnet.viz.views import dots_by_columns


def picture_of(cloud_m, low_m, high_m, is_upside_down=False):
    low_m, high_m = np.array(low_m, float), np.array(high_m, float)
    cloud_m = np.array(cloud_m, float).reshape(-1, 2)
    view = DotView("here", ("x (m)", "y (m)"), low_m, high_m, is_upside_down, [cloud_m])
    return DotPicture([[view]], {"cloud": "#D55E00"}, 4.0)


def painted_box(picture, dpi=100):
    """The pixels within the axes, and the marks beside them."""
    painter = _Painter(picture, dpi)
    image = np.asarray(painter.painted()).astype(int)
    [box], view = painter.boxes, picture.rows[0][0]
    inside = image[box.top : box.top + box.tall, box.left : box.left + box.wide]
    marks = painter._marks(view, 0, box.wide), painter._marks(view, 1, box.tall)
    return inside, marks


@pytest.mark.parametrize("is_upside_down", [False, True])
@pytest.mark.parametrize("low_m", [(-1.0, -3.0), (431_200.0, 5_712_000.0)])
def test_a_dot_lies_where_the_marks_say(low_m, is_upside_down):
    low_m = np.array(low_m)
    for place_m in ([2.0, 1.0], [0.0, 4.0]):
        picture = picture_of(low_m + [1, 3] + place_m, low_m, low_m + 10, is_upside_down)
        inside, marks = painted_box(picture)
        rows, columns = np.nonzero(np.abs(inside - _rgb("#D55E00")).max(axis=2) < 130)
        found = columns.mean(), rows.mean()
        for axis in (0, 1):
            pixels, values_m = list(marks[axis]), [float(text) for text in marks[axis].values()]
            assert len(values_m) > 2
            metres_per_pixel = np.polyfit(pixels, values_m, 1)
            there_m = np.polyval(metres_per_pixel, found[axis])
            assert there_m == pytest.approx(low_m[axis] + [1, 3][axis] + place_m[axis], abs=0.05)


def test_numbers_of_any_length_do_not_meet():
    for low_m, size_m in ((0.0, 1e-6), (-3.0, 8.0), (5_712_345.0, 0.3), (-2e7, 4e7)):
        picture = picture_of([], [low_m, low_m], [low_m + size_m, low_m + size_m])
        painter = _Painter(picture, 130)
        view, [box] = picture.rows[0][0], painter.boxes
        marks = painter._marks(view, 0, box.wide)
        gaps = np.diff(sorted(marks))
        widest = max(painter.font.getlength(text) for text in marks.values())
        assert len(marks) < 3 or (gaps > widest).all()
        assert len(set(marks.values())) == len(marks)


def test_dots_paint_over_what_is_there_and_stop_at_the_edge():
    canvas = np.full((6, 5, 3), 255, np.float32)
    dot = np.array([[0.0, 0.5, 0.0], [0.5, 1.0, 0.5], [0.0, 0.5, 0.0]], np.float32)
    places = np.array([[0, 0], [4, 5], [4, 5]])
    colours = np.array([[0, 0, 0], [0, 0, 0], [200, 100, 0]], np.float32)
    _stamp(canvas, places, colours, dot)
    assert canvas[0, 0].tolist() == [0, 0, 0] and canvas[0, 1].tolist() == [127.5] * 3
    assert canvas[5, 4].tolist() == [200, 100, 0]  # the later one is on top
    assert canvas[4, 4].tolist() == [163.75, 113.75, 63.75]
    assert (canvas[2:4] == 255).all()


def test_strays_set_no_scale_and_are_not_shown():
    cloud_m = np.random.default_rng(0).uniform(0, 1, (4000, 3))
    strayed_m = np.concatenate([cloud_m, [[900.0, 0, 0]]])
    picture = dots_by_columns(strayed_m, {"one": [strayed_m]}, {"cloud": "#0072B2"})
    view = picture.rows[0][0]
    assert view.high_m.max() < 1.2 and view.low_m.min() > -0.2
    assert picture.image(60).width > 100
