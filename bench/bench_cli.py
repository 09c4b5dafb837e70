"""How long the command line takes: `errpipe --help`, a check, and a run that finds nothing to do.

Each beside a bare `python -c pass`, best of several, in fresh processes.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

PIPELINE = Path(__file__).parents[1] / "pipelines" / "ball-screw-axis.yaml"
ROUNDS = 7
WANTED = {"errpipe --help": 0.2, "run with nothing to do": 0.5}


def best(*arguments: str) -> float:
    """Shortest wall time of a fresh interpreter, s."""
    times = []
    for _ in range(ROUNDS):
        start = perf_counter()
        subprocess.run([sys.executable, *arguments], check=True, capture_output=True)
        times.append(perf_counter() - start)
    return min(times)


def main() -> int:
    cli = ("-m", "errpipe.cli.app")
    with tempfile.TemporaryDirectory() as out:
        run = (*cli, "run", str(PIPELINE), "--out", out)
        start = perf_counter()
        subprocess.run([sys.executable, *run], check=True, capture_output=True)
        first = perf_counter() - start
        found = {
            "errpipe --help": best(*cli, "--help"),
            "check of a pipeline": best(*cli, "check", str(PIPELINE)),
            "run with nothing to do": best(*run),
        }
    bare = best("-c", "pass")
    print(f"  {'python -c pass':28} {bare:7.3f} s")
    for name, took in found.items():
        aim = f", wanted: below {WANTED[name]} s" if name in WANTED else ""
        print(f"  {name:28} {took:7.3f} s  {took / bare:6.1f} x python -c pass{aim}")
    print(f"  {'the first run':28} {first:7.3f} s  {first / found['run with nothing to do']:6.1f} x nothing to do")
    return int(any(found[name] > wanted for name, wanted in WANTED.items()))


if __name__ == "__main__":
    sys.exit(main())
