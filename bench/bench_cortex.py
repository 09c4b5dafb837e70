"""What the C runtime costs on a Cortex-M4: python -m bench.bench_cortex. Code, working memory, instructions per cycle.

The table of `bench_tables` (21 components, 8 lagged sensors, synthesis) in single precision with hard floats, in
QEMU's mps2-an386, which counts one tick an instruction; caches and wait states of flash are not in it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from bench.bench_tables import machine
from bench.figure import Figure, main
from errpipe.domain.table import CompensationTable
from errpipe.tables import bounds, ect

ROOT = Path(__file__).parents[1]
RUNTIME = ROOT / "errpipe" / "tables" / "runtime"
BOARD = ROOT / "tests" / "unit" / "targets" / "c" / "arm"
NEEDED = ("arm-none-eabi-gcc", "arm-none-eabi-size", "qemu-system-arm")
CPU = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
COMMON = ["-std=c99", "-ffp-contract=off", "-DECT_SINGLE", f"-I{RUNTIME}"]
CYCLES = 60
# Bytes at most: 15 % above version 1 of the format (14.4 kB at -O2, 11.6 kB at -Os).
AIMS = {"code_bytes_O2": 16_560, "code_bytes_Os": 13_340, "instructions_per_cycle": 3_500}


def case_header(
    table: CompensationTable,
    readings: np.ndarray,
    folder: Path,
    work: int,
    fresh: np.ndarray | None = None,
    mode: np.ndarray | None = None,
) -> None:
    """The table, its readings and which of them are fresh, shape (cycles, inputs), and the modes, as `case.h`.

    Without `fresh` all readings are, without `mode` the compensation is on.
    """
    fresh = np.ones(readings.shape, dtype=int) if fresh is None else fresh
    mode = np.ones(len(readings), dtype=int) if mode is None else mode
    with np.errstate(over="ignore"):
        single = readings.astype(np.float32)
    rows = ",\n".join("{" + ", ".join(map(_number, row)) + "}" for row in single)
    flags = ",\n".join("{" + ", ".join(map(str, row)) + "}" for row in fresh)
    (folder / "case.h").write_text(
        f"#define INPUTS {len(table.inputs)}\n#define CYCLES {len(readings)}\n#define WORK {work}\n"
        f"static const unsigned char TABLE[] = {{{', '.join(map(str, ect.dumps(table)))}}};\n"
        f"static const float READINGS[CYCLES][INPUTS] = {{{rows}}};\n"
        f"static const unsigned char FRESH[CYCLES][INPUTS] = {{{flags}}};\n"
        f"static const unsigned char MODE[CYCLES] = {{{', '.join(map(str, mode))}}};\n"
    )


def _number(value: np.float32) -> str:
    """A number of single precision in C."""
    if np.isnan(value):
        return "NAN"
    return f"{float(value)!r}f" if np.isfinite(value) else ("-" if value < 0 else "") + "INFINITY"


def _run(*command: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, check=True, timeout=120)


def emulated(folder: Path, model: str, cpu: list[str], common: list[str]) -> subprocess.CompletedProcess[str]:
    """What the board's program says of `case.h`: corrections on standard output, instructions on standard error."""
    start = ["-nostartfiles", "--specs=rdimon.specs", "-T", BOARD / "mps2.ld", BOARD / "startup.c"]
    sources = [RUNTIME / "ect.c", BOARD / "main.c"]
    _run("arm-none-eabi-gcc", *cpu, *common, *start, *sources, "-o", folder / "board.elf")
    quiet = ["-nographic", "-monitor", "none", "-serial", "none"]
    semihosting = ["-semihosting-config", "enable=on,target=native", "-icount", "shift=0"]
    return _run("qemu-system-arm", "-M", model, *quiet, *semihosting, "-kernel", folder / "board.elf")


def instructions(said: str) -> tuple[float, float]:
    """(of a cycle whose readings stay, of the slowest cycle) from the program's standard error."""
    per_cycle, slowest = re.findall(r"\d+", said)
    return float(per_cycle), float(slowest)


def bench_cortex_m4() -> dict[str, float]:
    """21 components and 8 lagged sensors on a Cortex-M4, single precision, hard floating point."""
    table, pair = machine(thermal=True), {}
    rng = np.random.default_rng(0)
    readings = np.tile(np.array([i.default for i in table.inputs], dtype=np.float32), (CYCLES, 1))
    readings[:, :3] = rng.uniform(0, 600, (CYCLES, 3))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for level in ("O2", "Os"):
            command = ["arm-none-eabi-gcc", *CPU, *COMMON, f"-{level}", "-c", RUNTIME / "ect.c"]
            _run(*command, "-o", folder / f"{level}.o")
            text, data, *_ = _run("arm-none-eabi-size", folder / f"{level}.o").stdout.splitlines()[1].split()
            pair[f"code_bytes_{level}"] = float(text) + float(data)
        case_header(table, readings, folder, work=32_000)
        said = emulated(folder, "mps2-an386", CPU, [*COMMON, "-O2", f"-I{folder}"]).stderr
    pair["work_bytes"] = float(bounds.work_bytes(table, real=4))
    pair["table_bytes"] = float(len(ect.dumps(table)))
    pair["instructions_per_cycle"], pair["instructions of the slowest cycle"] = instructions(said)
    pair["instructions at most, from the table"] = float(bounds.cortex_m4_instructions(table))
    return pair


def figures() -> list[Figure]:
    """Code, working memory and instructions per cycle; none where the compiler or the emulator is not installed."""
    if lacking := [name for name in NEEDED if shutil.which(name) is None]:
        print(f"skipped: {', '.join(lacking)} not installed")
        return []
    return [
        Figure(f"Cortex-M4, {what.replace('_', ' ')}", value, "1", aim=AIMS.get(what))
        for what, value in bench_cortex_m4().items()
    ]


if __name__ == "__main__":
    sys.exit(main(figures))
