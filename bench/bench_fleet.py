"""A fleet on one worker process and on two: wall time, time and peak memory of each machine. Needs two idle cores."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from bench.figure import Figure, main
from errpipe.stages.fleet import fleet

MACHINES = 200
AIM = 1.8  # times faster with two workers


def figures() -> list[Figure]:
    """Two workers beside one, and what a machine takes."""
    from tests.e2e.fleet.test_fleet import site  # here, for workers import this module as they start

    took, times = {}, {}
    with tempfile.TemporaryDirectory() as name:
        file = site(Path(name) / "site", MACHINES)
        for jobs in (1, 2):
            start = perf_counter()
            report = fleet(file, Path(name) / f"out{jobs}", jobs)
            took[jobs], times = perf_counter() - start, report["times"]
    seconds, memory = (np.array([t[key] for t in times.values()]) for key in ("seconds", "peak_mb"))
    return [
        Figure(f"{MACHINES} machines, one worker over two", took[1] / took[2], "x", aim=AIM, at_least=True),
        Figure(f"{MACHINES} machines, one worker", took[1], "s"),
        Figure("a machine, median", float(np.median(seconds)), "s"),
        Figure("a machine, largest", float(seconds.max()), "s"),
        Figure("peak memory of a worker", float(memory.max()), "MB"),
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
