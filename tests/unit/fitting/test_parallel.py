"""Work in two threads: the same results in the same order, and linear algebra on one thread until the last is done."""

from __future__ import annotations

import threading
import time
import warnings
from concurrent.futures import ThreadPoolExecutor

import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from errpipe.fitting import parallel as module
from errpipe.fitting.parallel import no_warnings, parallel_map, prefetched
from errpipe.fitting.solve import one_thread


@pytest.mark.parametrize("cores", [1, 2])
def test_results_stand_in_order_and_the_first_failure_is_raised(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "cpu_count", lambda: cores)

    def slow(k: int, name: str) -> str:
        time.sleep(0.02 if k % 2 else 0.0)
        if k > 5:
            raise ValueError(name)
        return f"{k}{name}"

    assert parallel_map(slow, range(5), "abcde", worth=0.0) == ["0a", "1b", "2c", "3d", "4e"]
    with pytest.raises(ValueError, match="g"):
        parallel_map(slow, range(8), "abcdefgh", worth=0.0)


def test_short_pieces_and_pieces_of_pieces_stay_in_their_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "cpu_count", lambda: 2)

    def names(_: object) -> set[str]:
        return set(parallel_map(lambda _: threading.current_thread().name, range(3), worth=0.0))

    assert len(set.union(*parallel_map(lambda _: {threading.current_thread().name}, range(9)))) == 1
    for inner in parallel_map(names, range(4), worth=0.0):
        assert len(inner) == 1 and threading.main_thread().name not in inner


@pytest.mark.parametrize("cores", [1, 2])
def test_what_is_made_ahead_comes_in_order_and_few_results_wait(cores: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "cpu_count", lambda: cores)
    begun: list[int] = []

    def slow(k: int) -> int:
        begun.append(k)
        time.sleep(0.01 if k % 2 else 0.0)
        if k == 30:
            raise ValueError(k)
        return k

    for n, k in enumerate(prefetched(slow, range(20))):
        assert k == n and len(begun) <= n + module.AHEAD + 2
    with pytest.raises(ValueError, match="30"):
        list(prefetched(slow, range(100)))
    assert max(begun) <= 30 + module.AHEAD


def test_a_thread_that_leaves_does_not_lift_the_limit_for_one_that_is_still_inside() -> None:
    entered, left = threading.Event(), threading.Event()

    def threads() -> set[int]:
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    def longer() -> set[int]:
        with one_thread():
            entered.set()
            assert left.wait(10)
            return threads()

    with threadpool_limits(2, "blas"), ThreadPoolExecutor(1) as pool:
        before = threads()
        with one_thread():
            future = pool.submit(longer)
            assert entered.wait(10)
        left.set()
        assert (before, future.result(10)) == ({2}, {1})


def test_a_thread_that_leaves_does_not_bring_back_warnings_for_one_that_is_still_inside() -> None:
    entered, left = threading.Event(), threading.Event()

    def longer() -> None:
        with no_warnings():
            entered.set()
            assert left.wait(10)
            warnings.warn("stopped short of convergence", stacklevel=1)

    with warnings.catch_warnings(record=True) as heard, ThreadPoolExecutor(1) as pool:
        warnings.simplefilter("always")
        with no_warnings():
            future = pool.submit(longer)
            assert entered.wait(10)
        left.set()
        future.result()
        assert not heard
        warnings.warn("heard again", stacklevel=1)
    assert [str(one.message) for one in heard] == ["heard again"]
