"""Processes of a fleet: how they start, and what happens when one of them dies.

Little but the standard library is imported here: the workers' imports, which take longest, begin first of all.
"""

from __future__ import annotations

import importlib
import multiprocessing
import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

MACHINES = "machines"  # folder of the machines' outputs, below OUT
WORKER = "errpipe.verbs._fleet_worker"
ATTEMPTS = 3  # of a machine whose worker dies; the last one alone in its pool, so that no other can be the cause
Task = tuple[str, str, list[str], str]  # pipeline, machine, its keys of the pipeline, OUT


def run_machine(*task: Any) -> dict[str, Any]:
    """`_fleet_machine.run_machine`, which only a worker imports."""
    result: dict[str, Any] = importlib.import_module("errpipe.verbs._fleet_machine").run_machine(*task)
    return result


def failed_result(task: Sequence[Any], attempts: int) -> dict[str, Any]:
    from errpipe.pipeline.lock import leftover_note

    message = f"its worker was killed {attempts} times (out of memory?)"
    message += leftover_note(Path(task[3]) / MACHINES / task[1], ())
    nothing = {"responses": {}, "drift": [], "model": "", "seconds": 0.0, "peak_mb": 0.0}
    return nothing | {"name": task[1], "state": "failed", "message": message, "attempts": attempts}


def in_processes(tasks: Sequence[Task], jobs: int) -> Iterator[dict[str, Any]]:
    """Results as they come. When a worker dies the pool is made anew and its unfinished machines are tried again."""
    attempts = dict.fromkeys((task[1] for task in tasks), 0)
    waiting = list(tasks)
    count = jobs or os.cpu_count() or 1
    while waiting:
        last_attempts = [t for t in waiting if attempts[t[1]] >= ATTEMPTS - 1]
        batch = last_attempts[:1] or waiting
        ended: set[str] = set()
        for task, result in _one_pool(batch, min(count, len(batch)), attempts):
            ended.add(task[1])
            yield result
        for task in batch:
            if task[1] not in ended and attempts[task[1]] >= ATTEMPTS:
                ended.add(task[1])
                yield failed_result(task, attempts[task[1]])
        waiting = [t for t in waiting if t[1] not in ended]


def _one_pool(tasks: Sequence[Task], count: int, attempts: dict[str, int]) -> Iterator[tuple[Task, dict[str, Any]]]:
    """Results of one pool of processes until it is through or one of its workers dies; `attempts` is counted up."""
    with ProcessPoolExecutor(count, start_imports(), prepare, (dict(os.environ),)) as pool:
        waiting = list(reversed(tasks))
        running: dict[Future[dict[str, Any]], Task] = {}
        try:
            while waiting or running:
                while waiting and len(running) <= count:  # one lies ready; more would be lost with a worker
                    task = waiting.pop()
                    running[pool.submit(run_machine, *task)] = task
                    attempts[task[1]] += 1
                future = next(as_completed(running))
                result = future.result()
                task = running.pop(future)
                yield task, result | {"attempts": attempts[task[1]]}
        except BrokenProcessPool:
            return


def start_imports() -> Any:
    """How workers are made: copies of a process that has imported what they need, and that begins to do so here.

    Where the system cannot copy a process, each worker imports for itself.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")
    from multiprocessing import forkserver, resource_tracker

    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["__main__", WORKER])
    resource_tracker.ensure_running()
    held = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})  # until the worker's file says what it does
    try:
        forkserver.ensure_running()
    except ChildProcessError:  # a copy of a process that has one: it is not the copy's to ask
        return multiprocessing.get_context("spawn")
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, held)
    return context


def prepare(environment: dict[str, str]) -> None:
    """Before a worker's first machine: the caller's environment, which may be another than the fork server's."""
    os.environ.update(environment)
    importlib.import_module(WORKER)
