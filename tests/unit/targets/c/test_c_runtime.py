"""The C runtime: warnings are errors, equal to the Numba cycle to the bit, never past the end of a damaged table."""

from __future__ import annotations

import ctypes
import os
import random
import re
import shutil
import struct
import subprocess
import zlib
from pathlib import Path

import numpy as np
import pytest

from bench import bench_cortex
from bench.bench_tables import machine
from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import VerifyError
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.tables import bounds, ect
from errpipe.targets.c_runtime import CRuntime
from tests.compiled import compile_once
from tests.unit.stages.test_readings import model
from tests.unit.tables.made import everything, numba_stream, stimulus, ten_um_too_long

HERE = Path(__file__).parent
RUNTIME = Path(tables.__file__).parent / "runtime"
STRICT = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror", "-Wconversion", "-O2", "-ffp-contract=off"]
COMPILERS = [name for name in ("gcc", "clang") if shutil.which(name)]
pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.skipif(not COMPILERS, reason="no C compiler (gcc, clang) on this machine"),
]


def run(*command, **more):
    return subprocess.run([str(c) for c in command], check=True, capture_output=True, text=True, **more)


class Library:
    """The runtime and the tests' driver as a shared library."""

    def __init__(self, path: Path, real=np.float64):
        self.dll = ctypes.CDLL(str(path))
        self.dll.mutate.restype = ctypes.c_size_t
        self.dll.ect_work_size.restype = ctypes.c_size_t
        self.real = real

    def load(self, data: bytes) -> tuple[int, int]:
        where = ctypes.c_uint32()
        return self.dll.load(data, ctypes.c_size_t(len(data)), ctypes.byref(where)), where.value

    def stream(self, table, readings, fresh, enable):
        data, cycles, outputs = ect.dumps(table), len(readings), len(table.outputs)
        readings = np.ascontiguousarray(readings, dtype=self.real)
        deviation, correction = np.empty((2, cycles, outputs), dtype=self.real)
        status = np.empty(cycles, dtype=np.uint32)
        arrays = (readings, fresh, enable, deviation, correction, status)
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in arrays]
        error = self.dll.stream(data, ctypes.c_size_t(len(data)), ctypes.c_size_t(cycles), *pointers)
        assert error == 0, error
        return deviation, correction, status


def build(folder: Path, *flags, compiler=None, name="libect.so", sources=("driver.c",)) -> Path:
    command = [compiler or COMPILERS[0], *STRICT, "-shared", "-fPIC", *flags, f"-I{RUNTIME}"]
    return compile_once(command, [RUNTIME / "ect.c", *(HERE / s for s in sources)], folder / name)


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return Library(build(tmp_path_factory.mktemp("c")))


@pytest.mark.parametrize(
    ("compiler", "single"),
    [
        *[("clang", False), ("gcc", True)],
        *(pytest.param(*pair, marks=pytest.mark.slow) for pair in (("clang", True), ("gcc", False))),
    ],
)
def test_compiles_without_a_warning_and_needs_only_memcpy_and_memset(tmp_path, compiler, single):
    if compiler not in COMPILERS:
        pytest.skip(f"{compiler} is not installed")
    flags = ["-DECT_SINGLE"] if single else []
    run(compiler, *STRICT, *flags, "-ffreestanding", "-c", RUNTIME / "ect.c", "-o", tmp_path / "ect.o")
    wanted = run("nm", "-u", tmp_path / "ect.o").stdout.split()
    assert set(wanted) - {"U", "w"} <= {"memcpy", "memset"}


@pytest.mark.skipif(shutil.which("g++") is None, reason="no C++ compiler")
def test_the_header_compiles_as_cpp(tmp_path):
    (tmp_path / "use.cpp").write_text('#include "ect.h"\nint main() { return ect_find_input(nullptr, "x") < -1; }\n')
    strict = ["-Wall", "-Wextra", "-Werror", "-pedantic"]
    run("g++", *strict, f"-I{RUNTIME}", "-c", tmp_path / "use.cpp", "-o", tmp_path / "use.o")


@pytest.mark.parametrize("seed", range(25))
def test_equal_to_numba_to_the_bit(library, seed):
    table = everything(seed)
    case = stimulus(table, 2000, seed)
    for ours, theirs in zip(library.stream(table, *case), numba_stream(table, *case), strict=True):
        assert np.array_equal(ours, theirs)


@pytest.mark.slow
def test_equal_to_numba_to_the_bit_over_a_million_cycles(library):
    for seed in range(200, 220):
        table = everything(seed)
        case = stimulus(table, 50_000, seed)
        for ours, theirs in zip(library.stream(table, *case), numba_stream(table, *case), strict=True):
            assert np.array_equal(ours, theirs), seed


@pytest.mark.slow
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("optimise", ["-O0", "-O3"])
def test_every_compiler_and_optimisation_gives_the_same_bits(tmp_path, compiler, optimise):
    other = Library(build(tmp_path, optimise, compiler=compiler))
    for seed in (3, 7, 11):
        table = everything(seed)
        case = stimulus(table, 500, seed)
        for ours, theirs in zip(other.stream(table, *case), numba_stream(table, *case), strict=True):
            assert np.array_equal(ours, theirs)


def warm_up(table, cycles, seed):
    """Axes in motion and slowly warming sensors, a controller's ordinary day."""
    rng = np.random.default_rng(seed)
    readings = np.empty((cycles, len(table.inputs)))
    for n, i in enumerate(table.inputs):
        if i.kind == "position":
            readings[:, n] = 300 + 290 * np.sin(rng.uniform(0, 6) + 0.002 * np.arange(cycles) * rng.uniform(0.5, 2))
        else:
            readings[:, n] = 20 + 15 * (1 - np.exp(-np.arange(cycles) / cycles * rng.uniform(1, 3)))
    return readings, np.ones(readings.shape, dtype=np.uint8), np.ones(cycles, dtype=np.uint8)


def test_single_precision_stays_within_a_few_nanometres(tmp_path):
    single = Library(build(tmp_path, "-DECT_SINGLE"), np.float32)
    table = machine(thermal=True)
    readings, fresh, enable = warm_up(table, 20_000, 4)
    readings = readings.astype(np.float32).astype(float)
    deviation, correction, status = single.stream(table, readings, fresh, enable)
    exact = numba_stream(table, readings, fresh, enable)
    there = slice(3000, None)  # sensors are accepted a cycle earlier or later, and the thermal part fades in with them
    assert np.max(np.abs(deviation - exact[0])[there]) < 0.005
    assert np.max(np.abs(correction - exact[1])[there]) < 5e-6
    assert np.max(np.abs(deviation - exact[0])) < 0.05
    assert np.mean(status == exact[2]) > 0.999


@pytest.mark.parametrize(("tau", "cycle"), [(36_000.0, 0.01), (5400.0, 0.1), (600.0, 1.0), (1e9, 1.0)])
def test_a_slow_lag_is_as_fast_in_single_precision(tmp_path, library, tau, cycle):
    """What is left of its way after a cycle is 1 in single precision: the first stood still, as did a guard's clock."""
    single = Library(build(tmp_path, "-DECT_SINGLE"), np.float32)
    rise = d.Affine(weights=(tau / 1000.0,), of=(d.above("T", 20.0),))  # so that 1000 s move as much in every case
    lag = Lowered(d.Lag(of=rise, tau_up=tau, tau_down=tau, start="zero"))
    sensor = TableInput(name="T", kind="sensor", low=-40, high=100, default=20)
    cycles = {"position_cycle_s": cycle, "thermal_cycle_s": cycle}
    table = tables.compile_table([tables.ComponentSource("EZZ", "um", (lag,))], inputs=[sensor], **cycles)
    readings = 20.0 + 7.0 * np.sin(np.arange(20_000) / 4000.0)[:, None] ** 2
    fresh, enable = np.ones(readings.shape, np.uint8), np.ones(len(readings), np.uint8)
    precise, rounded = (one.stream(table, readings, fresh, enable)[0] for one in (library, single))
    assert np.ptp(precise) > 0.1 and np.abs(rounded - precise).max() < 2e-6 * np.ptp(precise)


def test_a_machine_ten_um_too_long_is_moved_back(library):
    """The sign, in C: at +X the correction is -0.010 mm."""
    readings = np.array([[0.0], [500.0], [1000.0]])
    ones = np.ones((3, 1), dtype=np.uint8)
    deviation, correction, _ = library.stream(ten_um_too_long(), readings, ones, np.ones(3, dtype=np.uint8))
    assert deviation[:, 0].tolist() == [0.0, 5.0, 10.0]
    assert correction[:, 0].tolist() == [0.0, -0.005, -0.01]


def test_a_probe_that_reads_10_um_too_long_moves_x_back_until_the_reading_is_old(library):
    """The input of readings, in C and Numba: fed in one cycle of 200, held for 5 s, never a fault."""
    table = compile_model(
        model(share=1.0, hold_s=5.0, bound=40.0), CompileOptions(thermal_cycle=0.1, position_cycle=0.1)
    )
    readings, fresh = np.full((200, 2), np.nan), np.zeros((200, 2), dtype=np.uint8)
    readings[:, 0], fresh[:, 0] = 20.0, 1
    readings[50, 1], fresh[50, 1] = 10.0, 1
    case = readings, fresh, np.ones(200, dtype=np.uint8)
    ours, theirs = library.stream(table, *case), numba_stream(table, *case)
    for mine, other in zip(ours, theirs, strict=True):
        assert np.array_equal(mine, other)
    assert np.allclose(ours[1][[49, 90, 199], 0], [0.0, -0.010, 0.0], atol=1e-9)


@pytest.mark.parametrize("count", [0, 7, 23, 300, 511, 512, 900])
def test_a_cut_off_table_is_refused(library, count):
    assert library.load(ect.dumps(everything(1))[:count])[0] in (1, 3)


def test_a_single_flipped_bit_is_refused(library):
    data = ect.dumps(everything(2))
    for at in range(0, len(data), 31):
        broken = bytearray(data)
        broken[at] ^= 1 << at % 8
        assert library.load(bytes(broken))[0] != 0


def damaged(r: random.Random, data: bytes) -> bytes:
    """A table damaged in a few places, its checksum mended."""
    odd = [0.0, -0.0, 1e15, 1e-15, -1.0, float("nan"), float("inf"), 1e16]
    special = [*(struct.pack("<d", v) for v in odd), b"\xff" * 4, bytes(4), b"\1\0\0\0", b"\xff\xff\xff\x7f"]
    out = bytearray(data)
    for _ in range(r.choice((1, 1, 1, 2, 3))):
        at = r.randrange(len(out))
        kind = r.random()
        if kind < 0.3:
            out[at] ^= 1 << r.randrange(8)
        elif kind < 0.6:
            value = r.choice(special)
            out[at & ~7 : (at & ~7) + len(value)] = value
        elif kind < 0.8:
            out[at] = (out[at] + r.choice((1, -1))) % 256
        else:
            out[at] = r.randrange(256)
    out = out[: len(data)]
    struct.pack_into("<I", out, 20, zlib.crc32(out[24:]))
    return bytes(out)


def python_takes(data: bytes) -> bool:
    try:
        ect.loads(data)
    except VerifyError:
        return False
    return True


def test_both_readers_refuse_the_same_files(library):
    """The C reader was written from the format page, the Python one beside it: they judge damaged files alike."""
    r = random.Random(5)
    sound = [ect.dumps(everything(s)) for s in range(50, 60)]
    taken = 0
    for _ in range(1500):
        data = damaged(r, r.choice(sound))
        ours, theirs = python_takes(data), library.load(data)
        assert ours == (theirs[0] == 0), theirs
        taken += ours
    assert 50 < taken < 600


@pytest.mark.parametrize("case", sorted((HERE / "seeds").glob("*.ect")), ids=lambda p: p.stem)
def test_files_that_once_went_wrong(library, case):
    data = case.read_bytes()
    assert python_takes(data) == (library.load(data)[0] == 0)


def sanitized(folder: Path, tables_, *more: str) -> tuple[Path, list[Path]]:
    flags = [*more, "-g", "-O1", "-DALONE", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    try:
        run(COMPILERS[0], *STRICT, *flags, f"-I{RUNTIME}", RUNTIME / "ect.c", HERE / "fuzz.c", "-o", folder / "fuzz")
    except subprocess.CalledProcessError as err:
        pytest.skip(f"no sanitizers here: {err.stderr.splitlines()[-1]}")
    files = [folder / f"{n}.ect" for n in range(len(tables_))]
    for table, file in zip(tables_, files, strict=True):
        ect.write(table, file)
    return folder / "fuzz", files


@pytest.mark.parametrize(
    "more", [pytest.param((), id="double", marks=pytest.mark.slow), pytest.param(("-DECT_SINGLE",), id="single")]
)
def test_damaged_tables_never_read_out_of_bounds(tmp_path, more):
    program, files = sanitized(tmp_path, [everything(s) for s in range(8)], *more)
    output = run(program, *files, 500).stdout
    assert re.match(r"4000 executions, \d+ accepted", output)


@pytest.mark.slow
def test_many_damaged_tables_never_read_out_of_bounds(tmp_path):
    program, files = sanitized(tmp_path, [everything(s) for s in range(20, 40)])
    assert run(program, *files, 10_000).stdout.startswith("200000 executions")


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("clang") is None, reason="clang, which brings libFuzzer, is not installed")
def test_libfuzzer_finds_nothing(tmp_path):
    """Guided by coverage, from sound tables; ERRPIPE_FUZZ=1000000 is what a release is given (about six minutes)."""
    from tests.unit.tables import refused

    count = int(os.environ.get("ERRPIPE_FUZZ", "20000"))
    flags = ["-g", "-O1", "-fsanitize=fuzzer,address,undefined", "-fno-sanitize-recover=all", f"-I{RUNTIME}"]
    try:
        run("clang", *flags, RUNTIME / "ect.c", HERE / "fuzz.c", "-o", tmp_path / "fuzz")
    except subprocess.CalledProcessError as err:
        pytest.skip(f"no libFuzzer here: {err.stderr.splitlines()[-1]}")
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    sound = [refused.sound(), ten_um_too_long(), *(everything(s) for s in range(8))]
    for n, table in enumerate(sound):
        ect.write(table, corpus / f"{n}.ect")
    for seed in (HERE / "seeds").glob("*.ect"):
        (corpus / seed.name).write_bytes(seed.read_bytes())
    # libFuzzer's limit of resident memory reads a peak that a process inherits from its parent: each request is limited
    limits = ["-max_len=6000", "-rss_limit_mb=0", "-malloc_limit_mb=64"]
    output = run(tmp_path / "fuzz", f"-runs={count}", *limits, "-seed=1", corpus, cwd=tmp_path).stderr
    assert f"Done {count} runs" in output


def test_memory_is_known_before_it_runs(library):
    table = machine(thermal=True)
    data = ect.dumps(table)
    assert library.dll.ect_work_size(data, ctypes.c_size_t(len(data))) == bounds.work_bytes(table) < 10_000
    for seed in range(10):
        data = ect.dumps(everything(seed))
        assert library.dll.ect_work_size(data, ctypes.c_size_t(len(data))) == bounds.work_bytes(everything(seed))
    assert library.dll.ect_work_size(data[:300], ctypes.c_size_t(300)) == 0


# Cortex-M in an emulator -----------------------------------------------------------------------------

ARM = [name for name in ("arm-none-eabi-gcc", "qemu-system-arm") if shutil.which(name) is None]
BOARDS = {
    "m4f": ("mps2-an386", ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]),
    "m3": ("mps2-an385", ["-mcpu=cortex-m3", "-mthumb"]),
}


@pytest.mark.skipif(bool(ARM), reason=f"not installed: {', '.join(ARM)}")
@pytest.mark.slow
@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("single", [True, False], ids=["single", "double"])
def test_a_cortex_m_gives_the_bits_of_this_machine(tmp_path, library, board, single, capsys):
    table = machine(thermal=True)
    readings, _, _ = warm_up(table, 60, 2)
    data = ect.dumps(table)
    work = library.dll.ect_work_size(data, ctypes.c_size_t(len(data)))
    bench_cortex.case_header(table, readings.astype(np.float32), tmp_path, work)
    model, cpu = BOARDS[board]
    common = ["-std=c99", "-O2", "-ffp-contract=off", f"-I{tmp_path}", f"-I{RUNTIME}"]
    common += ["-DECT_SINGLE"] if single else []
    sources = [RUNTIME / "ect.c", HERE / "arm" / "main.c"]
    run(COMPILERS[0], *common, *sources, "-o", tmp_path / "host")
    there = bench_cortex.emulated(tmp_path, model, cpu, common)
    here = run(tmp_path / "host").stdout
    assert here.startswith("exact 1\n") and here.count("\n") == 61
    assert there.stdout == here
    counted, slowest = bench_cortex.instructions(there.stderr)
    if board == "m4f" and single:
        assert 0 < counted <= bench_cortex.AIMS["instructions_per_cycle"]
        assert counted < slowest <= bounds.cortex_m4_instructions(table)
    with capsys.disabled():
        print(f"\n{board}, {'single' if single else 'double'}, 21 components and 8 sensors: {there.stderr.strip()}")


@pytest.mark.skipif(bool(ARM), reason=f"not installed: {', '.join(ARM)}")
@pytest.mark.slow
@pytest.mark.parametrize("seed", range(500, 515))
def test_the_slowest_cycle_stays_below_the_instructions_counted_from_the_table(tmp_path, seed):
    """Readings that fail, jump and come late, on tables whose counts were not used for the bound."""
    table = everything(seed)
    readings, fresh, mode = stimulus(table, 300, seed)
    bench_cortex.case_header(table, readings, tmp_path, bounds.work_bytes(table), fresh, mode)
    model, cpu = BOARDS["m4f"]
    common = [*bench_cortex.COMMON, "-O2", f"-I{tmp_path}"]
    _, slowest = bench_cortex.instructions(bench_cortex.emulated(tmp_path, model, cpu, common).stderr)
    assert slowest <= bounds.cortex_m4_instructions(table) < 2.2 * slowest


# The target ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "single", [pytest.param(False, id="double"), pytest.param(True, id="single", marks=pytest.mark.slow)]
)
def test_the_exported_files_compile_and_move_the_machine_back(tmp_path, single):
    """A machine 10 um too long at +X, whose example reads x = 0 by default: moved to +X in the text."""
    files = CRuntime.write(ten_um_too_long(title="closes */ nothing"))
    assert "readings[] = {(ect_real)0.0}" in files["example.c"]
    files["example.c"] = files["example.c"].replace("(ect_real)0.0", "(ect_real)1000.0")
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    sources = [tmp_path / name for name in ("ect.c", "ect_identity.c", "table.c", "example.c")]
    run(COMPILERS[0], *STRICT, *(["-DECT_SINGLE"] if single else []), *sources, "-o", tmp_path / "example")
    number, correction = run(tmp_path / "example").stdout.split()
    assert number == "0" and float(correction) == pytest.approx(-0.01, abs=1e-9)


def test_exported_files_are_read_back_and_changes_are_noticed():
    table = machine(thermal=True)
    files = CRuntime.write(table)
    assert CRuntime.read_back(files).table == table
    with pytest.raises(VerifyError, match=r"ect\.c: is missing or was changed"):
        CRuntime.read_back(files | {"ect.c": files["ect.c"].replace("-o->deviation", "o->deviation")})
    text = files["table.c"]
    last = text.rindex(", ")
    with pytest.raises(VerifyError, match="damaged"):
        CRuntime.read_back(files | {"table.c": text[:last] + ", 7" + text[text.index("}", last) :]})
