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


def test_the_program_is_for_the_stated_bar(tmp_path, capsys):
    growth = [word for c in ("X0S", "Y0S", "Z0S", "A0S", "B0S") for word in ("--without", c)]
    call = ["measure", str(MACHINE), "--out", str(tmp_path / "p.ngc"), "--positions", "8", *growth, "--reach"]
    assert main([*call, "300", "700"]) == 0
    text = (tmp_path / "p.ngc").read_text()
    lengths = [float(v) for v in re.findall(r"attach the bar: ([\d.]+) mm", text)]
    assert "for a bar of 300 to 700 mm" in text and min(lengths) > 300.0 and max(lengths) < 700.0
    for low, high in (("700", "300"), ("0", "300"), ("300", "303"), ("300", "inf"), ("nan", "300")):
        assert main([*call, low, high]) == 2
        assert "shortest and longest length" in capsys.readouterr().err


def test_an_axis_with_a_number_is_no_word_of_a_program(tmp_path, capsys):
    text = MACHINE.read_text().replace("X:", "X2:").replace("X'", "X2'")
    (tmp_path / "m.yaml").write_text(text)
    assert main(["measure", str(tmp_path / "m.yaml"), "--out", str(tmp_path / "p.ngc"), "--positions", "8"]) == 3
    assert "axis X2 is no word of an NC program" in capsys.readouterr().err
    assert not (tmp_path / "p.ngc").exists()
