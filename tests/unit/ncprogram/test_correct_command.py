"""`errpipe correct`: what it says of a program that it had to take in one way, and what it does with the files."""

import pytest

from errpipe.cli.app import main
from errpipe.ncprogram import writer
from errpipe.tables import ect
from errpipe.verbs.correct import correct as correct_file
from errpipe.verbs.correct import remarks_on_words, unset_modal_states
from tests.unit.targets import machines


def test_what_a_program_cannot_correct_is_reported(tmp_path):
    table = machines.two_outputs()
    first, *others = table.outputs
    turned = first.model_copy(update={"axis": "C"})
    ect.write(table.model_copy(update={"outputs": (turned, *others)}), tmp_path / "t.ect")
    (tmp_path / "p.ngc").write_text("G90 G21 G54\nG0 X100 Y0 Z0\n")
    done = correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {})
    assert done["not_corrected"] == f"{first.name}: programs are corrected in X, Y and Z only"
    ect.write(table, tmp_path / "t.ect")
    assert "not_corrected" not in correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {})


def test_a_program_with_a_rotary_axis_says_how_it_was_taken():
    remark = remarks_on_words("(C1)\nG0 X1. c-90\n")["rotary"]
    assert remark.startswith("line 2: c-90 is taken as of an axis that counts on")
    assert remarks_on_words("(C1)\nG0 X1 ; A2\n").get("rotary", "") == ""


def test_an_input_that_is_given_twice_is_refused(tmp_path, capsys):
    assert main(["eval", str(tmp_path / "t.ect"), "--at", "T=20", "--at", "T=30"]) == 2
    assert "--at T=30: T was given before (20)" in capsys.readouterr().err


def test_places_beyond_the_table_and_a_zero_that_was_not_stated_are_named(tmp_path):
    """Where the ends of a table hold, a wrong offset, inches or least increments would pass unseen."""
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")  # measured from X = 0 to 500
    (tmp_path / "p.ngc").write_text("G90 G21 G54\nG0 X100 Y0 Z0\nG1 X800 F500\n")
    done = correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {})
    assert "G54 is taken as 0,0,0" in done["offsets"]
    assert "X moves from 100 to 800 mm of the machine, the table covers 0 to 500" in done["outside_what_was_measured"]
    done = correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {}, offsets=["G54=-350,0,0"])
    assert "X moves from -250 to 450 mm" in done["outside_what_was_measured"] and "offsets" not in done
    done = correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {}, offsets=["G55=-350,0,0"])
    assert "G54 is taken as 0,0,0" in done["offsets"]
    (tmp_path / "p.ngc").write_text("G90 G21 G54\nG0 X100 Y0 Z0\nG1 X400 F500\n")
    assert "outside_what_was_measured" not in correct_file(tmp_path / "p.ngc", tmp_path / "t.ect", None, {})


def test_a_program_is_not_replaced_by_its_correction(tmp_path, capsys):
    """The same command once more would correct what is corrected."""
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")
    program = tmp_path / "p.ngc"
    program.write_text("G90 G21 G54\nG0 X100 Y0 Z0\n")
    (tmp_path / "link.ngc").symlink_to(program)
    for out in (program, tmp_path / "link.ngc"):
        assert main(["correct", str(program), "--table", str(tmp_path / "t.ect"), "--out", str(out)]) == 2
        assert "is the program itself" in capsys.readouterr().err
    assert program.read_text() == "G90 G21 G54\nG0 X100 Y0 Z0\n"


@pytest.mark.parametrize("lines_at_once", [1, 10_000])
@pytest.mark.parametrize(
    ("head", "comment"),
    [
        ("", "({})"),
        ("%\n", "({})"),
        ("%\nO1234 (UPPER POCKET)\n", "({})"),
        ("\n%\n\nN5 o7\n", "({})"),
        ("%\n; upper pocket\n", ";{}"),
        ("O0001 ; number\n(milled twice)\n", "({})"),
    ],
)
def test_a_corrected_program_names_its_table_below_its_head_and_is_corrected_once(
    tmp_path, capsys, monkeypatch, head, comment, lines_at_once
):
    monkeypatch.setattr(writer, "MAX_POINTS", lines_at_once)
    table = machines.too_long_at_plus_x()
    ect.write(table, tmp_path / "t.ect")
    (tmp_path / "p.ngc").write_text(f"{head}G90 G21 G54\nG0 X100 Y0 Z0\nG1 X400 F500\nM30\n")
    words = ["correct", "--table", str(tmp_path / "t.ect"), str(tmp_path / "p.ngc")]
    assert main([*words, "--out", str(tmp_path / "once.ngc")]) == 0
    once = (tmp_path / "once.ngc").read_text()
    mark = comment.format(f"CORRECTED BY ERRPIPE, TABLE {ect.fingerprint(table).upper()}")
    kept = "".join(line for line in head.splitlines(keepends=True) if line[0] not in ";(")
    assert once.startswith(f"{kept}{mark}\n{head.removeprefix(kept)}G90 G21 G54\nG0 X") and once.count(mark) == 1
    words[-1] = str(tmp_path / "once.ngc")
    assert main([*words, "--out", str(tmp_path / "twice.ngc")]) == 3 and not (tmp_path / "twice.ngc").exists()
    line = kept.count("\n") + 1
    assert f"once.ngc, line {line}: {mark!r}: this program is corrected already" in " ".join(
        capsys.readouterr().err.split()
    )
    (tmp_path / "once.ngc").write_text(once.lower())  # an editor that has no capitals
    assert main([*words, "--out", str(tmp_path / "twice.ngc")]) == 3
    assert main([*words, "--out", str(tmp_path / "twice.ngc"), "--again"]) == 0


LONG = "N1000 G1 X99.5 Y88.25 Z70.5 A123.4567 B45.6789 C359.1234 F1500.5 S12000 M8 (finish pass of the upper pocket)"


def test_a_printed_program_is_the_written_one_to_the_byte_and_its_remarks_go_to_standard_error(tmp_path, capsys):
    """A block that is folded for a terminal would be two motions; a remark that is not shown is none."""
    ect.write(machines.too_long_at_plus_x(), tmp_path / "t.ect")
    (tmp_path / "p.ngc").write_text(
        f"%\nG90 G21 G54  (two  blanks)\nG0 X0 Y0 Z0 A0 B0 C300\n\n{LONG}\nG1 X800\nM30\n%\n\n"
    )
    words = ["correct", str(tmp_path / "p.ngc"), "--table", str(tmp_path / "t.ect")]
    assert main([*words, "--out", str(tmp_path / "o.ngc")]) == 0
    said = capsys.readouterr().out
    assert main(words) == 0
    printed = capsys.readouterr()
    assert printed.out == (tmp_path / "o.ngc").read_text()
    assert all(len(line) <= 80 for line in printed.err.splitlines())
    for remark in ("offsets: no --offset", "outside_what_was_measured: X moves", "whole_numbers: line 6"):
        assert remark in printed.err and remark in said


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("G0 X100 Y0.", "X100"),
        ("G2 X0. Y0. I-25", "I-25"),
        ("g1 z -5", "z -5"),
        ("N10 G1 X1.5 (X100) Y0 Z-0 F100 S3000", ""),
        ("G1 X10. ; then X20", ""),
        ("G1 X.5 Y+0. Z100.", ""),
    ],
)
def test_lengths_without_a_point_are_named(line, found):
    """On a Fanuc that counts them in thousandths the corrected program, which has points, goes 1000 times further."""
    says = remarks_on_words(f"G21 G90 G54\n{line}\n").get("whole_numbers", "")
    assert says.startswith(f"line 2: {found} has no decimal point") if found else says == ""


@pytest.mark.parametrize("line", ["G96 S200 M3", "G50 S2000", "N5 g92 s1800", "T0101", "T1212 M6"])
def test_a_turning_program_says_that_x_was_taken_as_a_radius(line):
    turned = f"G21 G18 G99 G54\n{line}\nG0 X50."
    milled = "G90 (G96 is a lathe's)\nT12 M6\nT1234\nT0100\nG97 S1000 M3\nX5."
    assert "do not use the corrected program" in remarks_on_words(turned)["diameters"]
    assert remarks_on_words(milled) == {}


@pytest.mark.parametrize(
    ("program", "left"),
    [
        ("G90 G54\nG0 X0 Y0.\nX5.", "line 3: X5 comes before any G20 or G21 (taken as mm)"),
        ("G21\nG0 X0\nY-.5\nG90", "line 3: Y-.5 comes before any G90 or G91 (taken as absolute)"),
        ("(G21 G90)\nG1 Z5", "line 2: Z5 comes before any G20 or G21 (taken as mm) and any G90 or G91"),
        ("G91 G28 Z0\nG20 G90 G0 X3", ""),
        ("g0g021g90x3", ""),
        ("G54 G0 X0 Y0", ""),
    ],
)
def test_what_a_program_leaves_to_the_state_of_its_control_is_reported(program, left):
    """On a control that starts in inches the corrected program would be wrong by 25.4 times the correction."""
    assert unset_modal_states(program).startswith(left) and bool(unset_modal_states(program)) == bool(left)
