"""Broken inputs: the whole message and the exit code, compared as text.

A case is a folder here. Add one by making a folder; there is no code to write:

    tests/errors/yaml-tab/
        cmd             first line: the arguments of `errpipe`, as in a shell; second line: `exit N`
        expected.txt    all of standard error
        p.yaml ...      whatever files the command names

The command runs inside a copy of the folder, so files are named by relative paths, and messages show
them as they were named. Standard output must be empty, or what `expected-stdout.txt` holds.
An environment variable is set by a line `NAME=value` after the second. Empty folders: list them in a
line `mkdir NAME`. `WRITE_EXPECTED=1 pytest tests/errors -k NAME` writes expected.txt; read what it wrote.
"""

from __future__ import annotations

import os
import shlex
import shutil
from pathlib import Path

import pytest

from errpipe.cli.app import main

HERE = Path(__file__).parent
CASES = sorted(path.parent for path in HERE.glob("*/cmd"))
OWN = ("cmd", "expected.txt", "expected-stdout.txt")


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_message_and_exit_code(
    case: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    line, code, *more = (case / "cmd").read_text(encoding="utf-8").splitlines()
    where = tmp_path / "case"
    shutil.copytree(case, where, ignore=shutil.ignore_patterns(*OWN), copy_function=shutil.copyfile)
    monkeypatch.chdir(where)
    for extra in more:
        if extra.startswith("mkdir "):
            (where / extra.removeprefix("mkdir ")).mkdir()
        elif "=" in extra:
            monkeypatch.setenv(*extra.split("=", 1))
    status = main(shlex.split(line))
    heard = capsys.readouterr()
    if os.environ.get("WRITE_EXPECTED"):
        (case / "expected.txt").write_text(heard.err, encoding="utf-8")
    assert heard.err == (case / "expected.txt").read_text(encoding="utf-8")
    assert f"exit {status}" == code
    stdout = case / "expected-stdout.txt"
    assert heard.out == (stdout.read_text(encoding="utf-8") if stdout.exists() else "")
    assert "Traceback" not in heard.err and str(tmp_path) not in heard.err


def test_there_are_enough_of_them() -> None:
    assert len(CASES) >= 40


def test_no_folder_is_forgotten() -> None:
    folders = {path.name for path in HERE.iterdir() if path.is_dir() and not path.name.startswith(("_", "."))}
    assert folders == {case.name for case in CASES}
    for case in CASES:
        assert (case / "expected.txt").exists()
