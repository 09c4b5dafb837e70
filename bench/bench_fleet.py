"""A fleet on one worker process and on two, in turns: wall time, time and peak memory of each machine. Needs two idle
cores.

Beside it what two cores give at all here, in the same turns: two fleets of one worker each, which share nothing but the
cores' caches and memory, at once.
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
HALF_YEAR = 180  # runs of a machine, of half a year
AIM = 1.8  # times faster with two workers, of machines of half a year
SIZES = {HALF_YEAR: (AIM, 3), 6: (None, 3), 1000: (None, 1)}  # runs -> aim, and turns, the medians of which stand here
ROWS = 22  # of a run


def figures() -> list[Figure]:
    """Two workers beside one, and what a machine takes; each by a command of its own, for workers share a start.

    The start and the report, about 1.5 s of one process, are no shorter with two workers: the less a machine takes, the
    more of the whole they are. So the aim is that of machines of half a year of runs; those of six, and of a
    thousand, stand beside them.
    """
    from tests.e2e.fleet.test_fleet import site

    rows = []
    with tempfile.TemporaryDirectory() as name:
        here = Path(name)
        for runs, (aim, rounds) in SIZES.items():
            file = site(here / f"site{runs}", MACHINES, runs)
            turns = np.array([turn(file, here / f"{runs}-{k}") for k in range(rounds)])
            faster, ceiling = turns[:, 0] / turns[:, 1], 2.0 * turns[:, 0] / turns[:, 2]
            times = list(csv.DictReader((here / f"{runs}-0" / "two" / TIMES).open()))
            seconds, memory = (np.array([float(t[key]) for t in times]) for key in ("seconds", "peak_mb"))
            what = f"{MACHINES} machines of {runs} runs, {ROWS * runs} rows"
            span = float(np.ptp(faster) / np.median(faster))
            rows += [
                Figure(f"{what}, one worker over two", float(np.median(faster)), "x", span, aim, at_least=True),
                Figure(f"{what}: two such fleets at once, over one after the other", float(np.median(ceiling)), "x"),
                Figure(f"{what}, one worker", float(np.median(turns[:, 0])), "s"),
                Figure(f"{what}, two workers", float(np.median(turns[:, 1])), "s"),
                Figure(f"one of {runs} runs, median", float(np.median(seconds)), "s"),
                Figure(f"one of {runs} runs, largest", float(seconds.max()), "s"),
                Figure(f"one of {runs} runs, peak memory of a worker", float(memory.max()), "MB"),
            ]
    return rows


def turn(file: Path, out: Path) -> tuple[float, float, float]:
    """Wall time of one worker, of two, and of two fleets of one worker each at once, s."""
    return run(file, [out / "one"], 1), run(file, [out / "two"], 2), run(file, [out / "apart", out / "other"], 1)


def run(file: Path, outs: list[Path], jobs: int) -> float:
    """Wall time of one command for each folder, all at once, s; exit 4: one machine has a broken recording."""
    command, start = [sys.executable, "-m", "errpipe", "fleet", str(file), "--jobs", str(jobs), "--out"], perf_counter()
    null = subprocess.DEVNULL
    for child in [subprocess.Popen([*command, str(out)], stdout=null, stderr=null) for out in outs]:
        child.wait()
    return perf_counter() - start


if __name__ == "__main__":
    sys.exit(main(figures))
