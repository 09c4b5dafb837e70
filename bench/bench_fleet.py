"""A fleet on one worker process and on two: wall time, time and peak memory of each machine. Needs two idle cores.

Beside it what two cores give at all here: two fleets of one worker each, which share nothing but the cores' caches and
memory, at once.
"""

from __future__ import annotations

import csv
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from bench.figure import Figure, main
from errpipe.verbs.fleet import TIMES

MACHINES = 200
LONGER = 180  # runs of a machine, of half a year
AIM = 1.8  # times faster with two workers


def figures() -> list[Figure]:
    """Two workers beside one, and what a machine takes; each by a command of its own, for workers share a start.

    The start and the report, about 2 s of one process, are no shorter with two workers: the less a machine takes, the
    more of the whole they are. So machines of half a year of runs stand beside those of six.
    """
    from tests.e2e.fleet.test_fleet import site

    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        file, longer = site(here / "site", MACHINES), site(here / "longer", MACHINES, LONGER)
        one, two = (run(file, [here / f"out{jobs}"], jobs) for jobs in (1, 2))
        times = list(csv.DictReader((here / "out2" / TIMES).open()))
        apart = run(file, [here / "one", here / "other"], 1)
        longer_one, longer_two = (run(longer, [here / f"longer{jobs}"], jobs) for jobs in (1, 2))
    seconds, memory = (np.array([float(t[key]) for t in times]) for key in ("seconds", "peak_mb"))
    return [
        Figure(f"{MACHINES} machines, one worker over two", one / two, "x", aim=AIM, at_least=True),
        Figure(f"the same, {LONGER} runs a machine", longer_one / longer_two, "x", aim=AIM, at_least=True),
        Figure("two fleets of one worker at once, over one after the other", 2.0 * one / apart, "x"),
        Figure(f"{MACHINES} machines, one worker", one, "s"),
        Figure("the same, two workers", two, "s"),
        Figure("a machine, median", float(np.median(seconds)), "s"),
        Figure("a machine, largest", float(seconds.max()), "s"),
        Figure("peak memory of a worker", float(memory.max()), "MB"),
    ]


def run(file: Path, outs: list[Path], jobs: int) -> float:
    """Wall time of one command for each folder, all at once, s; exit 4: one machine has a broken recording."""
    command, start = [sys.executable, "-m", "errpipe", "fleet", str(file), "--jobs", str(jobs), "--out"], perf_counter()
    null = subprocess.DEVNULL
    for child in [subprocess.Popen([*command, str(out)], stdout=null, stderr=null) for out in outs]:
        child.wait()
    return perf_counter() - start


if __name__ == "__main__":
    sys.exit(main(figures))
