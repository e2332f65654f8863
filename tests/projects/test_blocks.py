"""Pairs searched by other processes: the same bits, whoever does them, and whatever ends."""

from __future__ import annotations

import os

import numpy as np
import pytest

import skipnet
from skipnet.projects import blocks
from skipnet.projects.blocks import Workers
from skipnet.simulation.scanning.pairs import simulate_scans


@pytest.fixture(scope="module")
def clouds_m():
    scans = simulate_scans("paper_room", 1, 3, rotation="any", points=10_000)[0]
    return [scan.points_m for scan in scans]


@pytest.fixture(scope="module")
def alone(clouds_m):
    return skipnet.register_many(clouds_m)


def assert_same(found, expected):
    assert found.groups == expected.groups and found.words == expected.words
    for T, T_expected in zip(found.T_group_scan, expected.T_group_scan, strict=True):
        np.testing.assert_array_equal(T, T_expected)


def test_two_processes_give_the_same_bits_as_this_one(clouds_m, alone, tmp_path, monkeypatch):
    monkeypatch.setattr(blocks, "PAIRS_PER_BLOCK", 1)
    assert_same(skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(2)), alone)


def test_a_folder_is_found_by_workers_that_began_in_another_one(
    clouds_m, alone, tmp_path, monkeypatch
):
    for name in ("one", "other"):
        (tmp_path / name).mkdir()
        monkeypatch.chdir(tmp_path / name)
        found = skipnet.register_many(clouds_m, folder="project", workers=Workers(2))
        assert_same(found, alone)


def test_a_ray_cluster_gives_the_same_bits(clouds_m, alone, tmp_path):
    pytest.importorskip("ray")
    found = skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(-1, "ray"))
    assert_same(found, alone)


@pytest.fixture
def mark(tmp_path, monkeypatch):
    """A file that is there once the first worker has ended in the middle of its block."""
    mark, search_block = tmp_path / "ended", blocks.search_block

    def ending_once(tasks, folder, config):
        if not mark.exists():
            mark.touch()
            os._exit(1)
        return search_block(tasks, folder, config)

    monkeypatch.setattr(blocks, "search_block", ending_once)
    return mark


def test_two_ray_nodes_of_which_a_worker_ends_give_the_same_bits(
    clouds_m, alone, tmp_path, mark, monkeypatch
):
    ray = pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    monkeypatch.setattr(blocks, "PAIRS_PER_BLOCK", 1)
    ray.shutdown()
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    try:
        cluster.add_node(num_cpus=1)
        ray.init(address=cluster.address)
        assert sum(node["Alive"] for node in ray.nodes()) == 2
        found = skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(-1, "ray"))
    finally:
        ray.shutdown()
        cluster.shutdown()
    assert mark.exists()
    assert_same(found, alone)


def test_a_worker_that_ends_loses_a_block_which_is_tried_again(clouds_m, alone, tmp_path, mark):
    assert_same(skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(2)), alone)
    assert mark.exists()


def test_a_worker_that_ends_again_is_reported(clouds_m, tmp_path, monkeypatch):
    def ending(tasks, folder, config):
        os._exit(1)

    monkeypatch.setattr(blocks, "search_block", ending)
    with pytest.raises(RuntimeError, match=r"3 pairs were not searched.*try fewer workers"):
        skipnet.register_many(clouds_m, folder=tmp_path, workers=Workers(2))


def test_workers_that_are_none_are_refused(clouds_m):
    with pytest.raises(ValueError, match="workers=0"):
        Workers(0)
    with pytest.raises(ValueError, match="executor='dusk'"):
        Workers(2, "dusk")
    with pytest.raises(ValueError, match="expected one that they share"):
        skipnet.Project(workers=Workers(2))
