"""The command line as a whole: help, speed, exit codes, JSON also on failure, and the one error boundary."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

import errpipe
from errpipe.cli._verbs import first_line, verb
from errpipe.cli.app import VERBS, main
from errpipe.cli.run import _entry_text
from errpipe.errors import ConfigError, DataError, GateError, Problem, VerifyError
from tests.unit.pipeline.stages_for_tests import STAGES, write_stages

ROOT = Path(__file__).parents[3]

HEAVY = ("pandas", "numba", "sklearn", "scipy", "matplotlib", "pyarrow", "pint", "cryptography")


@pytest.fixture
def where(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A pipeline of stages that know no physics, in the current folder."""
    write_stages(tmp_path)
    monkeypatch.setattr("errpipe.stages.STAGES", STAGES)
    monkeypatch.setattr("errpipe.pipeline.lock.package_code", lambda: "source")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def loaded_after(*arguments: str) -> set[str]:
    """Which heavy packages a command line brings in."""
    code = f"from errpipe.cli.app import main; main({list(arguments)!r})"
    code += "; import sys; print(*(n for n, m in sys.modules.items() if getattr(m, '__spec__', None)), file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return {name.split(".")[0] for name in run.stderr.split()} & set(HEAVY)


def test_help_is_light() -> None:
    assert loaded_after("--help") == set()


def test_checking_a_pipeline_is_light() -> None:
    root = Path(__file__).parents[3]
    assert loaded_after("check", str(root / "pipelines" / "ball-screw-axis.yaml")) == set()


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_says_what_it_does_and_shows_an_example_that_parses(name: str) -> None:
    command = verb(name)
    lines = [line.strip() for line in (command.help or "").splitlines()]
    assert 10 < len(lines[0]) <= 70 and lines[0].endswith("."), lines[0]
    assert "Example:" in lines
    examples = [shlex.split(line) for line in lines[lines.index("Example:") :] if line.startswith("errpipe ")]
    assert examples and all(words[:2] == ["errpipe", name] for words in examples)
    assert [line for line in lines if line.startswith("errpipe ") and len(line) > 76] == [], "indented by 4 of 80"
    for words in examples:
        command.make_context(name, words[2:])
        assert all((ROOT / w).exists() for w in words if w.startswith(("examples/", "pipelines/"))), words


def test_the_example_with_a_setting_sets_what_there_is(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    help_text = next(line.strip() for line in (verb("plan").help or "").splitlines() if "--set" in line)
    words = [str(ROOT / w) if w.startswith("pipelines/") else w for w in shlex.split(help_text)[1:]]
    assert main([*words, "--out", str(tmp_path / "out")]) == 0, capsys.readouterr().err


@pytest.mark.parametrize("name", VERBS)
def test_every_option_has_a_help_text(name: str) -> None:
    for parameter in verb(name).params:
        assert getattr(parameter, "help", None), f"{name}: {parameter.name} says nothing"


def test_help_lists_every_verb_whole(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    for name in VERBS:
        assert f"{name} {first_line(name)}" in text
    assert "5 changes pending" in text


def test_without_arguments_it_shows_the_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([]) == 0
    assert capsys.readouterr().out.startswith("Usage: errpipe")
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"errpipe {errpipe.__version__}\n"


# ---------------------------------------------------------------- the error boundary


@pytest.mark.parametrize(
    "error, code",
    [
        (DataError("bad data"), 3),
        (GateError("no better"), 4),
        (VerifyError("damaged"), 6),
        (ConfigError([Problem("a.yaml", 7, 11, "x", "wrong")]), 2),
        (PermissionError(13, "Permission denied", "x.csv"), 2),
        (KeyError("oops"), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_every_error_has_its_code_and_one_document(
    error: BaseException, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(*_: Any, **__: Any) -> None:
        raise error

    monkeypatch.setattr("errpipe.cli._pipeline.load_pipeline_file", fail)
    assert main(["plan", "p.yaml", "--json"]) == code
    heard = capsys.readouterr()
    document = json.loads(heard.out)
    assert document["errpipe"] == 1 and document["command"] == "plan" and document["ok"] is False
    assert document["exit_code"] == code and document["error"]["message"] + "\n" == heard.err
    assert "Traceback" not in heard.err
    if isinstance(error, ConfigError):
        assert document["error"]["problems"] == [
            {"file": "a.yaml", "line": 7, "column": 11, "key": "x", "message": "wrong"}
        ]
    if code == 1:
        assert heard.err.startswith("internal error, please report it: KeyError: 'oops'\n")
        assert main(["plan", "p.yaml", "--debug"]) == 1
        assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["rum"], "no verb 'rum' (errpipe --help lists them). Did you mean run?"),
        (["run"], "errpipe run: missing argument 'PIPELINE'.\n(errpipe run --help shows what is possible)"),
        (["run", "p.yaml", "--jobs", "0"], "errpipe run: invalid value for '--jobs'"),
        (["--nope"], "errpipe: no option --nope."),
        (["eval", "t.ect", "--at", "x"], "--at x: not of the form INPUT=VALUE, such as x=100"),
    ],
)
def test_a_wrong_command_line(arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    heard = capsys.readouterr()
    assert heard.out == "" and heard.err.startswith(message)


def test_a_reader_that_has_gone_is_no_error(where: Path) -> None:
    line = f"{sys.executable} -m errpipe.cli.app --help | true; echo ${{PIPESTATUS[0]}}"
    run = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert run.stderr == "" and int(run.stdout) in (0, 141)


# ---------------------------------------------------------------- check, plan, run


def test_a_summary_says_its_unit() -> None:
    assert (
        _entry_text("largest_difference_from_the_model_um", "0.0051") == "largest difference from the model 0.0051 um"
    )
    assert _entry_text("largest_difference_urad", "0.09") == "largest difference 0.09 urad"
    assert _entry_text("E_Z", "24 -> 3 um") == "E_Z 24 -> 3 um"  # a component keeps its name


def test_run_then_plan(where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["plan", "p.yaml", "--exit-code"]) == 5
    assert capsys.readouterr().out.splitlines()[0] == "take    run      has not run"
    assert main(["run", "p.yaml", "--set", "scale.factor=3 um"]) == 0
    heard = capsys.readouterr()
    assert heard.out.splitlines() == [
        "take: lines 3",
        "scale: numbers 3",
        "thirds: numbers 3",
        "sum: had_lines true, total 57",
    ]
    assert heard.err.splitlines()[:2] == ["take: runs (has not run)", "take: done, 1 file written"]
    assert "\r" not in heard.err
    assert (where / "out" / "p" / "sum" / "sum.json").exists()
    assert main(["plan", "p.yaml", "--exit-code", "--set", "scale.factor=3"]) == 0
    assert main(["plan", "p.yaml", "--json", "--exit-code"]) == 5
    document = json.loads(capsys.readouterr().out.split("\n", 4)[-1])
    assert document["result"]["pending"] is True and document["ok"] is False
    assert document["result"]["stages"][1]["reasons"] == ["params.factor 3.0 -> 2.0"]


def test_run_as_json_is_one_document(where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "p.yaml", "--out", "o", "--to", "scale", "--json", "--jobs", "2"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [stage["name"] for stage in document["result"]["stages"]] == ["take", "scale"]
    assert document["result"]["stages"][1]["written"] == ["parts/0.json"]


def test_stamp_and_depfile(where: Path) -> None:
    line = ["run", "p.yaml", "--out", "o", "--depfile", "o/run.d", "--stamp", "o/run.stamp"]
    assert main(line) == 0
    first = (where / "o" / "run.d").read_text()
    assert first.startswith("o/run.stamp : \\\n  data/a.txt \\\n  data/b.txt \\\n  p.yaml\n")
    os.utime(where / "o" / "run.stamp", (1e9, 1e9))
    times = (where / "o" / "run.d").stat().st_mtime_ns
    assert main(line) == 0
    assert (where / "o" / "run.stamp").stat().st_mtime > 1.5e9
    assert main([*line, "--set", "scale.factor=3"]) == 0  # an input that changes while the last stage runs is newer
    assert (where / "o" / "run.stamp").stat().st_mtime_ns <= (where / "o" / "errpipe.lock").stat().st_mtime_ns
    assert (where / "o" / "run.d").stat().st_mtime_ns == times
    assert main([*line, "--depfile-target", "all of it"]) == 0
    assert (where / "o" / "run.d").read_text().startswith("all\\ of\\ it :")


def test_make_is_content(where: Path) -> None:
    """The recipe of the research notes: a cache hit does not run for ever, a deleted input does not stop make."""
    code = "import sys; import errpipe.stages as s; from tests.unit.pipeline.stages_for_tests import STAGES; "
    code += "s.STAGES = STAGES; from errpipe.cli.app import main; sys.exit(main())"
    command = f'PYTHONPATH={Path(__file__).parents[3]} {sys.executable} -c "{code}"'
    (where / "Makefile").write_text(
        f"o/run.stamp: p.yaml\n\t@{command} run p.yaml --out o --depfile o/run.d --stamp $@\n-include o/run.d\n"
    )

    def make() -> str:
        environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
        run = subprocess.run(["make"], capture_output=True, text=True, check=True, env=environment)
        return run.stdout + run.stderr

    assert "sum: done" in make()
    assert "up to date" in make()
    time.sleep(0.02)
    os.utime(where / "data" / "a.txt")
    assert "sum: nothing to do" in make()
    assert "up to date" in make()
    (where / "data" / "b.txt").unlink()
    assert "take: runs (input data/b.txt is gone)" in make()
    assert "up to date" in make()


def test_check_reports_all_files(where: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (where / "q.yaml").write_text("pipeline: 1\nstages:\n  - {kind: take, files: nowhere}\n")
    (where / "r.yaml").write_text("pipeline: 2\ntitel: x\nstages: []\n")
    assert main(["check", "p.yaml"]) == 0
    assert capsys.readouterr().out == "p.yaml: pipeline, fine\n"
    assert main(["check", "p.yaml", "q.yaml", "r.yaml"]) == 2
    heard = capsys.readouterr()
    assert heard.out == ""
    assert [line.split("  ")[0] for line in heard.err.splitlines()] == [
        "q.yaml:3:25",
        "r.yaml:1:11",
        "r.yaml:2:1",
        "r.yaml:3:9",
    ]
    assert main(["check", "q.yaml", "--no-data"]) == 0
    capsys.readouterr()
    assert main(["check", "r.yaml", "--format", "github"]) == 2
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("::error file=r.yaml,line=1,col=11,title=errpipe::pipeline: found the number 2")


def test_a_terminal_gets_a_bar_and_a_log_does_not(where: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from io import StringIO

    from errpipe.cli.progress import ProgressReporter

    class Terminal(StringIO):
        def isatty(self) -> bool:
            return True

    for name in ("CI", "NO_COLOR"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("TERM", "xterm")
    for stream, bar in ((Terminal(), True), (StringIO(), False)):
        ProgressReporter("out", stream).callbacks().progress("fit", 0.5, "half")
        assert (stream.getvalue() == "\r\033[Kfit [############............] half") is bar
    monkeypatch.setenv("NO_COLOR", "1")
    assert not ProgressReporter("out", Terminal()).moving


@pytest.mark.parametrize("options", [[], ["--no-data"], ["--json"], ["--no-data", "--json"]])
@pytest.mark.parametrize("text", ["machine: {}\n", "pipeline: 7\n", "a: [\n", "recording: 1\n"])
def test_the_short_way_of_a_check_says_what_typer_says(
    options: list[str], text: str, tmp_path: Path, capsys: Any
) -> None:
    """Two options take the way through typer: `--format text` changes nothing but that."""
    (tmp_path / "a.yaml").write_text(text)
    words = ["check", str(tmp_path / "a.yaml"), str(tmp_path / "none.yaml"), *options]
    short = main(words), *capsys.readouterr()
    assert (main([*words, "--format", "text"]), *capsys.readouterr()) == short
    assert short[0] == 2


def test_a_check_loads_no_typer() -> None:
    code = "from errpipe.cli.app import main; import sys; main(['check', 'pipelines/ball-screw-axis.yaml']); "
    code += "print('typer' in sys.modules, 'email' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "False False"
