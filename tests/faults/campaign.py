"""Many sequences of faults through every evaluator: `python -m tests.faults.campaign [COUNT [NAME]]` (`make faults`).

Prints a table of what was found and writes it into `docs/safety.md`, between its two marks.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import iec_st
from tests.e2e.linuxcnc import session
from tests.faults import hal, runners, sequences
from tests.faults.sequences import Part
from tests.unit.targets.c import test_c_runtime as c
from tests.unit.targets.st import matiec, translate
from tests.unit.targets.st import test_iec_st as st

PAGE = Path(__file__).parents[2] / "docs" / "safety.md"
BEGIN, END = "<!-- figures: make faults -->\n", "<!-- end of figures -->\n"
COUNT = 10_000
MATIEC, HAL = (
    "Structured Text, MATIEC",
    "LinuxCNC, HAL component",
)  # their rows stay as they were where those are absent

HEAD = (
    "| evaluator | sequences | cycles | largest step, of the slew | largest size, of the magnitude "
    "| off after one bad sample of X, um | off at the end, um | unsafe |"
)


@dataclass
class Result:
    """What some sequences did: largest step and size in parts of their limits, um off, unsafe ones."""

    sequences: int = 0
    cycles: int = 0
    step: float = 0.0
    size: float = 0.0
    once: float = 0.0
    off: float = 0.0
    unsafe: int = 0

    def add(self, parts: list[Part], corrections: np.ndarray, single: bool = False) -> None:
        """One more sequence."""
        judgement = sequences.judge(parts, corrections)
        self.sequences += 1
        self.cycles += len(corrections)
        self.step, self.size = max(self.step, judgement.step), max(self.size, judgement.size)
        self.once, self.off = max(self.once, judgement.once), max(self.off, judgement.off)
        self.unsafe += not judgement.is_safe(single)


def run(
    evaluators: Mapping[str, Callable[[list[Part]], np.ndarray]], count: int, every: Mapping[str, int] | None = None
) -> dict[str, Result]:
    """Sequences 0 to count - 1 through each evaluator, or every so many of them."""
    by_name = {name: Result() for name in evaluators}
    for seed in range(count):
        parts = sequences.sequence(seed)
        for name, evaluator in evaluators.items():
            if seed % (every or {}).get(name, 1) == 0:
                by_name[name].add(parts, evaluator(parts), single=name == "C, single")
    return by_name


def in_linuxcnc(count: int) -> Result:
    """The same seeds in LinuxCNC's realtime thread; a sequence whose bits are not the kernels' is unsafe too."""
    result = Result()
    for seeds in hal.batches(count):
        for parts, corrections in hal.corrections(seeds):
            unsafe = result.unsafe
            result.add(parts, corrections)
            result.unsafe = max(result.unsafe, unsafe + hal.differ(parts, corrections))
    return result


def compiled(name: str, folder: Path, table: CompensationTable | None = None) -> runners.Shared:
    """The C runtime or the function blocks as a shared library; blocks with room for a table."""
    folder.mkdir(exist_ok=True)
    if name.startswith("Structured Text"):
        room = iec_st.capacity_for(table or sequences.table(0))
        units = [iec_st.unit(unit, room) for unit in st.UNITS]
        if name == MATIEC:
            return runners.Shared(matiec.build(folder, units))
        st.Block(folder, translate.by_lines(units))
        return runners.Shared(folder / "st.so")
    single = name == "C, single"
    built = c.build(folder, *(["-DECT_SINGLE"] if single else []))
    return runners.Shared(built, np.float32 if single else np.float64)


def main(count: int, only: str = "") -> int:
    """Run, print, write; 1 where a sequence was unsafe. only: words of an evaluator's name; the other rows stay."""
    names = ["C, double", "C, single", "Structured Text", *([MATIEC] if matiec.compiler() else [])]
    with tempfile.TemporaryDirectory() as folder:
        evaluators = {"reference": runners.by_reference, "kernels (Numba)": runners.by_numba}
        evaluators |= {n: compiled(n, Path(folder) / str(k)) for k, n in enumerate(names) if only in n}
        # The reference is slow Python: the kernels, which run every sequence, give its bits (test_faults.py).
        result = run({n: e for n, e in evaluators.items() if only in n}, count, {"reference": 50})
    if only in HAL and not session.missing():
        result[HAL] = in_linuxcnc(count)
    before, rest = PAGE.read_text(encoding="utf-8").split(BEGIN)
    old, after = rest.split(END)
    rows = {row.split(" | ")[0].removeprefix("| "): row for row in old.splitlines()[2:]}
    rows |= {
        name: f"| {name} | {r.sequences} | {r.cycles} | {r.step:.6f} | {r.size:.6f} "
        f"| {r.once:.4f} | {r.off:.4f} | {r.unsafe} |"
        for name, r in result.items()
    }
    lines = [HEAD, "| --- | --- | --- | --- | --- | --- | --- | --- |", *rows.values()]
    print("\n".join(lines))
    PAGE.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after, encoding="utf-8")
    return int(any(r.unsafe for r in result.values()))


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT, " ".join(sys.argv[2:])))
