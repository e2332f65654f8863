"""Described scans on disk: the same bits come back, in another process too."""

from __future__ import annotations

import json
import pickle
import subprocess
import sys

import numpy as np
import pytest

import skipnet
from skipnet.networks.catalog import find_network
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.pipeline import register_scans
from skipnet.registration.stopwatch import Stopwatch
from skipnet.scans.describing import describe
from skipnet.scans.record import read_record, write_record
from skipnet.scans.store import ScanStore, scan_key
from skipnet.simulation.scanning.pairs import simulate_pair
from skipnet.skipmap.tree import build_tree

READER = """
import json, sys
from pathlib import Path
from skipnet.networks.catalog import find_network
from skipnet.registration.options import RegistrationConfig
from skipnet.registration.pipeline import register_scans
from skipnet.registration.stopwatch import Stopwatch
from skipnet.scans.store import ScanStore
store = ScanStore(Path(sys.argv[1]))
source, target = (store.load(key, find_network()) for key in sys.argv[2:])
result = register_scans(source, target, RegistrationConfig(), Stopwatch())
print(json.dumps([result.T_target_source.tobytes().hex(), result.confidence.hex()]))
"""


@pytest.fixture(scope="module")
def pair():
    return simulate_pair("oblique", 31, rotation="any", points=30_000).pair


def registered(scans):
    result = register_scans(*scans, RegistrationConfig(), Stopwatch())
    return [result.T_target_source.tobytes().hex(), float(result.confidence).hex()]


def test_another_process_registers_what_was_written_to_the_same_bits(pair, tmp_path):
    clouds, ways, network = [pair.source_m, pair.target_m], ["auto", None], find_network()
    scans = ScanStore(tmp_path).describe(clouds, ways, 0.15, 3, network)
    keys = [scan_key(*both, 0.15, 3, network) for both in zip(clouds, ways, strict=True)]
    command = [sys.executable, "-c", READER, str(tmp_path), *keys]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == registered(scans)
    # It is what registering the points themselves comes to.
    direct = skipnet.register(
        pair.source_m, pair.target_m, target_viewpoint=None, voxel_size_m=0.15, seed=3
    )
    assert direct.T_target_source.tobytes().hex() == registered(scans)[0]
    assert direct.status == "registered"


def test_scans_pickle_whatever_was_worked_out_before(pair):
    scans = describe([pair.source_m, pair.target_m], ["auto", "auto"], 0.15)
    before = registered(scans)
    assert scans[0].thinned  # holds trees of a library, which do not pickle
    again = pickle.loads(pickle.dumps(scans))
    assert registered(again) == before


def test_what_is_in_the_folder_is_not_described_again(pair, tmp_path, monkeypatch):
    store, network = ScanStore(tmp_path), find_network()
    given = [pair.source_m, pair.target_m], ["auto", "auto"], 0.15, 0, network
    first = store.describe(*given)
    monkeypatch.setattr("skipnet.scans.store.describe", None)
    second = store.describe(*given)
    assert registered(first) == registered(second)
    monkeypatch.undo()
    # A damaged file is as good as none, and is mended.
    damaged = sorted(tmp_path.glob("*.npz"))[0]
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[: len(whole) // 2])
    assert registered(store.describe(*given)) == registered(first)
    assert damaged.read_bytes() == whole


def test_a_key_holds_all_that_a_description_depends_on(pair):
    network = find_network()
    points_m, tree = pair.source_m, build_tree(pair.source_m, 0.1)
    keys = [
        scan_key(points_m, "auto", 0.15, 0, network),
        scan_key(points_m[:-1], "auto", 0.15, 0, network),
        scan_key(points_m.astype(np.float64), "auto", 0.15, 0, network),
        scan_key(points_m, None, 0.15, 0, network),
        scan_key(points_m, [0.0, 0.0, 0.1], 0.15, 0, network),
        scan_key(points_m, "auto", 0.15000001, 0, network),
        scan_key(points_m, "auto", 0.15, 1, network),
        scan_key(tree, "auto", 0.15, 0, network),
    ]
    assert len(set(keys)) == len(keys)
    assert keys[4] == scan_key(points_m, np.array([0.0, 0.0, 0.1]), 0.15, 0, network)
    assert keys[0] == scan_key(points_m.copy(order="F"), "auto", 0.15, 0, network)


@pytest.mark.parametrize("content", [b"", b"not an archive", b"PK\x03\x04 and no more"])
def test_a_file_that_holds_no_scan_is_named(content, tmp_path):
    path = tmp_path / "scan.npz"
    path.write_bytes(content)
    with pytest.raises(ValueError, match="scan.npz is no described scan"):
        read_record(path)


def test_a_file_of_another_format_is_named(pair, tmp_path):
    (scan,) = describe([pair.source_m], [None], 0.15)
    write_record(scan.record, tmp_path / "a.npz")
    assert read_record(tmp_path / "a.npz").range_image is None
    with np.load(tmp_path / "a.npz") as file:
        parts = {**file, "format": 99}
    np.savez(tmp_path / "a.npz", **parts)
    with pytest.raises(ValueError, match=r"a\.npz is no described scan: format 99"):
        read_record(tmp_path / "a.npz")
