"""Independent pieces of work on two cores, with the same results in the same order as sequentially."""

from __future__ import annotations

import os
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar, copy_context
from functools import partial
from threading import Lock
from time import perf_counter
from typing import Any, TypeVar, cast

AT_ONCE = 2  # pieces: Python's lock keeps no more cores busy
WORTH = 0.05  # s of the first piece, below which handing over between threads does not pay

AHEAD = 2  # results computed before they are requested, by one other thread: more would only use memory

S = TypeVar("S")
T = TypeVar("T")
_inside: ContextVar[bool] = ContextVar("inside_side_by_side", default=False)


def parallel_map(
    work: Callable[..., T], *items: Iterable[Any], at_once: int = AT_ONCE, worth: float = WORTH
) -> list[T]:
    """`work` of each item of iterables of equal length, in threads; sequentially within another call.

    The first piece is done alone, and the others sequentially if it took less than `worth` seconds. Raises the error
    of the first failing piece in order.
    """
    waiting, done = list(zip(*items, strict=True)), []
    if _inside.get() or min(at_once, len(waiting), os.cpu_count() or 1) < 2:
        return [work(*one) for one in waiting]
    if worth > 0.0:
        begin = perf_counter()
        done = [work(*waiting.pop(0))]
        if perf_counter() - begin < worth:
            return done + [work(*one) for one in waiting]
    token = _inside.set(True)
    try:
        with ThreadPoolExecutor(at_once) as pool:
            futures = [pool.submit(copy_context().run, work, *one) for one in waiting]
            try:
                return done + [future.result() for future in futures]
            finally:
                pool.shutdown(wait=False, cancel_futures=True)
    finally:
        _inside.reset(token)


def prefetched(work: Callable[[S], T], items: Iterable[S]) -> Iterator[T]:
    """`work` of each item, in order: a few are computed ahead in another thread while the caller is busy.

    For results too large to be in memory all at once. Within `parallel_map`, or on one core, sequential.
    """
    if _inside.get() or (os.cpu_count() or 1) < 2:
        yield from map(work, items)
        return
    waiting: deque[Future[T]] = deque()
    with ThreadPoolExecutor(1) as pool:
        try:
            for item in items:
                waiting.append(pool.submit(copy_context().run, work, item))
                if len(waiting) > AHEAD:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


class InTurn:
    """A context manager for one thread at a time; `left` is a value passed from one turn to the next.

    The core of waiting threads is free for what is `prefetched`.
    """

    def __init__(self) -> None:
        self._lock, self.left = Lock(), cast("Any", None)

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            token = _inside.set(False)
            try:
                yield
            finally:
                _inside.reset(token)


class WhileAnyInside:
    """A process-wide setting as a context manager: valid while any thread is inside.

    set_up: makes the setting and returns the function that reverts it. The last thread to leave reverts it.
    """

    def __init__(self, set_up: Callable[[], Callable[[], None]]) -> None:
        self._set_up, self._lock, self._inside = set_up, Lock(), 0
        self._undo: Callable[[], None]

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if not self._inside:
                self._undo = self._set_up()
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if not self._inside:
                    self._undo()


def _ignore_warnings() -> Callable[[], None]:
    filters = warnings.catch_warnings()
    filters.__enter__()
    warnings.simplefilter("ignore")
    return partial(filters.__exit__, None, None, None)


no_warnings = WhileAnyInside(_ignore_warnings)
