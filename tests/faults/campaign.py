"""Many sequences of faults through every evaluator: `python -m tests.faults.campaign [COUNT]` (`make faults`).

Prints a table of what was found and writes it into `docs/safety.md`, between its two marks.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from errpipe.targets import iec_st
from tests.faults import runners, sequences
from tests.faults.sequences import Part
from tests.unit.targets.c import test_c_runtime as c
from tests.unit.targets.st import test_iec_st as st
from tests.unit.targets.st import translate

PAGE = Path(__file__).parents[2] / "docs" / "safety.md"
BEGIN, END = "<!-- figures: make faults -->\n", "<!-- end of figures -->\n"
COUNT = 10_000


@dataclass(frozen=True)
class Result:
    """What some sequences did: largest step and size in parts of their limits, um off at the end, unsafe ones."""

    sequences: int
    cycles: int
    step: float
    size: float
    off: float
    unsafe: int


def run(evaluator: Callable[[list[Part]], np.ndarray], count: int, single: bool = False) -> Result:
    """Sequences 0 to count - 1 through one evaluator."""
    cycles = unsafe = 0
    step = size = off = 0.0
    for seed in range(count):
        parts = sequences.sequence(seed)
        found = sequences.judge(parts, evaluator(parts))
        cycles += sum(len(p.mode) for p in parts)
        step, size, off = max(step, found.step), max(size, found.size), max(off, found.off)
        unsafe += not found.is_safe(single)
    return Result(count, cycles, step, size, off, unsafe)


def compiled(name: str, folder: Path) -> runners.Shared:
    """The C runtime or the function blocks as a shared library."""
    if name == "Structured Text":
        room = iec_st.room_for(sequences.table(0))
        code = translate.by_lines([iec_st.unit(unit, room) for unit in st.UNITS])
        st.Block(folder, code)
        return runners.Shared(folder / "st.so")
    single = name == "C, single"
    built = c.build(folder, *(["-DECT_SINGLE"] if single else []))
    return runners.Shared(built, np.float32 if single else np.float64)


def main(count: int) -> int:
    """Run, print, write; 1 where a sequence was unsafe."""
    lines = [
        "| evaluator | sequences | cycles | largest step, of the slew | largest size, of the magnitude "
        "| off at the end, um | unsafe |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    # The reference is slow Python: its sequences are the first ones, and the kernels give its bits (test_faults.py).
    shares = {"reference": 50, "kernels (Numba)": 1, "C, double": 1, "C, single": 1, "Structured Text": 10}
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, share) in enumerate(shares.items()):
            own = Path(folder) / str(number)
            own.mkdir()
            plain = {"reference": runners.by_reference, "kernels (Numba)": runners.by_numba}
            evaluator = plain.get(name) or compiled(name, own)
            found = run(evaluator, max(count // share, 1), name == "C, single")
            bad += found.unsafe
            lines.append(
                f"| {name} | {found.sequences} | {found.cycles} | {found.step:.6f} | {found.size:.6f} "
                f"| {found.off:.4f} | {found.unsafe} |"
            )
            print(lines[-1], flush=True)
    text = PAGE.read_text(encoding="utf-8")
    before, rest = text.split(BEGIN)
    _, after = rest.split(END)
    PAGE.write_text(before + BEGIN + "\n".join(lines) + "\n" + END + after, encoding="utf-8")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else COUNT))
