"""Child processes and threads: what runs in them, and how many threads BLAS takes."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from threading import Barrier, Event, Thread

import numpy as np
import pytest
import scipy.linalg  # noqa: F401  # has a BLAS of its own, which only counts once it is loaded
from threadpoolctl import threadpool_info, threadpool_limits

from skipnet.networks import describing
from skipnet.networks.catalog import find_network
from skipnet.parallel import threads
from skipnet.parallel.pools import THREAD_VARIABLES, environment, mapping, worker_pool
from skipnet.parallel.threads import one_blas_thread
from skipnet.registration import pipeline
from skipnet.registration.judging.judge import Judge
from skipnet.registration.options import Generator, RegistrationConfig
from skipnet.scans import describing as making
from skipnet.simulation.scanning.pairs import simulate_pair


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
        with pytest.raises(KeyError), one_blas_thread:
            assert one_blas_thread(blas_threads)() == {1}
            with ThreadPoolExecutor(2) as pool:  # as scans are described: each thread enters too
                found = [pool.submit(one_blas_thread(blas_threads)) for _ in range(8)]
            assert [each.result() for each in found] == [{1}] * 8
            assert blas_threads() == {1}, "leaving the inner ones must not end the outer one"
            raise KeyError
        assert blas_threads() == {2}


def test_whoever_leaves_last_undoes_it() -> None:
    entered, leave, left = Event(), Event(), Event()

    def other() -> None:
        with one_blas_thread:
            entered.set()
            leave.wait()
        left.set()
        stay.wait()  # a thread that lives on must not keep BLAS to itself

    stay = Event()
    thread = Thread(target=other)
    with threadpool_limits(2, user_api="blas"):
        with one_blas_thread:
            thread.start()
            entered.wait()
        assert blas_threads() == {1}, "the other thread is still inside"
        leave.set()
        left.wait()
        assert blas_threads() == {2}
        with one_blas_thread:
            assert blas_threads() == {1}
        assert blas_threads() == {2}
        stay.set()
        thread.join()


def test_registration_keeps_blas_to_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    seen = {}

    def watched(module: object, name: str) -> None:
        inner = getattr(module, name)

        def watching(*arguments: object, **named: object) -> object:
            seen[name] = blas_threads()
            return inner(*arguments, **named)

        monkeypatch.setattr(module, name, watching)

    watched(making, "build_tree")
    watched(Judge, "shortlist")
    watched(describing, "choose_keypoints")
    pair = simulate_pair("paper_room", 1, points=20_000).pair
    with threadpool_limits(2, user_api="blas"):
        config = RegistrationConfig(generators=[Generator.descriptors])
        pipeline.register(pair.source_m, pair.target_m, config=config)
        assert seen == dict.fromkeys(("build_tree", "shortlist", "choose_keypoints"), {1})
        seen.clear()
        source, target = making.describe((pair.source_m, pair.target_m), ("auto", "auto"))
        network = find_network()
        describing.correspond(source.skipmap, target.skipmap, network)
        assert seen == dict.fromkeys(("build_tree", "choose_keypoints"), {1})
        seen.clear()
        describing.describe_keypoints(source.skipmap, network)
        assert seen == {"choose_keypoints": {1}}


def test_calls_side_by_side_come_back_in_order_whoever_makes_them(monkeypatch):
    expected = [number + 10 * number for number in range(40)]
    for count in (1, 2, 8):
        monkeypatch.setattr(threads, "processors", lambda count=count: count)
        columns = range(40), range(0, 400, 10)
        assert threads.side_by_side(lambda a, b: a + b, *columns) == expected
        assert threads.side_by_side(lambda a: a, []) == []


def test_calls_side_by_side_may_make_others_though_all_helpers_are_busy():
    def outer(number):
        return sum(threads.side_by_side(lambda inner: number * inner, range(5)))

    assert threads.side_by_side(outer, range(30)) == [10 * number for number in range(30)]


@pytest.mark.parametrize("wrong", [0, 1, 7])
def test_an_error_side_by_side_is_raised(wrong):
    def call(number):
        if number == wrong:
            raise ValueError(f"call {number}")
        return number

    with pytest.raises(ValueError, match=f"call {wrong}"):
        threads.side_by_side(call, range(8))
    all_wrong = [wrong] * 6
    with pytest.raises(ValueError, match="first"):
        threads.side_by_side(
            lambda place, number: call(number) if place else int("first"), range(6), all_wrong
        )
    assert threads.side_by_side(call, range(8, 12)) == [8, 9, 10, 11]


def test_two_long_calls_side_by_side_run_at_the_same_time(monkeypatch):
    monkeypatch.setattr(threads, "processors", lambda: 2)
    here = Barrier(2)
    assert threads.side_by_side(lambda _: here.wait(timeout=20) >= 0, range(2)) == [True, True]


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_child_gets_helpers_of_its_own():
    script = """
import os
from threading import Barrier
from skipnet.parallel import threads
threads.processors = lambda: 2
print(threads.side_by_side(abs, range(4)), flush=True)
if os.fork() == 0:
    here = Barrier(2)  # only two threads get past it
    print(threads.side_by_side(lambda _: here.wait(timeout=20) >= 0, range(2)), flush=True)
    os._exit(0)
os.wait()
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n") == ["[0, 1, 2, 3]", "[True, True]", ""]


def test_an_error_does_not_wait_for_what_the_workers_do() -> None:
    started = time.monotonic()
    with pytest.raises(KeyboardInterrupt), worker_pool(1) as pool:
        pool.submit(os.getpid).result()
        pool.submit(time.sleep, 300)
        raise KeyboardInterrupt
    assert time.monotonic() - started < 200  # long before the worker would have been done
