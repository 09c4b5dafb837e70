"""The campaign of `make attack`, short: it finds nothing, and it would find what is planted."""

from __future__ import annotations

import random
import time
from pathlib import Path

import pytest

from errpipe import jsonfile
from errpipe.pipeline import runner
from tests.hostile import attack, kills
from tests.hostile.processes import forked


@pytest.mark.slow
def test_a_short_campaign_finds_nothing(tmp_path: Path) -> None:
    (tmp_path / "doors").mkdir()
    opened, found = attack.attack(tmp_path / "doors", time.monotonic() + 20.0, random.Random(11))
    assert found == []
    assert sum(door.tried for door in opened) >= 20


@pytest.mark.slow
def test_a_short_kill_campaign_finds_nothing(tmp_path: Path) -> None:
    killed, found = kills.kills(tmp_path / "kills", 15, random.Random(5), time.monotonic() + 120)
    assert found == [] and killed >= 5


@pytest.mark.slow
def test_a_writer_that_does_not_rename_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planted: files are written in place, half of them before the other half."""

    def in_place(path: Path, data: bytes) -> bool:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        with Path(path).open("wb") as stream:
            for half in (data[: len(data) // 2], data[len(data) // 2 :]):
                stream.write(half)
                stream.flush()
                time.sleep(0.04)  # long beside what a busy machine adds
        return True

    monkeypatch.setattr(jsonfile, "write_bytes", in_place)
    monkeypatch.setattr(runner, "_publish", lambda source, target: in_place(target, source.read_bytes()))
    _, found = kills.kills(tmp_path / "kills", 8, random.Random(5), time.monotonic() + 120)
    assert any("neither old nor new" in line for line in found)


def test_what_is_planted_is_found(tmp_path: Path) -> None:
    """An internal error, a crash and an endless wait are told from a refusal."""
    import os
    import signal

    def fails() -> int:
        raise KeyError("T_nut")

    assert forked(fails, tmp_path)[0] == 1
    assert forked(lambda: os.kill(os.getpid(), signal.SIGSEGV) or 0, tmp_path)[0] is None
    assert forked(lambda: 3, tmp_path)[0] == 3


def test_a_file_that_is_touched_beside_is_found(tmp_path: Path) -> None:
    (tmp_path / "doors").mkdir()
    (tmp_path / "precious.txt").write_text("precious")
    before = attack.modification_times(tmp_path / "doors")
    (tmp_path / "said.txt").write_text("said")
    (tmp_path / "doors" / "o.ngc").write_text("G0 X0")
    assert attack.modification_times(tmp_path / "doors") == before
    (tmp_path / "doors" / "x").mkdir()
    assert attack.modification_times(tmp_path / "doors") != before
    (tmp_path / "doors" / "x").rmdir()
    (tmp_path / "precious.txt").unlink()
    assert attack.modification_times(tmp_path / "doors") != before
