"""errpipe under GNU make: what is remade, what is not, and what a failed gate leaves behind."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = [
    pytest.mark.slow,
    pytest.mark.toolchain,
    pytest.mark.skipif(shutil.which("make") is None, reason="GNU make is not installed"),
]

# The command line with three cheap stages and a gate in place of errpipe's own.
DRIVER = """
import sys
from typing import ClassVar, Literal
import errpipe.stages
from errpipe.errors import GateError
from tests.unit.pipeline.stages_for_tests import STAGES, Take
from errpipe.pipeline.stage import InputPath, Need, Stage

class Gate(Stage):
    kind: Literal["export"]
    limit: float = 100.0
    gives: ClassVar = ("table",)
    takes: ClassVar = {"lines": Need("lines")}
    def outputs(self): return ("table.ect",)
    def run(self, context):
        numbers = [float(x) for x in (context.needed("lines") / "lines.txt").read_text().split()]
        if sum(numbers) > self.limit:
            raise GateError(f"gate: {sum(numbers):g} is more than {self.limit:g}")
        context.write_text("table.ect", f"{sum(numbers):.0f}\\n")
        return {}

with open("done.txt", "a") as stream:
    stream.write(f"run {sys.argv[2].removesuffix('.yaml')}\\n")
errpipe.stages.STAGES = (*STAGES, Gate)
from errpipe.cli.app import main
sys.exit(main(sys.argv[1:]))
"""
MAKEFILE = """
ERRPIPE := {python} driver.py
OUT := out
all: $(foreach m,a b,out/$m/installed)
include {pipelines}
out/%/installed: out/%/export/table.ect
\t@echo install $* >> done.txt
\t@cp $< $@
"""
PIPELINES = Path(__file__).parents[3] / "pipelines" / "Makefile"
DATA = "data $x #1:2"  # a folder whose name make would take apart


def make(where: Path, *words: str) -> tuple[int, list[str]]:
    """Exit code, and which pipelines ran and which tables were installed. The last output stays in make.log."""
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("MAKE", "MFLAGS"))}
    environment["PYTHONPATH"] = str(Path(__file__).parents[3])
    done = subprocess.run(["make", *words], cwd=where, capture_output=True, text=True, env=environment, timeout=300)
    (where / "make.log").write_text(done.stdout + done.stderr)
    ran = where / "done.txt"
    lines = sorted(ran.read_text().splitlines()) if ran.exists() else []
    ran.unlink(missing_ok=True)
    return done.returncode, lines


def test_a_day_with_make(tmp_path: Path) -> None:
    for machine in "ab":
        folder = tmp_path / DATA / machine
        folder.mkdir(parents=True)
        (folder / "one log.txt").write_text("1\n2\n")
        (folder / "other.txt").write_text("3\n")
        text = f"pipeline: 1\nstages:\n  - {{kind: take, files: '{DATA}/{machine}'}}\n  - {{kind: export}}\n"
        (tmp_path / f"{machine}.yaml").write_text(text)
    (tmp_path / "driver.py").write_text(DRIVER)
    (tmp_path / "Makefile").write_text(MAKEFILE.format(python=sys.executable, pipelines=PIPELINES))
    (tmp_path / "out").mkdir()
    a = tmp_path / DATA / "a"

    # both at a time, each once; then nothing
    assert make(tmp_path, "-j", "2") == (0, ["install a", "install b", "run a", "run b"]), (
        tmp_path / "make.log"
    ).read_text()
    assert (tmp_path / "out/a/installed").read_text() == "6\n"
    assert make(tmp_path, "-j", "2") == (0, [])

    # -n writes nothing
    (a / "other.txt").write_text("4\n")
    before = (tmp_path / "out/a/errpipe.lock").read_bytes()
    assert make(tmp_path, "-n")[0] == 0 and (tmp_path / "out/a/errpipe.lock").read_bytes() == before
    assert make(tmp_path) == (0, ["install a", "run a"])
    assert (tmp_path / "out/a/installed").read_text() == "7\n"

    # an input whose bytes change while the table does not: nothing behind the table is remade
    (a / "other.txt").write_text("4.0\n")
    assert make(tmp_path) == (0, ["run a"])
    assert make(tmp_path) == (0, [])

    # a failed gate: the old table stays, what is behind it stays, and make comes back to it
    (a / "other.txt").write_text("4000\n")
    code, lines = make(tmp_path)
    assert code == 2 and lines == ["run a"]
    assert "gate: 4003 is more than 100" in (tmp_path / "make.log").read_text()
    assert (tmp_path / "out/a/export/table.ect").read_text() == "7\n" == (tmp_path / "out/a/installed").read_text()
    assert make(tmp_path) == (2, ["run a"])  # the stamp is still older than the data
    (a / "other.txt").write_text("5\n")
    assert make(tmp_path) == (0, ["install a", "run a"])

    # an input that is deleted does not stop make
    (a / "one log.txt").unlink()
    assert make(tmp_path) == (0, ["install a", "run a"])
    assert (tmp_path / "out/a/installed").read_text() == "5\n"

    # a pipeline whose name make would take apart is named, not looked for in parts
    (tmp_path / "my axis.yaml").write_text("pipeline: 1\n")
    assert make(tmp_path)[0] == 2 and "a space in its name" in (tmp_path / "make.log").read_text()


def test_a_template_under_make(tmp_path: Path) -> None:
    """The folder that `errpipe init` writes, its recording under a name that make would take apart."""
    from errpipe.cli.app import main

    site = tmp_path / "mill"
    assert main(["init", "--template", "dial-gauge", str(site)]) == 0
    (site / "recording").rename(site / DATA)
    pipeline = site / "pipeline.yaml"
    pipeline.write_text(pipeline.read_text().replace("recording: recording", f"recording: '{DATA}'"))
    (site / "errpipe").write_text(f'#!/bin/sh\necho run >> done.txt\nexec "{sys.executable}" -m errpipe "$@"\n')
    (site / "errpipe").chmod(0o755)
    with (site / "Makefile").open("a") as stream:
        stream.write("installed: out/export/table.ect\n\t@echo install >> done.txt\n\t@cp $< $@\n")
    words = ("ERRPIPE=./errpipe", "installed")
    assert make(site, *words) == (0, ["install", "run"]), (site / "make.log").read_text()
    assert make(site, "-j", "2", *words) == (0, [])
    table = (site / "out/export/table.ect").read_bytes()

    # bytes of the pipeline change, the table does not
    pipeline.write_text(pipeline.read_text() + "# nobody reads this\n")
    assert make(site, "-n", *words)[1] == []
    assert make(site, *words) == (0, ["run"]) and make(site, *words) == (0, [])

    # a table that was deleted is made again, and is what it was
    (site / "out/export/table.ect").unlink()
    assert make(site, *words) == (0, ["install", "run"]) and make(site, *words) == (0, [])
    assert (site / "out/export/table.ect").read_bytes() == table

    # noise in place of the machine's error: the gate says no, the old table stays, and make comes back to it
    rows = next((site / DATA).glob("*.csv"))
    lines = rows.read_text().splitlines()
    commanded, reading = (lines[0].split(",").index(name) for name in ("commanded", "reading"))
    noise = [line.split(",") for line in lines]
    for k, cells in enumerate(noise[1:]):
        cells[reading] = f"{float(cells[commanded]) + (k * 7919 % 13 - 6) / 300:.3f}"
    rows.write_text("\n".join([*map(",".join, noise), ""]))
    code, ran = make(site, *words)
    assert code == 2 and ran == ["run"] and "Error 4" in (site / "make.log").read_text()
    assert (site / "out/export/table.ect").read_bytes() == table == (site / "installed").read_bytes()
    assert make(site, *words) == (2, ["run"])

    # an input that is gone is no missing rule: errpipe says what is missing
    rows.unlink()
    code, ran = make(site, *words)
    assert code == 2 and ran == ["run"] and "No rule" not in (site / "make.log").read_text()
    rows.write_text("\n".join([*lines, ""]))
    assert make(site, *words)[0] == 0 and (site / "installed").read_bytes() == table
