"""The campaigns of `tests.hostile.interrupted`, short; and a temporary file that SIGTERM finds half-written."""

from __future__ import annotations

import random
import signal
import time
from pathlib import Path

import pytest

from tests.hostile import interrupted
from tests.hostile.processes import fresh


@pytest.mark.slow
def test_retrain_killed_a_few_times_leaves_the_champion_and_whole_files(tmp_path: Path) -> None:
    assert interrupted.retrain_kills(tmp_path / "kills", 6, random.Random(5)) == (6, [])


@pytest.mark.slow
def test_commands_stopped_a_few_times_leave_nothing_half_written(tmp_path: Path) -> None:
    assert interrupted.signals(tmp_path, 6, random.Random(5)) == (6, [])


@pytest.mark.slow
@pytest.mark.parametrize("number", interrupted.STOPPED)
def test_a_program_that_is_being_corrected_stays_as_it_was(tmp_path: Path, number: signal.Signals) -> None:
    line, out = interrupted.commands(tmp_path)["correct"], tmp_path / "out"
    with (tmp_path / "part.ngc").open("a") as program:
        program.write("G1 X150 Y3.5\n" * 2_000_000)
    out.mkdir()
    (out / "p.ngc").write_text("of before")
    process = fresh(line)
    for _ in range(6000):
        if process.poll() is not None or list(out.glob(".p.ngc.*.tmp")):
            break
        time.sleep(0.01)
    process.send_signal(number)
    assert process.wait(60) == interrupted.STOPPED[number]
    assert [p.name for p in out.iterdir()] == ["p.ngc"] and (out / "p.ngc").read_text() == "of before"
