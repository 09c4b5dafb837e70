"""docs/paper.md names commands that exist: verbs, pipelines, tests, examples and reference entries."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from errpipe.cli.app import VERBS

TOP = Path(__file__).parents[2]
PAGE = (TOP / "docs" / "paper.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\|[^|]*\| `((?:errpipe|pytest|python) [^`]*)` \|", PAGE, flags=re.M)


def test_every_row_has_a_command_and_a_figure():
    rows = [
        line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith(("| in the paper", "| ---"))
    ]
    assert len(rows) == len(COMMANDS) >= 20
    assert all(len(row.strip("|").split(" | ")) == 3 and row.strip("| ").split(" | ")[2].strip() for row in rows)


@pytest.mark.parametrize("command", COMMANDS)
def test_the_command_exists(command):
    words = shlex.split(command)
    if words[0] in ("pytest", "python"):
        assert (TOP / words[1]).is_file(), words[1]
        return
    assert words[1] in VERBS
    for word in words[2:]:
        if word.endswith(".yaml"):
            assert (TOP / word).is_file(), word
    if words[1] == "reference":
        assert (TOP / "errpipe" / "terms" / f"{words[3]}.py").is_file(), words[3]
