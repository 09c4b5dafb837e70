"""A measured figure, its aim and its peers; and how every bench prints and hands on what it measured."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path


@dataclass(frozen=True)
class Figure:
    """One row of docs/performance.md.

    spread: how far repeats of the run lay apart, relative to the value. aim: `value` at most this, or at least where
    `at_least`. peer: what was run beside it; times: the peer's cost over ours; lacks: what the peer does not do.
    """

    what: str
    value: float
    unit: str
    spread: float = 0.0
    aim: float | None = None
    at_least: bool = False
    peer: str = ""
    times: float | None = None
    lacks: str = ""

    @property
    def missed(self) -> bool:
        """Whether the aim is missed."""
        return self.aim is not None and (self.value < self.aim if self.at_least else self.value > self.aim)

    def line(self) -> str:
        """The figure as a line of text."""
        aim = "" if self.aim is None else f"   aim: {'at least' if self.at_least else 'at most'} {self.aim:g}"
        peer = f"   {self.peer}: {self.times:.3g} times the cost" if self.times is not None else ""
        return f"  {self.what:52} {self.value:10.4g} {self.unit:10}{peer}{aim}{'   MISSED' if self.missed else ''}"


def seconds(run: Callable[[], object], repeats: int = 5, clock: Callable[[], float] = time.thread_time) -> list[float]:
    """Time of each of several runs, s, shortest first."""
    times = []
    for _ in range(repeats):
        begin = clock()
        run()
        times.append(clock() - begin)
    return sorted(times)


def asked_rows(otherwise: int) -> int:
    """Rows that `--million N` asks for, else `otherwise`."""
    return int(sys.argv[sys.argv.index("--million") + 1]) * 1_000_000 if "--million" in sys.argv else otherwise


def spread(times: list[float]) -> float:
    """How far the middle run lay above the shortest, relative to it."""
    return times[len(times) // 2] / times[0] - 1.0


def main(figures: Callable[[], list[Figure]]) -> int:
    """Measure and print; with `--json FILE` also write. A missed aim is no failure."""
    values = figures()
    for figure in values:
        print(figure.line())
    if "--json" in sys.argv:
        Path(sys.argv[sys.argv.index("--json") + 1]).write_text(json.dumps([asdict(f) for f in values]), "utf-8")
    return 0
