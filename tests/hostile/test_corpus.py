"""Every generated hostile input ends in a message within bounds of time and memory, whichever verb opens it."""

from __future__ import annotations

import contextlib
import io
import os
import resource
from pathlib import Path

import pytest

from errpipe.cli.app import main
from tests.hostile import corpus
from tests.hostile.processes import ALLOWED, quiet
from tests.peak_memory import peak_kb

CPU_LIMIT = 10  # s of the processor for one command
MEMORY_LIMIT = 1_000_000  # kB for one command, the modules it imports included


def attempt(line: list[str], folder: Path) -> tuple[int, str, int]:
    """Exit code (negative: the signal that ended it), standard error, peak memory in kB, in a process of its own."""
    said, peak = folder / "said.txt", folder / "peak.txt"
    peak.write_text("0")
    child = os.fork()
    if child == 0:
        code = 1
        try:
            resource.setrlimit(resource.RLIMIT_CPU, (CPU_LIMIT, CPU_LIMIT))
            with (
                said.open("w", errors="replace") as stream,
                contextlib.redirect_stderr(stream),
                contextlib.redirect_stdout(io.StringIO()),
            ):
                code = main(line)
        except BaseException as err:
            said.write_text(f"internal error: escaped: {type(err).__name__}: {err}")
        peak.write_text(str(peak_kb()))
        os._exit(code)
    _, status = os.waitpid(child, 0)
    return os.waitstatus_to_exitcode(status), said.read_text(errors="replace"), int(peak.read_text())


def judge(cases: list[corpus.Case], folder: Path) -> list[str]:
    """What was found: name of the case, verb, and what is wrong with how it ended."""
    with quiet():  # in this process, so that the forked ones need not import or compile
        for line in corpus.sound(folder / "sound"):
            assert main(line) == 0, line
    out = []
    for number, (name, make) in enumerate(cases):
        for line in make(folder / str(number)):
            code, said, peak = attempt(line, folder)
            if code not in ALLOWED or "internal error" in said or "Traceback" in said:
                out.append(f"{name}: {line[0]}: exit {code}: {said[-300:]}")
            elif code != 0 and not said.strip():
                out.append(f"{name}: {line[0]}: exit {code} without a word")
            elif peak > MEMORY_LIMIT:
                out.append(f"{name}: {line[0]}: {peak} kB")
    return out


def test_a_sample_of_the_corpus_ends_in_messages(tmp_path: Path) -> None:
    assert judge(list(corpus.cases())[::20], tmp_path) == []


@pytest.mark.slow
def test_the_corpus_ends_in_messages(tmp_path: Path) -> None:
    every = list(corpus.cases())
    assert len(every) > 300 and len({name for name, _ in every}) == len(every)
    assert judge(every, tmp_path) == []


def test_what_is_planted_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An escaped error, an endless loop and a silent refusal."""
    folder = tmp_path / "x"
    folder.mkdir()
    for words, planted in {
        "escaped": lambda line: [][0],
        "exit 3 without a word": lambda line: 3,
        "exit -": lambda line: sum(iter(int, 1)),
    }.items():
        monkeypatch.setattr(corpus, "sound", lambda folder: [])
        monkeypatch.setitem(judge.__globals__, "main", planted)
        monkeypatch.setitem(judge.__globals__, "CPU_LIMIT", 1)
        (judgement,) = judge([("planted", lambda folder: [["run"]])], folder)
        assert words in judgement
