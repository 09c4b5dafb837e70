"""The campaign of `make attack`, short: it finds nothing, and it would find what is planted."""

from __future__ import annotations

import itertools
import os
import random
import shutil
import time
from functools import partial
from pathlib import Path

import pytest

from errpipe import jsonfile
from errpipe.pipeline import runner
from tests.hostile import attack, attacked_files, kills
from tests.hostile.processes import ALLOWED, forked


@pytest.mark.slow
def test_a_short_campaign_finds_nothing(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    opened, counts = attack.attack(tmp_path / "files", 20.0, random.Random(11))
    assert counts == []
    assert sum(attacked.tried for attacked in opened) >= 20


@pytest.mark.slow
def test_a_short_kill_campaign_finds_nothing(tmp_path: Path) -> None:
    killed, counts = kills.kills(tmp_path / "kills", 15, random.Random(5), time.monotonic() + 120)
    assert counts == [] and killed >= 5


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
    _, counts = kills.kills(tmp_path / "kills", 8, random.Random(5), time.monotonic() + 120)
    assert any("neither old nor new" in line for line in counts)


def test_what_is_planted_is_found(tmp_path: Path) -> None:
    """An internal error, a crash and an endless wait are distinguished from a refusal."""
    import signal

    def fails() -> int:
        raise KeyError("T_nut")

    assert forked(fails, tmp_path)[0] == 1
    assert forked(lambda: os.kill(os.getpid(), signal.SIGSEGV) or 0, tmp_path)[0] is None
    assert forked(lambda: 3, tmp_path)[0] == 3


def test_modification_times_show_which_files_changed(tmp_path: Path) -> None:
    (tmp_path / "files").mkdir()
    (tmp_path / "precious.txt").write_text("precious")
    before = attack.modification_times(tmp_path / "files")
    (tmp_path / "said.txt").write_text("said")
    (tmp_path / "files" / "o.ngc").write_text("G0 X0")
    assert attack.modification_times(tmp_path / "files") == before
    (tmp_path / "files" / "x").mkdir()
    assert attack.modification_times(tmp_path / "files") != before
    (tmp_path / "files" / "x").rmdir()
    (tmp_path / "precious.txt").unlink()
    assert attack.modification_times(tmp_path / "files") != before


def planted(kind: str, path: Path) -> None:
    """Something else in the place of a file."""
    pipe = path.with_name("a-pipe")
    match kind:
        case "a pipe":
            os.mkfifo(path)
        case "a link to a pipe":
            os.mkfifo(pipe)
            path.symlink_to(pipe)
        case "a device":
            path.symlink_to("/dev/zero")
        case "a link to itself":
            path.symlink_to(path)
        case "a folder":
            path.mkdir()
        case "a hole":
            with path.open("wb") as stream:
                stream.truncate(1 << 40)
        case "nothing":
            path.write_bytes(b"")


NO_FILE = ("a pipe", "a link to a pipe", "a device", "a link to itself", "a folder", "a hole", "nothing", "gone")


@pytest.mark.slow
def test_every_file_ends_with_a_message_where_there_is_no_file(tmp_path: Path) -> None:
    """Every command of every file of the campaign; none waits, none reads without end."""
    from errpipe.cli.app import main

    folder = tmp_path / "files"
    folder.mkdir()
    wrong = []
    for attacked in attacked_files.attacked_files(folder):
        for kind, line in itertools.product(NO_FILE, attacked.lines):
            if attacked.fresh is not None:
                shutil.rmtree(attacked.fresh, ignore_errors=True)
            attacked.file.unlink(missing_ok=True)  # a run removes what an interrupted one left
            planted(kind, attacked.file)
            code, said = forked(partial(main, line), tmp_path)
            if code not in ALLOWED or "internal error" in said:
                wrong.append(f"{attacked.name}, {kind}, {line[0]}: {code} {said.strip()[-200:]}")
            shutil.rmtree(attacked.file) if attacked.file.is_dir() else attacked.file.unlink(missing_ok=True)
            attacked.file.with_name("a-pipe").unlink(missing_ok=True)
            attacked.file.write_bytes(attacked.sound)
    assert wrong == []
