"""Run folders, networks and lists of strangers are data: each fault is one line with the path."""

from __future__ import annotations

import json
import pickle
import shutil
import zipfile

import numpy as np
import pytest

from skipnet.benchmark.datasets.listed import list_pairs
from skipnet.benchmark.scoring.predictions import (
    Prediction,
    append_prediction,
    load_correspondences,
    read_predictions,
    save_correspondences,
)
from skipnet.networks.catalog import find_network, save_network
from skipnet.networks.names import SHIPPED, weights_file
from skipnet.projects.store import PairStore
from skipnet.scans.record import read_record
from skipnet.studies.misses import find_misses
from skipnet.studies.study import do_all
from skipnet.viz.tables import Table

DEEP = "[" * 100_000
GARBAGE = [b"", b"\xff\xfe\x00garbage", DEEP.encode(), b"[1, 2]", b'{"a": NaN', b"null"]


class Bomb:
    """Unpickled, it would tell of it."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('executed')",))


def refused(call, path):
    with pytest.raises(ValueError) as refusal:
        call()
    message = str(refusal.value)
    assert str(path) in message and len(message) < 1000, message
    return message


POSE = np.eye(4).tolist()
WRONG_POSES = [np.eye(3).tolist(), [[float("nan")] * 4] * 4, "x", [[1, 2], [3]], 7]


def entry(**changes):
    good = {"set": "s", "source": "a.ply", "target": "b.ply", "T_target_source": POSE}
    return {**good, "success_rotation_deg": 5, "success_translation_m": 0.3, **changes}


@pytest.mark.parametrize("content", GARBAGE)
def test_a_list_of_pairs_that_is_none(tmp_path, content):
    (tmp_path / "pairs.json").write_bytes(content)
    assert refused(lambda: list_pairs(tmp_path), tmp_path / "pairs.json")


@pytest.mark.parametrize(
    "changes",
    [
        *({"T_target_source": T} for T in WRONG_POSES),
        *({"source": name} for name in ("../a.ply", "/etc/passwd", 3, None)),
        {"success_rotation_deg": float("nan")},
        {"success_translation_m": -1},
        {"overlap": "much"},
    ],
)
def test_a_pair_that_cannot_be_right_is_named(tmp_path, changes):
    path = tmp_path / "pairs.json"
    path.write_text(json.dumps({"pairs": [entry(), entry(target="c.ply", **changes)]}))
    assert "entry 1" in refused(lambda: list_pairs(tmp_path), path)


@pytest.mark.parametrize(
    "changes",
    [
        *({"T_target_source": T} for T in WRONG_POSES),
        {"correspondences": "../../secret.npy"},
        {"correspondences": 3},
        {"status": "splendid"},
        {"pair": 1},
        {"time_s": "long"},
        {"stage_s": [1]},
        {"unknown": 1},
    ],
)
def test_a_prediction_that_cannot_be_right(tmp_path, changes):
    path = tmp_path / "predictions.jsonl"
    append_prediction(path, Prediction("p", "m", "h", 1.0, T_target_source=POSE))
    assert len(read_predictions(path)) == 1
    known = json.loads(path.read_text())
    with path.open("a") as file:
        file.write(json.dumps({**known, **changes}) + "\n")
    assert "line 2" in refused(lambda: read_predictions(path), path)


@pytest.mark.parametrize("content", GARBAGE)
def test_lines_that_are_no_predictions_or_outcomes(tmp_path, content):
    for name, read in (
        ("predictions.jsonl", read_predictions),
        ("outcomes.jsonl", lambda path: do_all({}, None, path.parent)),
    ):
        path = tmp_path / name
        path.write_bytes((content or b"7") + b"\n")
        assert refused(lambda read=read, path=path: read(path), path)


def test_correspondences_of_another_shape(tmp_path):
    kept = save_correspondences(
        tmp_path, Prediction("p", "m", "h", 1.0), np.ones((4, 3)), np.ones((4, 3))
    )
    assert load_correspondences(tmp_path, kept)[0].shape == (4, 3)
    path = tmp_path / kept.correspondences
    np.save(path, np.ones(5))
    refused(lambda: load_correspondences(tmp_path, kept), path)
    np.save(path, np.array([Bomb()]), allow_pickle=True)
    refused(lambda: load_correspondences(tmp_path, kept), path)


@pytest.fixture
def network(tmp_path):
    path = tmp_path / "own.npz"
    shutil.copy(weights_file(SHIPPED), path)
    shutil.copy(weights_file(SHIPPED).with_suffix(".json"), path.with_suffix(".json"))
    return path


def test_a_network_whose_weights_were_changed(network):
    find_network(str(network))
    with np.load(network) as file:
        weights = dict(file)
    card = json.loads(network.with_suffix(".json").read_text())
    name = next(iter(weights))
    np.savez(network, **{**weights, name: weights[name] + 1})
    assert "digest" in refused(lambda: find_network(str(network)), network)
    for wrong in (weights[name][:, :-1], np.full_like(weights[name], np.nan), weights[name][0]):
        save_network({**weights, name: wrong}, card, network)
        refused(lambda: find_network(str(network)), network)
    card = {**card, "architecture": "deep", "widths": {"output": 10**9}}
    save_network(weights, card, network)
    refused(lambda: find_network(str(network)), network)


@pytest.mark.parametrize("content", [*GARBAGE, pickle.dumps(Bomb())])
def test_files_that_are_no_networks(network, content):
    whole = network.read_bytes()
    network.write_bytes(content)
    refused(lambda: find_network(str(network)), network)
    network.write_bytes(whole)
    card = network.with_suffix(".json")
    known = card.read_bytes()
    card.write_bytes(content)
    refused(lambda: find_network(str(network)), card)
    card.write_bytes(known)
    with zipfile.ZipFile(network, "w") as archive:
        archive.writestr("weights.npy", content)
    refused(lambda: find_network(str(network)), network)


@pytest.mark.parametrize("content", [*GARBAGE, pickle.dumps(Bomb())])
def test_checkpoints_and_kept_scans_and_pairs_of_strangers(tmp_path, content):
    import torch

    from skipnet.training.checkpoints import load_checkpoint

    path = tmp_path / "checkpoint.pt"
    path.write_bytes(content)
    refused(lambda: load_checkpoint(path, "x", torch.device("cpu")), path)
    torch.save({"identity": "x"}, path)
    refused(lambda: load_checkpoint(path, "x", torch.device("cpu")), path)
    path.write_bytes(content)
    refused(lambda: read_record(path), path)
    (tmp_path / "key.json").write_bytes(content)
    assert PairStore(tmp_path).load("key") is None


def test_a_run_of_a_stranger_names_no_code(tmp_path):
    path = tmp_path / "config.yaml"
    for text in ("dataset: os.system", "a: !!python/object/apply:os.system [x]", "x: [", "7"):
        path.write_text(text)
        assert refused(lambda: next(find_misses(tmp_path)), path)


def test_names_are_escaped_in_markdown():
    text = Table("a\nb", ("<x>", "[y](z)"), (("`c`|d", "*e*\n# f"),)).markdown()
    assert text.splitlines()[:3] == ["## a b", "", r"| &lt;x> | \[y](z) |"]
    assert text.splitlines()[4] == r"| \`c\`\|d | \*e\* # f |"
