"""A fleet on one worker process and on two: wall time, time and peak memory of each machine. Needs two idle cores."""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from bench.figure import Figure, main
from errpipe.stages.fleet import TIMES

MACHINES = 200
AIM = 1.8  # times faster with two workers


def figures() -> list[Figure]:
    """Two workers beside one, and what a machine takes; each by a command of its own, for workers share a start."""
    from tests.e2e.fleet.test_fleet import site

    took, times = {}, []
    with tempfile.TemporaryDirectory() as name:
        file = site(Path(name) / "site", MACHINES)
        for jobs in (1, 2):
            out = Path(name) / f"out{jobs}"
            command = [sys.executable, "-m", "errpipe", "fleet", str(file), "--out", str(out), "--jobs", str(jobs)]
            start = perf_counter()
            subprocess.run(command, capture_output=True)  # exit 4: one machine of the site has a broken recording
            took[jobs] = perf_counter() - start
            times = list(csv.DictReader((out / TIMES).open()))
    seconds, memory = (np.array([float(t[key]) for t in times]) for key in ("seconds", "peak_mb"))
    return [
        Figure(f"{MACHINES} machines, one worker over two", took[1] / took[2], "x", aim=AIM, at_least=True),
        Figure(f"{MACHINES} machines, one worker", took[1], "s"),
        Figure("a machine, median", float(np.median(seconds)), "s"),
        Figure("a machine, largest", float(seconds.max()), "s"),
        Figure("peak memory of a worker", float(memory.max()), "MB"),
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
