"""What a terminal shows: within 80 columns, time left for what takes long, words that the shell completes."""

from __future__ import annotations

import io
import shutil
import subprocess

import pytest

from errpipe.cli.app import main
from errpipe.cli.output import WIDTH, folded
from errpipe.cli.progress import ProgressReporter
from errpipe.terms import TERMS


@pytest.mark.parametrize("line", ["targets", "targets sinumerik_lec", "formats", "explain absolute-readings", "terms"])
def test_pages_fit_into_eighty_columns(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(line.split()) == 0
    assert max(map(len, capsys.readouterr().out.splitlines())) <= WIDTH


def test_folding_breaks_no_word_and_loses_none() -> None:
    path = "/a/" + "b" * 100
    lines = ["name        " + "some words " * 20, f"see {path} for more of it and then some", "| " + "x" * 99 + " |"]
    wrapped = folded(lines)
    assert " ".join(wrapped).split() == " ".join(lines).split() and path in "\n".join(wrapped) and lines[2] in wrapped
    assert wrapped[1].startswith(" " * 12 + "some")


def test_every_page_of_a_term_fits_into_eighty_columns(capsys: pytest.CaptureFixture[str]) -> None:
    for term in TERMS:
        name = term.model_fields["term"].default
        assert main(["terms", name]) == 0
        text = capsys.readouterr().out
        assert max(map(len, text.splitlines())) <= WIDTH, name


def test_a_markdown_table_becomes_columns() -> None:
    long = "word " * 30
    table = [
        "| name | unit | |",
        "| --- | --- | --- |",
        "| `a` | um | short |",
        f"| `bb` | | {long.strip()} |",
        "after",
    ]
    wrapped = folded(table)
    assert wrapped[0] == "name  unit" and wrapped[1] == "a     um    short" and wrapped[-1] == "after"
    assert " ".join(wrapped[2:-1]).split() == ["bb", *long.split()] and wrapped[3].startswith(" " * 12 + "word")
    wide = folded(["| a | b |", "| --- | --- |", f"| {'x' * 70} | {long.strip()} |"])
    assert wide[2] == "x" * 70 and max(map(len, wide)) <= WIDTH


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def bar(monkeypatch: pytest.MonkeyPatch, *steps: tuple[float, float]) -> str:
    """What a terminal gets for (clock in s, share done)."""
    for name in ("CI", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    screen = Terminal()
    now = [0.0]
    reporter = ProgressReporter("out", screen, clock=lambda: now[0])
    show = reporter.progress_of("fit")
    show(0.0, "begins")
    for at, share in steps:
        now[0] = at
        show(share, "run " * 40)
    return screen.getvalue()


def test_remaining_time_is_shown_for_long_tasks(monkeypatch: pytest.MonkeyPatch) -> None:
    text = bar(monkeypatch, (10.0, 0.25), (20.0, 0.5))
    assert "30 s left" in text and "20 s left" in text and "begins" in text
    assert all(len(part.removeprefix("\033[K")) < WIDTH for part in text.split("\r"))
    assert "left" not in bar(monkeypatch, (1.0, 0.5))
    assert "10 min left" in bar(monkeypatch, (60.0, 1 / 11))


def test_no_bar_without_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("NO_COLOR", "1")
    assert not ProgressReporter("out", Terminal()).moving


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash")
@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("errpipe ver", ["verify", "verify-signature"]),
        ("errpipe import --tor", ["--torque-constant"]),
        ("errpipe ru", ["run"]),
    ],
)
def test_bash_completes_verbs_and_options(words: str, found: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", "bash"]) == 0
    script = capsys.readouterr().out
    line = f"COMP_WORDS=({words}); COMP_CWORD={len(words.split()) - 1}; _errpipe; echo ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", f"{script}\n{line}"], capture_output=True, text=True, check=True)
    assert done.stdout.split() == found


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells_get_the_same_message(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["completion", shell]) == 0
    text = capsys.readouterr().out
    assert "verify-signature" in text and "torque-constant" in text


@pytest.mark.parametrize(
    "line",
    [
        "whatis no.ect",
        "show no.ect",
        "compare-targets no.ect",
        "export no.ect --target linuxcnc_screw --out x",
        "verify no",
        "eval no.ect --at x=1",
        "predict no.json no --out x.csv",
        "import no.csv --out x --yes",
    ],
)
def test_data_that_is_not_there_is_exit_three_whatever_the_verb(
    line: str, tmp_path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(line.split()) == 3
