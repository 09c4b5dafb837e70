"""How long the command line takes: `errpipe --help`, a check, and a run that finds nothing to do.

Each beside a bare `python -c pass`, best of several, in fresh processes.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from functools import partial
from pathlib import Path
from time import perf_counter

from bench.figure import Figure, main, seconds, spread

PIPELINE = Path(__file__).parents[1] / "pipelines" / "ball-screw-axis.yaml"
ROUNDS = 7
WANTED = {
    "errpipe --help": 0.2,
    "check of a pipeline": 0.3,
    "run with nothing to do": 0.3,
    "demo, warm": 4.0,
    "demo, cold": 12.0,
}


def fresh(*arguments: str, **environment: str) -> None:
    """Run a fresh interpreter."""
    subprocess.run([sys.executable, *arguments], check=True, capture_output=True, env={**os.environ, **environment})


def cold_demo(folder: Path) -> float:
    """Wall time of the demo where nothing is compiled yet, s."""
    demo = ("-m", "errpipe.cli.app", "demo", "--out", str(folder))
    return seconds(partial(fresh, *demo, NUMBA_CACHE_DIR=f"{folder}-compiled"), 1, perf_counter)[0]


def figures() -> list[Figure]:
    """Wall times of verbs beside a bare interpreter."""
    cli = ("-m", "errpipe.cli.app")
    bare = seconds(partial(fresh, "-c", "pass"), ROUNDS, perf_counter)
    with tempfile.TemporaryDirectory() as out:
        run = (*cli, "run", str(PIPELINE), "--out", f"{out}/run")
        fresh(*run)
        times = {
            "errpipe --help": seconds(partial(fresh, *cli, "--help"), ROUNDS, perf_counter),
            "check of a pipeline": seconds(partial(fresh, *cli, "check", str(PIPELINE)), ROUNDS, perf_counter),
            "run with nothing to do": seconds(partial(fresh, *run), ROUNDS, perf_counter),
            "demo, warm": sorted(
                seconds(partial(fresh, *cli, "demo", "--out", f"{out}/{k}"), 1, perf_counter)[0] for k in range(3)
            ),
            "demo, cold": sorted(cold_demo(Path(out) / f"cold{k}") for k in range(2)),
        }
    lacks = "anything"
    return [
        Figure(name, t[0], "s", spread(t), WANTED[name], peer="python -c pass", times=bare[0] / t[0], lacks=lacks)
        for name, t in times.items()
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
