"""NC programs that used to be corrected silently wrong, without end, or not at all."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.ncprogram.modal import Setup
from errpipe.tables import ect
from tests.hostile.command_line import command
from tests.nc import correct, too_long_at_plus_x
from tests.unit.targets import machines

SETUP = Setup(offsets={"G54": (100.0, 50.0, 0.0), "G55": (300.0, 50.0, 0.0)}, tools={1: 80.0}, start=(100.0, 50.0, 0.0))


@pytest.mark.parametrize(
    "line, why",
    [
        ("G2 I-400", "without the axis words of its end"),
        ("I-400", "without the axis words of its end"),
        ("G3 R5", "without the axis words of its end"),
        ("G4 P1 X500", "beside a dwell"),
        ("G4 X1", "beside a dwell"),
        ("G4", "without its time"),
        ("P5", "belongs to nothing"),
        ("H1", "belongs to nothing"),
        ("G43.1 Z5 A3", "with Z alone"),
        ("G43.1 Z5 G1", "with Z alone"),
        ("G0 G1 X5", "contradict"),
        ("G90 G91 X5", "contradict"),
        ("G20 G21", "contradict"),
        ("G2 X10 Y0 I5 R5", "both a radius and a centre"),
        ("G2 X10 Y0 I5 K1", "not a centre in the plane"),
        ("G90.1 G2 X10 Y0 I5", "needs both"),
        ("G2 X10 Y0 I5 J0 P1.5", "no number of turns"),
        ("G2 X10 Y0 I5 J0 P99999999", "beyond any machine|no number of turns"),
        ("G1 X9999999999", "beyond any machine"),
        ("G0 X1e5", "is not a word|not understood"),
        ("G1 X99999 Y99999", None),
        ("G1 X5 A90", "angle or a chamfer of the drawing"),
        ("G1 X50 %", "is not a word"),
        ("G1 X١", "is not a word"),
        ("; was\x0cG0 X5", "control character"),
        ("(a\x85M30)", "control character"),
        ("(a(b)", "not closed"),
        ("G1 X5)", "not closed"),
        ("G1 X" + "0" * 5000 + "5", "characters"),
        ("G43 H1.5", "is missing"),
        ("G90 X40 Z-30", "turning cycle"),
        ("G94 X40 Z-30 (face)", "turning cycle"),
        ("G90 G1 X40 Z-30", None),
        ("G1 X5 ; X6", "ends blocks with ';'"),
        ("G1 X5 F100; G0 Z5 ;", "ends blocks with ';'"),
        ("G1 X5 ; T5 first", None),
        ("; X6", None),
    ],
)
def test_refused_at_once_with_its_line(line: str, why: str | None) -> None:
    began = time.process_time()
    for bulk in (True, False):
        try:
            correct("G90 G21 G54 G0 X0 Y0 Z0\n" + line + "\n", too_long_at_plus_x, SETUP, bulk=bulk)
            assert why is None or "None" in why
        except DataError as err:
            assert why is not None and re.search(why, str(err)) and "line 2" in str(err), str(err)
    assert time.process_time() - began < 30.0  # against a blow-up; a first call in a worker compiles for seconds


def test_an_arc_of_too_many_segments_is_refused() -> None:
    with pytest.raises(DataError, match=r"line 2: the path would need \d+ segments"):
        correct("G0 X0 Y0 Z0\nG2 X90000 Y90000 R80000 P1000\n", too_long_at_plus_x, SETUP, chord_error=1e-6)


def test_a_plain_move_that_follows_the_end_is_refused() -> None:
    with pytest.raises(DataError, match="line 3: words after the program's end"):
        correct("G0 X0 Y0 Z0\nM2\nG1 X5\n", too_long_at_plus_x, SETUP)
    text, _ = correct("%\nG0 X0 Y0 Z0\nM2\n%\n\n; done\n", too_long_at_plus_x, SETUP)
    assert text.splitlines()[-3:] == ["%", "", "; done"]


def test_a_commented_out_command_stays_a_comment() -> None:
    source = "G0 X0 Y0 Z0\nG1 X5 (cut) ; was (LOGOPEN,f) (MSG,x)\n"
    text, _ = correct(source, too_long_at_plus_x, SETUP)
    last = text.splitlines()[-1]
    assert last.endswith(" (cut) ; was (LOGOPEN,f) (MSG,x)")
    assert last.count("LOGOPEN") == 1


def test_a_rotary_axis_turns_along_the_whole_line() -> None:
    text, _ = correct("G90 G21 G54\nG0 X0 Y0 Z0 A0\nG1 X100 A40 F100\n", too_long_at_plus_x, SETUP, longest=25.0)
    angles = [float(a) for a in re.findall(r"A([-\d.]+)", text)]
    assert angles == [0.0, 10.0, 20.0, 30.0, 40.0]
    text, _ = correct("G90 G21 G54\nG0 X0 Y0 Z0 A0\nG91 G1 X100 A40 F100\n", too_long_at_plus_x, SETUP, longest=25.0)
    assert [float(a) for a in re.findall(r"A([-\d.]+)", text)] == [0.0, 10.0, 10.0, 10.0, 10.0]


@pytest.mark.parametrize(
    "line", ["G91 G55 G1 X10 Y3", "G91 G43 H1 G1 Z-3", "G91 G20 G1 X1", "G55 G91\nX10", "G20 G91\nX1"]
)
def test_increments_start_where_the_axes_stand_after_a_change_of_coordinates(line: str) -> None:
    """The machine is 10 um too long at X = +500 of the machine: no increment may hold the shift of an offset."""
    text, _ = correct(f"G90 G21 G54\nG0 X40 Y0 Z0\n{line}\n", too_long_at_plus_x, SETUP, longest=30.0)
    moved = {k: float(v) for k, v in re.findall(r"([XYZ])([-+\d.]+)", text.splitlines()[-1])}
    asked = {k: float(v) for k, v in re.findall(r"([XYZ])([-+\d.]+)", line)}
    for letter in moved:
        assert moved[letter] == pytest.approx(asked.get(letter, 0.0), abs=0.002)


def test_long_programs_stream_to_the_same_text_as_short_pieces(monkeypatch: pytest.MonkeyPatch) -> None:
    from errpipe.ncprogram import writer

    rng = np.random.default_rng(3)
    moves = [
        f"G1 X{x:.3f} Y{y:.3f}" if n % 3 else f"X{x:.3f} (c{n})"
        for n, (x, y) in enumerate(rng.uniform(0, 300, (500, 2)))
    ]
    program = "G90 G21 G54\nG0 X0 Y0 Z0\nF100\n" + "\n".join(moves) + "\nG91\nX1\nM2\n"
    whole = correct(program, too_long_at_plus_x, SETUP)
    monkeypatch.setattr(writer, "MAX_POINTS", 7)
    assert correct(program, too_long_at_plus_x, SETUP) == whole


# ---------------------------------------------------------------- the command


@pytest.fixture
def table(tmp_path: Path) -> Path:
    """A table that reads a temperature."""
    from errpipe.domain import driver as d

    warm = machines.straight("X", 1.0, driver=d.Affine(of=(d.Input(name="T"),), weights=(1.0,), offset=-20.0))
    ect.write(machines.compile_(("EXX", [warm])), tmp_path / "t.ect")
    (tmp_path / "p.ngc").write_text("G90 G21 G54\nG0 X0 Y0 Z0\nG1 X500 F100\n")
    return tmp_path / "t.ect"


@pytest.mark.parametrize(
    "at, word",
    [
        ([], "the table reads T"),
        (["T=25", "Tnut=5"], "no such input"),
        (["x=5", "T=25"], "no such input"),
        (["T=nan"], "not plausible"),
        (["T=1e9"], "not plausible"),
    ],
)
def test_a_reading_that_is_not_given_or_not_known_is_refused(
    table: Path, at: list[str], word: str, capsys: Any
) -> None:
    words = [part for reading in at for part in ("--at", reading)]
    code, text = command("correct", table.parent / "p.ngc", "--table", table, "--start", "0,0,0", *words, capsys=capsys)
    assert code == 2 and word in text


def test_a_reading_outside_what_was_measured_is_reported(table: Path, capsys: Any) -> None:
    from errpipe.cli.app import main

    out = table.parent / "o.ngc"
    words = ["correct", table.parent / "p.ngc", "--table", table, "--start", "0,0,0", "--out", out]
    assert main([*map(str, words), "--at", "T=33"]) == 0
    assert "outside 15 to 30: the correction fades" in capsys.readouterr().out
    assert main([*map(str, words), "--at", "T=25"]) == 0
    assert "fades" not in capsys.readouterr().out
    assert float(out.read_text().splitlines()[-1].split("X")[1].split()[0]) == pytest.approx(500 - 0.005, abs=2e-4)


def test_what_is_refused_leaves_the_old_program(table: Path, capsys: Any) -> None:
    out = table.parent / "o.ngc"
    out.write_text("old")
    (table.parent / "p.ngc").write_text("G0 X0 Y0 Z0\n" * 60_000 + "G2 I-400\n")
    code, text = command(
        "correct",
        table.parent / "p.ngc",
        "--table",
        table,
        "--start",
        "0,0,0",
        "--at",
        "T=25",
        "--out",
        out,
        capsys=capsys,
    )
    assert code == 3 and "line 60001" in text
    assert out.read_text() == "old" and sorted(p.name for p in table.parent.iterdir()) == ["o.ngc", "p.ngc", "t.ect"]


@pytest.mark.slow
def test_two_million_bytes_a_second_in_memory_that_does_not_grow(table: Path) -> None:
    """The time of the processor, what starting takes apart: between a program of 3 MB and one of 11 MB."""
    rng = np.random.default_rng(1)
    lines = "".join(f"G1 X{x:.3f} Y{y:.3f}\n" for x, y in rng.uniform(0, 400, (15_000, 2)).cumsum(axis=0) % 1 + 100)
    program = table.parent / "p.ngc"
    words = ["correct", program, "--table", table, "--start", "0,0,0", "--at", "T=25", "--out", table.parent / "o"]
    seconds, memory = [], []
    for times in (1, 9, 36):  # the first compiles
        program.write_text("G90 G21 G54\nG0 X0 Y0 Z0\n" + lines * times)
        child = subprocess.Popen(
            [sys.executable, "-m", "tests.peak_memory", str(table.parent / "peak"), *map(str, words)],
            stdout=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": str(Path(__file__).parents[2])},
        )
        _, status, used = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        assert child.returncode == 0
        seconds.append(used.ru_utime)
        memory.append(int((table.parent / "peak").read_text()))
    assert len(lines) * (36 - 9) > 2e6 * (seconds[2] - seconds[1])
    assert memory[2] < memory[1] + 50_000 and memory[2] < 700_000
