"""Right correspondences per set and descriptor, against a count of one's own."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from skipnet.benchmark.options import EvaluateConfig
from skipnet.benchmark.running.setup import make_pair_set
from skipnet.clouds.formats.writing import write_cloud
from skipnet.commands.study import main
from skipnet.geometry import invert
from skipnet.metrics.correspondences import by_fpfh
from skipnet.networks.catalog import find_network
from skipnet.networks.names import SHIPPED_WEIGHTS
from skipnet.scans.describing import describe
from skipnet.studies.inliers import FPFH, compare, ratios_table, run, totals_table
from skipnet.studies.misses import count_inliers
from skipnet.studies.options import InliersConfig


@pytest.fixture(scope="module")
def pairs():
    """Three, of two sets."""
    three = make_pair_set(EvaluateConfig(family="oblique", pairs=3, points=20_000))
    sets = (("one", 0.9), ("two", 0.2), ("two", 0.5))
    return [
        replace(pair, set_name=name, overlap=overlap)
        for pair, (name, overlap) in zip(three, sets, strict=True)
    ]


def test_ratios_are_those_counted_by_hand(pairs):
    matches = compare(pairs, {"ours": find_network(), "again": find_network()})
    ours = [one for ones in matches["ours"].values() for one in ones]
    for pair, found in zip(pairs, ours, strict=True):
        source, target = describe((pair.source_m, pair.target_m), ("auto", "auto"))
        T = invert(target.T_given_own) @ pair.T_target_source @ source.T_given_own
        right, offered = count_inliers(source, target, T)
        assert found.inlier_ratio == pytest.approx(right / offered)
        assert found.inlier_ratio > 0.2
    assert list(matches) == ["ours", "again", FPFH]
    *_, means, little = ratios_table(matches).rows
    assert little[:2] == ("overlap under 35%", "1")
    assert float(little[2]) == pytest.approx(ours[1].inlier_ratio, abs=6e-4)
    title, count, mean, mean_again, fpfh = means
    assert (title, count) == ("mean of sets", "3") and mean == mean_again != fpfh
    of_sets = [np.mean([one.inlier_ratio for one in ones]) for ones in matches[FPFH].values()]
    assert len(of_sets) == 2 and float(fpfh) == pytest.approx(np.mean(of_sets), abs=6e-4)
    matched = [one.inlier_ratio >= 0.05 for ones in matches[FPFH].values() for one in ones]
    totals = totals_table(matches).rows
    assert float(totals[0][-1]) == pytest.approx(np.mean(matched), abs=6e-4)
    assert float(totals[-1][-1]) == 1.0


def test_the_command_prints_the_table_of_a_folder(pairs, tmp_path, capsys):
    pair = pairs[0]
    write_cloud(tmp_path / "a.ply", pair.source_m)
    write_cloud(tmp_path / "b.ply", pair.target_m)
    entry = {"set": "room", "source": "a.ply", "target": "b.ply"}
    entry |= {"success_rotation_deg": 1, "success_translation_m": 0.1}
    entry["T_target_source"] = pair.T_target_source.tolist()
    (tmp_path / "pairs.json").write_text(json.dumps({"pairs": [entry]}))
    weights = [str(SHIPPED_WEIGHTS)]
    config = InliersConfig(data=str(tmp_path), networks=weights, output_dir=str(tmp_path / "out"))
    summary = run(config)
    printed = capsys.readouterr().out
    assert f"| set | pairs | skipnet | {SHIPPED_WEIGHTS} | FPFH |" in printed
    assert "| room | 1 | 0." in printed
    assert summary["inlier_ratio"]["skipnet"] == summary["inlier_ratio"][weights[0]]


def test_a_scan_without_surfaces_is_named(pairs):
    stray = replace(pairs[0], source_m=np.random.default_rng(0).normal(size=(5, 3)))
    with pytest.raises(ValueError, match="oblique.*: "):
        compare([stray], {"ours": find_network()})


def test_without_a_viewpoint_fpfh_has_sides_all_the_same(pairs, monkeypatch):
    seen = []
    monkeypatch.setattr(
        "skipnet.studies.inliers.by_fpfh",
        lambda scans, keypoints: seen.append(scans) or by_fpfh(scans, keypoints),
    )
    monkeypatch.setattr(
        "skipnet.studies.inliers.describe", lambda clouds, _: describe(clouds, (None, None))
    )
    compare(pairs[:1], {"ours": find_network()})
    assert seen and all(scan.viewpoint_m is not None for scan in (seen[0].source, seen[0].target))


def test_a_folder_without_pairs_is_refused(tmp_path, capsys):
    assert main(["inliers", f"data={tmp_path}", f"output_dir={tmp_path / 'out'}"]) == 2
    error = capsys.readouterr().err
    assert "pairs.json" in error and error.count("\n") == 1
    assert not (tmp_path / "out").exists()
