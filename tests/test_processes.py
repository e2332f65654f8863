"""Child processes: what runs in them, and how many threads BLAS takes there and here."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from skipnet.processes import (
    THREAD_VARIABLES,
    environment,
    mapping,
    one_blas_thread,
    worker_pool,
)


def threads_of_blas(size: int) -> tuple[int, list[int]]:
    """The process that computes, and the threads that its libraries take (threadpoolctl says)."""
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
    with pytest.raises(KeyError), environment({"SKIPNET_TEST": "1"}):
        assert os.environ["SKIPNET_TEST"] == "1"
        raise KeyError
    assert "SKIPNET_TEST" not in os.environ


def blas_threads() -> set[int]:
    return {
        library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"
    }


def test_inside_blas_takes_one_thread_and_then_as_many_as_before() -> None:
    with threadpool_limits(2, user_api="blas"):
        with pytest.raises(KeyError), one_blas_thread():
            assert one_blas_thread()(blas_threads)() == {1}
            with ThreadPoolExecutor(2) as pool:  # as scans are described: each thread enters too
                found = [pool.submit(one_blas_thread()(blas_threads)) for _ in range(8)]
            assert [each.result() for each in found] == [{1}] * 8
            assert blas_threads() == {1}, "leaving the inner ones must not end the outer one"
            raise KeyError
        assert blas_threads() == {2}
