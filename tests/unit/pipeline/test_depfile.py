"""Dependency files, judged by make itself."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

from errpipe.errors import UsageError
from errpipe.pipeline.depfile import depfile, inputs_of, touch
from errpipe.pipeline.spec import load_pipeline
from tests.unit.pipeline.stages_for_tests import STAGES, write_stages

NAMES = [
    "plain.csv",
    "a b",
    "a#b",
    "a$b",
    "a=b",
    "a:b",
    "a%b",
    "a|b",
    "a&b",
    "c&",
    "a?b",
    "a*b",
    "a[b]",
    "~a",
    "a\\b",
    "a\\ b",
    "a\\#c",
    "a\\%b",
    "ü",
    "(x)",
    "a(1).csv",
    "{x}",
    "q'uote",
    '"dq"',
    "a,b",
    "a!b",
    "@a",
    "-a",
    "a+b",
]


def make(*arguments: str) -> subprocess.CompletedProcess[str]:
    # `make test` hands its own flags and depth down to us; this make must not know of them
    environment = {name: value for name, value in os.environ.items() if not name.startswith(("MAKE", "MFLAGS"))}
    return subprocess.run(["make", *arguments], capture_output=True, text=True, check=False, env=environment)


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not here")
def test_make_reads_every_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Makefile").write_text("-include run.d\nrun.stamp:\n\t@echo runs\n")
    (tmp_path / "run.stamp").write_text("")
    (tmp_path / "run.d").write_text(depfile("run.stamp", [Path(name) for name in NAMES]))
    for name in NAMES:
        (tmp_path / name).write_text("x")
        os.utime(name, (1e9, 1e9))
    os.utime("run.stamp", (1.1e9, 1.1e9))
    assert make("run.stamp").stdout == "make: 'run.stamp' is up to date.\n"
    for name in NAMES:
        os.utime(name, (1.2e9, 1.2e9))
        assert make("run.stamp").stdout == "runs\n", f"newer {name!r} not seen"
        (tmp_path / name).unlink()
        assert make("run.stamp").stdout == "runs\n", f"deleted {name!r} stops make"
        (tmp_path / name).write_text("x")
        os.utime(name, (1e9, 1e9))


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not here")
@pytest.mark.parametrize("target", ["out dir/run.stamp", "a=b.stamp", "a$b", "a:b", "c&"])
def test_make_reads_every_target(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, target: str) -> None:
    monkeypatch.chdir(tmp_path)
    Path(target).parent.mkdir(exist_ok=True)
    Path(target).write_text("")
    Path("x.csv").write_text("")
    Path("Makefile").write_text(depfile(target, [Path("x.csv")]))
    os.utime(target, (1e9, 1e9))
    assert f"is newer than target '{target}'" in make("-d", "-n").stdout


@pytest.mark.parametrize("name", ["a\nb", "a;b", "end\\", "log (2)"])
def test_what_make_cannot_read_is_refused(name: str) -> None:
    with pytest.raises(UsageError, match="make cannot read"):
        depfile("x", [Path(name)])


def test_every_input_is_listed(tmp_path: Path) -> None:
    pipeline = load_pipeline(write_stages(tmp_path), STAGES)
    assert [path.name for path in inputs_of(pipeline, pipeline.stages)] == ["a.txt", "b.txt", "p.yaml"]


def test_the_stamp_always_gets_the_time_when_the_run_began(tmp_path: Path) -> None:
    stamp = tmp_path / "deep" / "run.stamp"
    for begun in (2_000_000_000_000_000_000, 1_000_000_000_000_000_000):
        touch(stamp, begun)
        assert stamp.stat().st_mtime_ns == begun
