"""Pictures show the right colours, pages need nothing else, events can be read back."""

from __future__ import annotations

import base64
import io
from html.parser import HTMLParser

import numpy as np
import pytest

from skipnet.geometry import make_transform
from skipnet.types import FeatureClass
from skipnet.viz import colours, dashboard, html, pictures, views


def pixels(figure):
    from matplotlib.image import imread

    return (imread(io.BytesIO(views.png_bytes(figure, dpi=60)))[..., :3] * 255).round()


def share_of(colour, image):
    """Share of the pixels that are nearly of this ``#RRGGBB`` colour."""
    wanted = [int(colour[start : start + 2], 16) for start in (1, 3, 5)]
    return float((np.abs(image - wanted).max(axis=2) < 40).mean())


@pytest.fixture
def square():
    """A flat square of points, 4 m x 2 m."""
    return np.random.default_rng(0).uniform([0, 0, 0], [4, 2, 0.01], size=(6000, 3))


def test_before_after_draws_both_scans_and_moves_the_source(square):
    T_target_source = make_transform(np.eye(3), np.array([10.0, 0, 0]))
    picture = pictures.draw_before_after(square, square + [10, 0, 0], T_target_source)
    before, after = (np.concatenate(view.clouds_m)[:, 0] for view in picture.rows[0])
    assert len(before) == len(after) == 2 * len(views.thin(square))
    assert before.min() < 0.1 and before.max() > 13.9
    assert after.min() > 9.9
    sides = ("from above", "from the side")
    titles = [f"{stage}, {view}" for view in sides for stage in ("before", "after")]
    assert [view.title for row in picture.rows for view in row] == titles
    image = pixels(picture)
    assert share_of(colours.SOURCE_COLOUR, image) > 0.001
    assert share_of(colours.TARGET_COLOUR, image) > 0.001


def test_a_palette_makes_a_picture_smaller_and_keeps_its_colours(square):
    figure = pictures.draw_before_after(square, square, make_transform(np.eye(3), np.ones(3)))
    whole, small = views.png_bytes(figure), views.png_bytes(figure, colours=64)
    assert len(small) < 0.6 * len(whole)
    from matplotlib.image import imread

    image = (imread(io.BytesIO(small), format="png")[..., :3] * 255).round()
    assert share_of(colours.SOURCE_COLOUR, image) > 0.001
    assert share_of(colours.TARGET_COLOUR, image) > 0.001


def test_the_longer_side_runs_to_the_right_and_is_still_seen_from_above(square):
    turned = square[:, [1, 0, 2]]
    figure = pictures.draw_scans([turned], ["a.ply"])
    axes = figure.axes[0]
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("y (m)", "x (m)")
    assert axes.get_ylim()[0] > axes.get_ylim()[1]
    # Right x up must be the z that points to the reader: y x (-x) = z.
    assert np.cross([0, 1, 0], [-1, 0, 0])[2] == 1


@pytest.mark.parametrize("name", ["a.ply", "a_rather_long_name_of_a_scan_in_the_cellar.ply"])
def test_the_legend_of_many_scans_fits_into_the_picture(square, name):
    figure = pictures.draw_scans([square] * 7, [f"{number}: {name}" for number in range(7)])
    figure.draw_without_rendering()
    legend, picture = figure.legends[0].get_window_extent(), figure.bbox
    assert picture.x0 <= legend.x0 and legend.x1 <= picture.x1
    assert len(figure.legends[0].get_texts()) == 7


def test_a_stray_point_does_not_set_the_scale(square):
    figure = pictures.draw_scans([np.concatenate([square, [[1000.0, 0, 0]]])], ["a.ply"])
    assert figure.axes[0].get_xlim()[1] < 10


def test_skipmap_pictures_show_flat_dark_blue_and_curved_bright_yellow(square):
    curvatures = np.where(square[:, 0] > 2, 0.2, 0.0)
    image = pixels(pictures.draw_skipmap_by_curvature(square, curvatures))
    assert share_of("#0d0887", image) > 0.005
    assert share_of("#f0f921", image) > 0.005
    image = pixels(pictures.draw_skipmap_by_class(square, np.full(len(square), FeatureClass.EDGE)))
    assert share_of(colours.CLASS_COLOURS[FeatureClass.EDGE], image) > 0.005


def test_colours_of_values():
    np.testing.assert_array_equal(
        colours.curvature_colours(np.array([0.0, colours.CURVATURE_OF_BRIGHTEST, 1.0])),
        [[12, 7, 134], [239, 248, 33], [239, 248, 33]],
    )
    shades = colours.class_colours(np.array(list(FeatureClass)))
    assert ["#" + bytes(row.tolist()).hex().upper() for row in shades] == list(
        colours.CLASS_COLOURS.values()
    )


def test_confusion_matrix_says_recall_and_counts():
    figure = pictures.draw_confusion_matrix(np.array([[3, 1], [0, 0]]), ["edge", "plane"])
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["75%\n3", "25%\n1", "0%\n0", "0%\n0"]


def test_thinning_keeps_real_points_evenly_and_always_the_same():
    rng = np.random.default_rng(0)
    dense = np.concatenate(
        [rng.normal(0, 0.05, size=(90_000, 3)), rng.uniform(-5, 5, size=(20_000, 3))]
    )
    thinned = views.thin(dense, most=5000)
    assert len(thinned) == 5000
    assert len(np.unique(np.concatenate([dense, thinned]), axis=0)) == len(dense)
    assert (np.abs(thinned).max(axis=1) < 0.2).mean() < 0.1
    np.testing.assert_array_equal(thinned, views.thin(dense, most=5000))
    assert len(views.thin(np.ones((5, 3)))) == 1


class Outline(HTMLParser):
    """Collects tags that must nest, their attributes and the text."""

    def __init__(self, text):
        super().__init__()
        self.open, self.attributes, self.text = [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.attributes += attributes
        if tag not in ("meta", "img", "br", "wbr"):
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text += data


def test_a_page_is_well_formed_escaped_and_loads_nothing():
    png = views.png_bytes(pictures.draw_confusion_matrix(np.eye(2, dtype=int), ["a", "b"]))
    text = html.page(
        "A <title> & $more",
        html.status_banner("failed", "because 1 < 2", 0.256),
        html.picture(png, 'a "picture"'),
        html.section("Numbers & names", html.table(["name", "mm"], [("<x>", "1.5"), ("y", "-")])),
        html.matrix(np.eye(4)),
        html.footer("end"),
    )
    outline = Outline(text)
    assert outline.open == []
    assert (
        "A <title> & $more" in outline.text
        and "because 1 < 2" in outline.text
        and "<x>" in outline.text
    )
    assert "Confidence 26%" in outline.text
    sources = [value for name, value in outline.attributes if name in ("src", "href")]
    assert [base64.b64decode(source.split(",")[1]) for source in sources] == [png]
    assert text.count('class="number"') == 3


def test_events_can_be_read_back(tmp_path, square):
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    with dashboard.open_dashboard(tmp_path) as writer:
        dashboard.log_scalars(writer, {"loss/train": 0.5, "loss/val": 0.25}, step=3)
        dashboard.log_hyperparameters(writer, {"lr": 0.01, "hidden": [50]}, {"hparam/f1": 0.9})
        dashboard.log_confusion_matrix(
            writer, "confusion", np.array([[3, 1], [0, 4]]), ["edge", "plane"]
        )
        dashboard.log_skipmap_by_curvature(writer, "map/curvature", square, np.zeros(len(square)))
        dashboard.log_skipmap_by_class(
            writer, "map/class", square, np.zeros(len(square), dtype=int)
        )

    assert len(list(tmp_path.iterdir())) == 1
    events = EventAccumulator(str(tmp_path), size_guidance={"tensors": 0}).Reload()
    assert [(event.step, event.value) for event in events.Scalars("loss/val")] == [(3, 0.25)]
    assert events.Scalars("confusion_recall/edge")[0].value == 0.75
    assert events.Scalars("hparam/f1")[0].value == pytest.approx(0.9)
    assert "confusion" in events.Tags()["images"]
    assert {"map/curvature_VERTEX", "map/curvature_COLOR", "map/class_COLOR"} <= set(
        events.Tags()["tensors"]
    )
    plugins = set(
        events.summary_metadata[tag].plugin_data.plugin_name for tag in events.summary_metadata
    )
    assert {"mesh", "hparams"} <= plugins
