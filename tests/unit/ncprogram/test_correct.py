"""A corrected program makes the uncorrected machine cut the wanted part; what is not understood is refused whole."""

import math
import re

import numpy as np
import pytest

from errpipe.errors import DataError
from errpipe.ncprogram.modal import Setup
from tests.nc import CUTS, bent, correct, too_long_at_plus_x

SETUP = Setup(
    offsets={"G54": (100.0, 50.0, -200.0), "G55": (300.0, 50.0, -200.0)}, tools={1: 80.0}, start=(0.0, 0.0, 0.0)
)


def no_deviation(points, tool_length):
    return np.zeros_like(points)


def numbers(text, letter):
    return [float(v) for v in re.findall(rf"{letter}([-+]?[\d.]+)", text)]


def test_machine_10_um_too_long_is_commanded_less_far():
    text, summary = correct("G90 G21 G54\nG0 Z10\nG0 X400 Y0\n", too_long_at_plus_x, SETUP)
    assert numbers(text, "X")[-1] == pytest.approx(400 - 0.010, abs=1.01e-4)  # X400 in the part is X500 of the machine
    assert summary.largest_correction == pytest.approx(0.010, rel=1e-3)


def test_nothing_to_correct_leaves_straight_moves_as_they_were():
    text, _ = correct("N10 G90 G21 G54 (start)\nN20 G1 X20 Y5 Z1 F300 ; cut\n", no_deviation, SETUP)
    assert text.splitlines()[0] == "N10 G90 G21 G54 (start)"
    first = text.splitlines()[1]
    assert first.startswith("N20 G1 F300 X")
    assert "; cut" in first


PROGRAM = f"%\nN5 G17 G21 G90 G54 G94\nN10 T1 M6\n{CUTS}"


@pytest.mark.parametrize("deviation", [too_long_at_plus_x, bent], ids=["too long", "bent"])
def test_uncorrected_machine_follows_the_wanted_path(deviation):
    """Both programs through the same reader: command of one + deviation = tool point of the other."""
    wanted = tool_points(PROGRAM, no_deviation)
    commanded = tool_points(PROGRAM, deviation)
    assert len(wanted) == len(commanded)
    for (p, length), (c, length2) in zip(wanted, commanded, strict=True):
        assert length == length2
        assert c + deviation(c[None, :], length)[0] == pytest.approx(p, abs=2.5e-4)


def tool_points(program, deviation):
    """Machine coordinates after each straight block of a corrected program, and the tool length then in force."""
    text, _ = correct(program, deviation, SETUP, longest=10.0)
    out, at, offset, length = [], [0.0, 0.0, 0.0], "G54", 0.0
    absolute, unit = True, 1.0
    for line in text.splitlines():
        line = re.sub(r"\(.*?\)|;.*", "", line)
        zero = SETUP.offsets[offset]
        if "G55" in line:
            at = [a + o - n for a, o, n in zip(at, zero, SETUP.offsets["G55"], strict=True)]
            offset = "G55"
        if "G43" in line:
            at[2] -= 80.0 - length
            length = 80.0
        if "G49" in line:
            at[2] += length
            length = 0.0
        absolute = {"G90": True, "G91": False}.get(next(iter(re.findall(r"G9[01](?![.\d])", line)), ""), absolute)
        unit = {"G20": 25.4, "G21": 1.0}.get(next(iter(re.findall(r"G2[01]", line)), ""), unit)
        assert not re.search(r"G[23](?!\d)", line)
        by_name = {k: float(v) * unit for k, v in re.findall(r"([XYZ])([-+]?[\d.]+)", line)}
        if not by_name:
            continue
        for n, k in enumerate("XYZ"):
            if k in by_name:
                at[n] = by_name[k] if absolute else at[n] + by_name[k]
        machine = np.array(at) + SETUP.offsets[offset] + [0.0, 0.0, length]
        out.append((machine, length))
    return out


@pytest.mark.parametrize("chord", [0.1, 0.01, 0.001])
def test_arc_segments_stay_within_the_chord_error(chord):
    circle = "G90 G21 G54 G0 X50 Y0 Z0\nG3 X50 Y0 I-50 J0 F500\n"
    text, summary = correct(circle, no_deviation, SETUP, chord_error=chord)
    x, y = np.array(numbers(text, "X")), np.array(numbers(text, "Y"))
    middle = np.hypot((x[1:] + x[:-1]) / 2, (y[1:] + y[:-1]) / 2)
    assert summary.largest_chord_error <= chord
    assert np.max(50.0 - middle) <= chord + 2e-4
    assert summary.blocks_out >= math.pi / math.acos(1 - chord / 50)


@pytest.mark.parametrize(
    ("line", "why"),
    [
        ("G1 X[1+2]", "an expression in brackets"),
        ("#1=3", "a parameter"),
        ("O100 SUB", "is not a word"),
        ("O100", "a subroutine"),
        ("G50 X100 Z200", "axis words beside G50"),
        ("G41 D1", "G41 is not understood"),
        ("G81 X1 Y1 Z-5 R2", "G81 is not understood"),
        ("G92 X0", "G92 is not understood"),
        ("G93", "G93 is not understood"),
        ("G53 G1 Z0", "G53 is understood with G0"),
        ("G4 P1 G28 Z0", "G4 and G28 in one block contradict"),
        ("M6\nG1 X5 Y5", "the position of Z is not known at the start or after a tool change"),
        ("G28 Z0\nG91 G0 Z5", "an increment in Z, but the position of Z is not known"),
        ("G56 G0 X0", "the work offset G56 is missing"),
        ("G43 H7", "the tool length of H7 is missing"),
        ("G1 X1 X2", "a word occurs twice"),
        ("G1 X1 (open", "a comment that is not closed"),
        ("G2 X1 Y1", "an arc without centre"),
        ("G2 X10 Y0 I1 J0", "the arc's radius is"),
        ("/G1 X1", "block delete switch"),
        ("G1 X1 Q=3", "is not a word"),
        ("M98 P100", "M98 is not understood"),
        ("G64 P0.01 G1 X1", "the word P beside a straight move"),
        ("G1 X1 R2", "the word R beside a straight move"),
        ("G1 X1 I5", "the word I beside a straight move"),
        ("G0 Z100 H1", "the word H without G43"),
        ("G0 X10 D1", "the word D without G41"),
    ],
)
def test_what_is_not_understood_is_refused_with_its_line(line, why):
    with pytest.raises(DataError, match=f"line {2 + line.count(chr(10))}") as caught:
        correct("G90 G21 G54 G0 X0 Y0 Z0\n" + line + "\n", no_deviation, SETUP)
    assert why in str(caught.value)


def test_unknown_place_is_refused_not_guessed():
    with pytest.raises(DataError, match="the position of X and Y is not known"):
        correct("G90 G21 G54\nG1 Z10\n", no_deviation, Setup(offsets=SETUP.offsets))


@pytest.mark.parametrize("away", ["T2 M6", "G91 G28 Z0\nG90", "G53 G0 Z0", "G30 P2 Z0", "M60"])
def test_no_move_brings_z_back_down_from_where_the_control_sent_it(away):
    """Behind a tool change a move in X and Y says nothing of Z, whose correction varies with X: nor may the output."""
    text, _ = correct(f"O0007 (bracket)\nG90 G21 G54\nG0 X0 Y0 Z5\n{away}\nG0 X300 Y200\nG43 H1 Z50\n", bent, SETUP)
    *_, across, down, end = text.split("\n")
    assert across == "G0 X300 Y200" and end == ""
    assert down.startswith("G43 H1 X") and numbers(down, "X")[0] == pytest.approx(
        300 - bent_at(300, 200, 50)[0], abs=1e-4
    )


def test_rapid_moves_at_the_start_stay_until_every_axis_is_known():
    text, _ = correct(
        "G90 G21 G54\nG0 Y10 X400\nG43 H1 Z50 (down)\nG1 Z-5 F100\n", bent, Setup(SETUP.offsets, {1: 80.0})
    )
    across, down = text.splitlines()[1:3]
    assert across == "G0 Y10 X400"
    wanted = np.array([400.0, 10.0, 50.0]) - bent_at(400, 10, 50)
    assert [numbers(down, letter)[-1] for letter in "XYZ"] == pytest.approx(wanted, abs=1.01e-4)


def bent_at(x, y, z):
    """Deviation of `bent` at a place of the part in G54 with tool H1."""
    return bent(np.array([[x + 100.0, y + 50.0, z - 200.0 + 80.0]]), 80.0)[0]


def test_outside_the_table_is_refused():
    def holed(points, tool_length):
        return np.where(points[:, :1] > 300, np.nan, 0.0) * np.ones(3)

    with pytest.raises(DataError, match="line 3: the table has no value here"):
        correct("G90 G21 G54\nG0 X0 Y0 Z0\nG1 X250\n", holed, SETUP)


def test_two_outputs_of_an_axis_and_both_directions_are_counted():
    """Outputs that share an axis add up; lost motion counts with the mean of its two sides, and that is stated."""
    from errpipe.verbs.correct import depends_on_direction, deviation_of
    from tests.unit.targets import machines

    at_500 = np.array([[500.0, 0.0, 0.0]])
    assert deviation_of(machines.two_outputs(), {})(at_500, 0.0)[0] == pytest.approx([0.014, 0.0, 0.0], abs=1e-5)
    wavy = machines.wavy_both_directions()
    mean = 10.0 + 12.0 * math.sin(500 / 60.0)
    assert depends_on_direction(wavy) and not depends_on_direction(machines.two_outputs())
    assert deviation_of(wavy, {})(at_500, 0.0)[0, 0] == pytest.approx(1e-3 * mean, abs=1e-5)


@pytest.mark.parametrize(("axis", "output"), [("", "EXX (no axis)"), ("C", "EXX (axis C)")])
def test_a_table_that_moves_no_linear_axis_corrects_no_program(axis, output):
    """The program came back as it was, without a word."""
    from errpipe.errors import GateError
    from errpipe.verbs.correct import deviation_of
    from tests.unit.targets import machines

    table = machines.too_long_at_plus_x()
    other = table.model_copy(update={"outputs": tuple(o.model_copy(update={"axis": axis}) for o in table.outputs)})
    with pytest.raises(GateError, match=re.escape(f"the table corrects {output}; programs are corrected in")):
        deviation_of(other, {})


@pytest.mark.parametrize("bulk", [True, False])
@pytest.mark.parametrize("arc", ["G2 X30 Z-5 R9", "g3 z-5 i5 r9", "G2 Z-5 I5", "G3 X40 R10", "G2 X40 I10"])
def test_an_arc_of_no_y_before_a_plane_was_named_is_refused(arc, bulk):
    """On a lathe, which begins with G18, it was cut into moves of X and Y: Y moved by half the chord."""
    with pytest.raises(DataError, match="line 2: an arc without Y or J before any plane was named"):
        correct(f"G90 G21 G54 G0 X20 Y0 Z0\n{arc}\n", no_deviation, SETUP, bulk=bulk)
    said, _ = correct("G90 G21 G18 G0 X20 Y0 Z0\nG2 X30 Z-5 R9\n", no_deviation, SETUP, bulk=bulk)
    assert set(numbers(said, "Y")) == {0.0}
    for mill in ("G2 X30 Y10 R9", "G2 X30 Y10 Z-5 R9", "G2 X40 I10 J0", "G17 X20\nG3 X40 R10"):  # no lathe's
        correct(f"G90 G21 G54 G0 X20 Y0 Z0\n{mill}\n", no_deviation, SETUP, bulk=bulk)


@pytest.mark.parametrize("bulk", [True, False])
@pytest.mark.parametrize(
    "cut", ["G1 X20 A45", "z-30 c2", "N7 G1 X20 Z-5 A170 F.2", "G91 G1 X20 C-1", "A45\nX20 Z-5 A30"]
)
def test_an_angle_or_chamfer_of_the_drawing_is_no_rotary_axis(cut, bulk):
    """On a lathe X20 A45 says where the cut ends: in a cut of several parts each would have ended so."""
    head = "G21 G90 G18 G54 G0 X0 Y0 Z0\nG1 X5 F100\n"
    for plane in ("G18", "G19", ""):
        with pytest.raises(DataError, match=r"line 3: .* may be an angle or a chamfer of the drawing"):
            correct(f"{head.replace('G18', plane)}{cut}\n", no_deviation, SETUP, bulk=bulk)
    correct(f"{head}G0 A0 C0\n{cut}\n", no_deviation, SETUP, bulk=bulk)
    for mill in ("G17\nG1 X20 A45", "G1 X20 Y5 A45", "G0 X20 A45"):
        correct(f"{head}{mill}\n", no_deviation, SETUP, bulk=bulk)


@pytest.mark.parametrize("bulk", [True, False])
def test_a_cut_that_turns_an_axis_the_long_way_round_is_refused_where_it_is_split(bulk):
    """From C350 to C10 a control goes 20 deg forwards, or 340 back: in four parts it always went back."""
    head = "G21 G90 G17 G54 G0 X0 Y0 Z0 C350\n"
    with pytest.raises(DataError, match=r"line 2: C from 350 to 10 is the long way round"):
        correct(f"{head}G1 X100 C10 F100\n", no_deviation, SETUP, bulk=bulk)
    for clear in (
        "G1 X100 C370",
        "G1 X20 C10",
        "G0 X100 C10",
        "G1 X100 C180\nX200 C10",
        "G1 X100 C-3600",
        "G91 G1 X99 C20",
    ):
        correct(f"{head}{clear}\n", no_deviation, SETUP, bulk=bulk)


@pytest.mark.parametrize("skipped", ["/X0 Y0 I5 J0", "/G0 X0", "/G1"])
def test_a_motion_that_may_be_skipped_is_refused_though_it_ends_where_it_began(skipped):
    """A full circle behind a block delete mark was cut in either position of the switch."""
    with pytest.raises(DataError, match=r"line 3: a motion or mode that a block delete switch may skip"):
        correct(f"G90 G21 G54 G17 G0 X0 Y0 Z0\nG2 X0 Y0 I5 J0 F100\n{skipped}\n", no_deviation, SETUP)


@pytest.mark.parametrize("stop", ["M0", "M1", "M30", "m2"])
def test_a_stop_with_a_motion_comes_behind_its_last_segment(stop):
    """It stood in the first segment: the program ended 25 mm into a cut of 100 mm."""
    text, _ = correct(f"G90 G21 G54 G0 X0 Y0 Z0\nN7 G1 X100 F100 {stop} (cut)\n", no_deviation, SETUP)
    *moves, last = text.splitlines()[1:]
    assert (last, numbers(moves[-1], "X")) == (stop, [100.0])
    assert not any(stop in line for line in moves)


@pytest.mark.parametrize("off", ["M5", "M9"])
def test_spindle_or_coolant_off_with_a_cut_of_several_segments_is_refused(off):
    """LinuxCNC stops before the motion, others behind it: there the rest would be cut with a spindle that stands."""
    with pytest.raises(DataError, match=f"line 2: {off} with a motion of 4 segments"):
        correct(f"G90 G21 G54 G0 X0 Y0 Z0\nG1 X100 F100 {off}\n", no_deviation, SETUP)
    text, _ = correct(f"G90 G21 G54 G0 X0 Y0 Z0\nG0 Z100 {off}\n", no_deviation, SETUP)
    assert text.splitlines()[1] == f"G0 {off} Z100.0000"
