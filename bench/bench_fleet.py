"""A fleet on one worker process and on two: wall time, time and peak memory of each machine. Needs two idle cores."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from time import perf_counter

import numpy as np

from errpipe.stages.fleet import fleet
from tests.e2e.fleet.test_fleet import site

MACHINES = 200
AIM = 1.8  # times faster with two workers


def main() -> int:
    took, times = {}, {}
    with tempfile.TemporaryDirectory() as name:
        file = site(Path(name) / "site", MACHINES)
        for jobs in (1, 2):
            start = perf_counter()
            found = fleet(file, Path(name) / f"out{jobs}", jobs)
            took[jobs], times = perf_counter() - start, found["times"]
    seconds, memory = (np.array([t[key] for t in times.values()]) for key in ("seconds", "peak_mb"))
    ratio = took[1] / took[2]
    print(
        f"  {MACHINES} machines, 1 worker {took[1]:.1f} s, 2 workers {took[2]:.1f} s: {ratio:.2f} times (wanted: {AIM})"
    )
    print(f"  a machine: median {np.median(seconds):.2f} s, largest {seconds.max():.2f} s, peak {memory.max():.0f} MB")
    return int(ratio < AIM)


if __name__ == "__main__":
    sys.exit(main())
