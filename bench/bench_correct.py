"""How fast NC programs are corrected: python -m bench.bench_correct.

MB of program read, and written, per second of processor, by a table of 21 components; seed 1. What is written
grows where moves are split into segments (25 mm, chord error 1 um), so the second figure then says more.
"""

from __future__ import annotations

import resource
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from bench.bench_tables import machine
from bench.figure import Figure, main, seconds, spread
from errpipe.tables import ect
from errpipe.verbs.correct import correct

SIZE, LARGE = 2_000_000, 50_000_000  # bytes of a program
ROUNDS = 5
AIM = 2.0  # MB read per second
HEAD = "G90 G21 G54\nG0 X0 Y0 Z0 A0 B0\n"
Lines = Callable[[np.random.Generator], str]


def short_moves(rng: np.random.Generator) -> str:
    """Steps of about 0.5 mm along a smooth path."""
    path = 200 + 100 * np.sin(np.cumsum(rng.uniform(0, 0.005, (2000, 3)), axis=0) + np.arange(3))
    return "".join(f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f} F800\n" for x, y, z in path)


def five_axes(rng: np.random.Generator) -> str:
    """The same with two rotary axes, between -90 and 90 deg so that no move is the long way round, and line numbers."""
    path = 100 * np.sin(np.cumsum(rng.uniform(0, 0.005, (2000, 5)), axis=0) + np.arange(5))
    path = path * [1, 1, 1, 0.9, 0.9] + [200, 200, 200, 0, 0]
    words = [" ".join(f"{axis}{v:.3f}" for axis, v in zip("XYZAB", row, strict=True)) for row in path]
    return "".join(f"N{n} G1 {row}\n" for n, row in enumerate(words))


def long_moves(rng: np.random.Generator) -> str:
    """Moves of 200 mm to and fro, each of eight or nine segments."""
    ends = enumerate(rng.uniform(0, 9, 2000))
    return "".join(f"G1 X{100 + 200 * (n % 2)}.{n % 7:03} Y{y:.3f}\n" for n, y in ends)


def arcs(rng: np.random.Generator) -> str:
    """Half circles of 1 mm to 10 mm radius, 25 to 70 segments each, and a short line to each pair."""
    lines = []
    for r in np.round(rng.uniform(1, 10, 500), 3):
        lines += [f"G1 X100 Y{r:.3f}", f"G2 X{100 + 2 * r:.3f} Y{r:.3f} I{r:.3f} J0", f"G3 X100 Y{r:.3f} I{-r:.3f} J0"]
    return "\n".join(lines) + "\n"


def program(path: Path, lines: Lines, size: int) -> Path:
    """Write a program of so many bytes or a few more."""
    rng = np.random.default_rng(1)
    with path.open("w") as file:
        file.write(HEAD)
        while file.tell() < size:
            file.write(lines(rng))
    return path


def peak_mb() -> float:
    """Largest memory of this process so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def figures() -> list[Figure]:
    """Rates of four kinds of program, and what a long one takes in memory."""
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        ect.write(machine(), folder / "table.ect")

        def run(source: Path) -> None:
            correct(source, folder / "table.ect", folder / "out.ngc", {}, start="0,0,0")

        for kind in (short_moves, five_axes, long_moves, arcs):
            source, what = program(folder / "in.ngc", kind, SIZE), kind.__name__.replace("_", " ")
            run(source)
            times = seconds(lambda source=source: run(source), ROUNDS)
            read, written = (p.stat().st_size / 1e6 / times[0] for p in (source, folder / "out.ngc"))
            rows.append(Figure(f"{what}: read", read, "MB/s", spread(times), AIM, at_least=True))
            rows.append(Figure(f"{what}: written", written, "MB/s", spread(times), at_least=True))
        before = peak_mb()
        times = seconds(lambda: run(program(folder / "in.ngc", short_moves, LARGE)), 1)
        rows.append(Figure("50 MB of short moves: memory above that of 2 MB", peak_mb() - before, "MB", aim=20.0))
    return rows


if __name__ == "__main__":
    sys.exit(main(figures))
