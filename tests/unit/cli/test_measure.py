"""A measuring plan is a program that LinuxCNC's own dialect understands, and it names what it leaves open."""

import re
from pathlib import Path

from errpipe.cli.app import main
from errpipe.ncprogram.modal import Setup
from tests.nc import correct

MACHINE = Path(__file__).parents[3] / "examples" / "machines" / "vertical-centre.yaml"


def test_a_plan_is_a_program(tmp_path, capsys):
    growth = [word for c in ("X0S", "Y0S", "Z0S", "A0S", "B0S") for word in ("--without", c)]
    assert main(["measure", str(MACHINE), "--out", str(tmp_path / "p.ngc"), "--positions", "12", *growth]) == 0
    said = capsys.readouterr().out
    assert re.search(r"minutes: \d", said)
    text = (tmp_path / "p.ngc").read_text()
    points = len(re.findall(r"^(?:N\d+ )?G[01] .*X", text, re.M))
    assert points >= 24
    again, done = correct(text, lambda p, tool: 0.0 * p, Setup(offsets={"G54": (0.0, 0.0, 0.0)}, start=(0.0, 0.0, 0.0)))
    assert done.moves >= points and "M0" in again


def test_an_unknown_component_is_named(tmp_path, capsys):
    assert main(["measure", str(MACHINE), "--out", str(tmp_path / "p.ngc"), "--without", "EXZZ"]) == 2
    assert "no such component" in capsys.readouterr().err
    assert not (tmp_path / "p.ngc").exists()
