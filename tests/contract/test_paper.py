"""docs/paper.md names commands that exist, and its bold figures are among the numbers that they print."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from errpipe.cli.app import VERBS

TOP = Path(__file__).parents[2]
REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", TOP.parent / "shared" / "real-data"))
PAGE = (TOP / "docs" / "paper.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\|[^|]*\| `((?:errpipe|pytest|python) [^`]*)` \| (.*) \|$", PAGE, flags=re.M)
COMMANDS = [command for command, _ in ROWS]
FIGURES = [(command, re.findall(r"\*\*([\d.]+)\*\*", today)) for command, today in ROWS if "**" in today]
ON_REAL_DATA = ("REAL/", "drilled-plates", "turning-centre")


def test_every_row_has_a_command_and_a_figure():
    rows = [
        line for line in PAGE.splitlines() if line.startswith("| ") and not line.startswith(("| in the paper", "| ---"))
    ]
    assert len(rows) == len(COMMANDS) >= 24
    assert all(len(row.strip("|").split(" | ")) == 3 and row.strip("| ").split(" | ")[2].strip() for row in rows)
    assert len(FIGURES) >= 13  # slow figures that an end-to-end test judges already are not bold


@pytest.mark.parametrize("command", COMMANDS)
def test_the_command_exists(command):
    words = shlex.split(command)
    if words[:2] == ["python", "-m"]:
        assert (TOP / f"{words[2].replace('.', '/')}.py").is_file(), words[2]
        return
    if words[0] in ("pytest", "python"):
        assert (TOP / words[1]).is_file(), words[1]
        return
    assert words[1] in VERBS
    for word in words[2:]:
        if word.endswith(".yaml"):
            assert (TOP / word).is_file(), word
    if words[1] == "reference":
        assert (TOP / "errpipe" / "terms" / f"{words[3]}.py").is_file(), words[3]


def missing(figures: list[str], printed: str) -> list[str]:
    """Figures of the page that no printed number rounds to."""
    numbers = [float(n) for n in re.findall(r"\d+\.?\d*(?:e[+-]\d+)?", printed)]
    out = []
    for figure in figures:
        digits = len(figure.partition(".")[2])
        near = 0.501 * 10.0**-digits
        out += [] if any(abs(n - float(figure)) <= near for n in numbers) else [figure]
    return out


def test_a_figure_that_is_not_printed_is_noticed():
    assert missing(["0.86", "29.5", "43"], "EXX 29.49 -> 0.857 um") == ["43"]


@pytest.mark.slow
@pytest.mark.parametrize("command, figures", FIGURES, ids=[c for c, _ in FIGURES])
def test_the_figures_are_what_the_command_prints(command, figures, tmp_path):
    if any(word in command for word in ON_REAL_DATA) and not REAL.is_dir():
        pytest.skip("the real recordings (ERRPIPE_REAL_DATA) are not here")
    words = shlex.split(command.replace("REAL/", f"{REAL}/"))
    words[:1] = {"errpipe": [sys.executable, "-m", "errpipe"], "python": [sys.executable]}[words[0]]
    if words[3:4] == ["run"]:
        words += ["--out", str(tmp_path)]
    env = {**os.environ, "ERRPIPE_REAL_DATA": str(REAL)}
    ran = subprocess.run(words, cwd=TOP, env=env, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-2000:]
    assert missing(figures, ran.stdout) == [], ran.stdout
