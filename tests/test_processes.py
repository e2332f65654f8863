"""Child processes: what runs in them, with how many threads, and what stays here."""

from __future__ import annotations

import os

import numpy as np

from skipnet.processes import THREAD_VARIABLES, environment, mapping, worker_pool


def threads_of_blas(size: int) -> tuple[int, list[int]]:
    """The process that computes, and the threads that its libraries take (threadpoolctl says)."""
    from threadpoolctl import threadpool_info

    assert np.linalg.eigvalsh(np.eye(size)).sum() == size
    return os.getpid(), [library["num_threads"] for library in threadpool_info()]


def test_workers_take_one_thread_each() -> None:
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    with worker_pool(2) as pool:
        found = list(pool.map(threads_of_blas, [2, 3, 4]))
    assert all(threads and set(threads) == {1} for _, threads in found)
    assert os.getpid() not in {process for process, _ in found}
    assert {name: os.environ.get(name) for name in THREAD_VARIABLES} == before


def test_one_worker_is_this_process() -> None:
    with mapping(1) as each:
        assert {process for process, _ in each(threads_of_blas, [2, 3])} == {os.getpid()}
    with mapping(2) as each:
        assert list(each(pow, [2, 3, 4], [5, 6, 7])) == [2**5, 3**6, 4**7]


def test_the_environment_is_as_before_even_after_an_error() -> None:
    os.environ.pop("SKIPNET_TEST", None)
    try:
        with environment({"SKIPNET_TEST": "1"}):
            assert os.environ["SKIPNET_TEST"] == "1"
            raise KeyError
    except KeyError:
        assert "SKIPNET_TEST" not in os.environ
