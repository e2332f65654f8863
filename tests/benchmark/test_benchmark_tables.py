"""Tables and curves over many pairs, checked against rows whose figures are known by hand."""

from dataclasses import replace

import numpy as np
import pytest

from skipnet.benchmark.options import ProtocolKind
from skipnet.benchmark.reporting.comparison import (
    chosen_table,
    confidence_scores,
    confidence_table,
    correspondences_table,
    overlap_curve,
    overlap_table,
    rules_table,
    sets_table,
    success_table,
)
from skipnet.benchmark.reporting.curves import draw_confidence, draw_overlap, draw_points
from skipnet.benchmark.reporting.events import cumulative_curve
from skipnet.benchmark.reporting.tables import failures_table
from skipnet.benchmark.scoring.protocols import PROTOCOLS
from skipnet.benchmark.scoring.scoring import ScoreRow
from skipnet.benchmark.scoring.summary import summarise

LABELS = {"ours": "Ours", "peer": "Peer"}
OWN = PROTOCOLS[ProtocolKind.own]


def row(pair, success=True, method="ours", **fields):
    """A final pose; what is not given does not matter."""
    known = {
        "set": "hall", "stage": "fine", "counts": True, "rotation_error_deg": 1.0,
        "translation_error_mm": 10.0, "x_error_mm": 1.0, "y_error_mm": 1.0, "z_error_mm": 1.0,
        "mean_error_mm": 1.0, "time_s": 1.0, "map_s": 0.0, "transform_s": 0.0, "total_s": 1.0,
        "status": "registered", "confidence": None, "margin": None, "overlap": 0.6,
        "source_points": 1000, "target_points": 1000, "rmse_mm": None, "inlier_ratio": None,
        "own_limits": "5°, 0.3 m", "error": "", "right_by": {"own": success},
    }  # fmt: skip
    return ScoreRow(**{"pair": pair, "method": method, "success": success, **known, **fields})


def column(table, label):
    """The cells of one method by the names of the rows."""
    place = table.headers.index(label)
    return {row[0]: row[place] for row in table.rows}


def cells(table, label):
    (line,) = [line for line in table.rows if line[0] == label]
    return dict(zip(table.headers, line, strict=True))


def test_success_table_by_hand():
    """Ten pairs: errors 1 to 10 degrees; the two largest are wrong, the last gave no pose."""
    rows = [
        row(f"p{n}", n < 9, rotation_error_deg=float(n), translation_error_mm=10.0 * n, total_s=n)
        for n in range(1, 10)
    ]
    infinite = {"rotation_error_deg": np.inf, "translation_error_mm": np.inf}
    rows.append(row("p10", False, **infinite, mean_error_mm=np.inf, total_s=10.0))
    found = cells(success_table(summarise(rows, LABELS), LABELS, OWN), "Ours")
    assert found["own limits: rate"] == "80.0%"
    assert found["pairs"] == "8 of 10"
    assert (found["RRE (deg)"], found["RTE (mm)"]) == ("4.50", "45.0")  # of the successes, 1 to 8
    assert (found["median (deg)"], found["median (mm)"]) == ("5.50", "55.0")
    assert (found["90 % (deg)"], found["90 % (mm)"]) == ("9.00", "90.0")
    assert found["time (s)"] == "5.50"


def test_pairs_that_do_not_count_are_in_no_denominator_and_scenes_weigh_alike():
    rule = PROTOCOLS[ProtocolKind.rmse_20cm]
    kitchen = [row(f"k{n}", True, set="kitchen") for n in range(8)]
    hotel = [row("h1", False, set="hotel"), row("h2", True, set="hotel")]
    skipped = [row("h3", False, set="hotel", counts=False)]
    entries = summarise([*kitchen, *hotel, *skipped], LABELS)
    found = cells(success_table(entries, LABELS, rule), "Ours")
    assert found["RMSE < 0.2 m: mean of sets"] == "75.0%"  # (8/8 + 1/2) / 2, not 9 of 10
    assert found["pairs"] == "9 of 10"
    found = column(sets_table([*kitchen, *hotel, *skipped], LABELS, rule), "Ours")
    assert found == {
        "kitchen": "8 of 8",
        "hotel": "1 of 2",
        "all pairs": "9 of 10",
        "mean of sets": "75.0%",
    }


def test_own_limits_stand_beside_each_set():
    rows = [row("a"), row("b", set="street", own_limits="5°, 2 m")]
    first = [line[0] for line in sets_table(rows, LABELS, OWN).rows]
    assert first[:2] == ["hall (5°, 0.3 m)", "street (5°, 2 m)"]


def test_the_chosen_methods_are_named_set_by_set():
    labels = LABELS | {"small": "0.1 m", "large": "0.4 m"}
    chosen = {("Peer, best", "hall"): "small", ("Peer, best", "street"): "large"}
    table = chosen_table(chosen, labels)
    assert table.rows == (("hall", "0.1 m"), ("street", "0.4 m"))
    assert chosen_table({}, labels) is None


def test_every_rule_has_a_column_and_its_own_denominator():
    rows = [
        row("a", right_by={"own": True, "deg2_30cm": False, "rmse_20cm": True}),
        row("b", right_by={"own": True, "deg2_30cm": True}),
    ]
    found = cells(rules_table(rows, LABELS), "Ours")
    assert found["own limits"] == "100.0% (2 of 2)"
    assert found["2°, 0.3 m"] == "50.0% (1 of 2)"
    assert found["RMSE < 0.2 m"] == "100.0% (1 of 1)"
    assert "5°, 2 m" not in found


def test_overlap_bins_by_hand():
    shares = {0.05: True, 0.1: False, 0.29: True, 0.3: True, 0.95: False, 1.0: True}
    rows = [row(f"p{share}", flag, overlap=share) for share, flag in shares.items()]
    assert column(overlap_table(rows, LABELS), "Ours") == {
        "0% to 10%": "1 of 1",
        "10% to 15%": "0 of 1",
        "25% to 30%": "1 of 1",
        "30% to 40%": "1 of 1",
        "80% to 100%": "1 of 2",
    }
    curve = np.array(overlap_curve(rows))[:, :2]
    middles = (0.05, 0.125, 0.275, 0.35, 0.9)
    np.testing.assert_allclose(curve, np.column_stack([middles, (1.0, 0.0, 1.0, 1.0, 0.5)]))


def test_confidence_by_hand():
    """0.95: right, wrong. 0.25: wrong. Gaps: 0.45 for two, 0.25 for one."""
    rows = [row("a", True, confidence=0.95), row("b", False, confidence=0.95)]
    rows.append(row("c", False, confidence=0.25))
    scores = confidence_scores(rows)
    assert scores["ece"] == pytest.approx((2 * 0.45 + 0.25) / 3)
    assert (scores["precision_90"], scores["recall_90"]) == (0.5, 1.0)
    assert scores["average_precision"] == pytest.approx(0.5)
    assert cells(confidence_table(rows, LABELS), "Ours")["ECE"] == "0.383"
    silent = [replace(one, confidence=None) for one in rows]
    assert confidence_table(silent, LABELS) is None
    assert draw_confidence(silent, LABELS) is None


def test_a_broken_pair_has_no_inliers_and_is_not_recalled():
    rows = [row("a", inlier_ratio=0.5), row("b", inlier_ratio=0.04), row("c", error="none")]
    rows += [row(name, method="peer") for name in "abc"]
    table = correspondences_table(summarise(rows, LABELS), LABELS, 0.1)
    assert [line[0] for line in table.rows] == ["Ours"]
    found = cells(table, "Ours")
    assert (found["mean inlier ratio"], found["feature-matching recall"]) == ("0.180", "33.3%")
    assert correspondences_table(summarise(rows[3:], LABELS), LABELS, 0.1) is None


def test_curves_draw_every_method():
    rows = [row("a", overlap=0.2), row("b", False, overlap=0.8, error="hung", total_s=60.0)]
    rows += [row("a", False, "peer", overlap=0.2), row("b", True, "peer", overlap=0.8)]
    (axes,) = draw_overlap(rows, LABELS).axes
    heights = [container.lines[0].get_ydata().tolist() for container in axes.containers]
    assert heights == [[1.0, 0.0], [0.0, 1.0]]
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["Ours", "Peer"]
    (axes,) = draw_points(rows, LABELS).axes
    drawn = [collection.get_offsets().data.tolist() for collection in axes.collections]
    assert drawn == [[[2000, 1.0]], [[2000, 60.0]], [[2000, 1.0], [2000, 1.0]], []]


def test_reliability_counts_its_answers():
    rows = [row("a", True, confidence=0.95), row("b", False, confidence=0.95)]
    reliability, recall = draw_confidence(rows, LABELS).axes
    (x,), (y,) = reliability.lines[0].get_data()
    assert (x, y) == pytest.approx((0.95, 0.5))
    assert [text.get_text() for text in reliability.texts] == ["2"]
    assert recall.get_legend().get_texts()[0].get_text() == "Ours"


def test_failures_come_method_by_method_the_worst_first():
    rows = [row(f"p{n}", n == 1, "peer", mean_error_mm=float(n)) for n in (1, 2, 3)]
    rows += [row("p1", False, "ours", error="hung"), row("p2", False, "ours", counts=False)]
    table = failures_table(rows, [])
    assert [line[:2] for line in table.rows] == [("p3", "peer"), ("p2", "peer"), ("p1", "ours")]
    assert failures_table([row("a")], []) is None


def test_cumulative_curve_by_hand():
    """Errors of 10 mm, 1 m and infinity: a third is reached at once, two thirds at 1 m."""
    rows = [row("a", mean_error_mm=10.0), row("b", mean_error_mm=1000.0)]
    curve = dict(cumulative_curve([*rows, row("c", False, mean_error_mm=np.inf)]))
    shares = [curve[limit_mm] for limit_mm in (10, 750, 1000, 10_000)]
    assert shares == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
