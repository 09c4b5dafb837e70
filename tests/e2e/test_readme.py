"""Every command of the README and of the templates' help runs, from an empty folder."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from errpipe.cli.app import main
from tests.e2e.test_first_contact import wide_export

README = Path(__file__).parents[2] / "README.md"


def test_every_command_of_the_readme_runs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    wide_export(tmp_path / "positions.csv")
    blocks = re.findall(r"```sh\n(.*?)```", README.read_text(encoding="utf-8"), re.S)
    lines = [line for block in blocks for line in block.splitlines()]
    assert len(lines) >= 12 and all(line.startswith("errpipe ") for line in lines)
    for line in lines:
        assert main(shlex.split(line)[1:]) == 0, line


def test_every_link_of_the_readme_is_there() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README.read_text(encoding="utf-8")):
        assert (README.parent / target).exists(), target
