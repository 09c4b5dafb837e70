"""Every screw format, read by its manual's words alone, moves every kind of axis by minus its deviation."""

from __future__ import annotations

import functools
import itertools
import re

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError, VerifyError
from errpipe.stages import targets as stage
from errpipe.stages._checklist import checklist
from errpipe.tables import reference
from errpipe.targets import TARGETS, _sample
from errpipe.targets._base import AS_THE_AXIS
from errpipe.targets.fanuc_pitch import FanucPitch
from errpipe.targets.linuxcnc_hal import LinuxcncHal
from tests.unit.targets import machines, manual_readers

PLACES = 23
# Formats of one curve over an axis' own position, or of its reversal; the others are read in test_targets.
READ = [t for t in TARGETS if hasattr(manual_readers, t.name)]


def of(*axes, **more):
    """A table of axes (letter, low, high, mean deviation, half of what it is more on the way up), um or 1e-6 rad."""
    parts, outputs, inputs = [], [], []
    for letter, low, high, mean, half in axes:
        unit = "urad" if letter in "ABC" else "um"
        pairs = (Lowered(d.ONE, letter, mean), Lowered(d.Direction(axis=letter), letter, half))
        parts.append(tables.ComponentSource(f"E{letter}{letter}", unit, pairs))
        inputs.append(
            TableInput(name=letter.lower(), kind="position", axis=letter, low=low - 50, high=high + 50, default=low)
        )
    outputs = tables.outputs_of(parts)
    travel = {letter: (low, high) for letter, low, high, _, _ in axes}
    return tables.compile_table(parts, outputs=outputs, inputs=inputs, travel=travel, error_bound=0.01, **more)


def even(value):
    return lambda x: np.full(np.shape(x), float(value))


LONG = ("X", 0.0, 500.0, lambda x: 10.0 * x / 500.0, even(-2))  # 10 um too long at +X, 4 um of lost motion
MACHINES = {
    "too long at +X": [LONG],
    "travel -300 to 0": [("Z", -300.0, 0.0, lambda z: 10.0 * (z + 300.0) / 300.0, even(-2))],
    "short, wavy, travel -700 to -9.5": [("Y", -700.0, -9.5, lambda y: 8.0 * np.sin(y / 70) - 0.02 * y, even(-1))],
    "travel 5000 to 5400": [("X", 5000.0, 5400.0, lambda x: 0.05 * (x - 5000.0), even(-2))],
    "reversal grows over the travel": [("X", -200.0, 300.0, lambda x: 10 * np.sin(x / 70), lambda x: -3 - x / 200)],
    "three axes": [
        LONG,
        ("Y", -200.0, 200.0, lambda y: 3.0 - 0.05 * y, even(-1)),
        ("Z", -400.0, -20.0, lambda z: 0.03 * z, even(-3)),
    ],
    "rotary axis 0 to 360": [("C", 0.0, 360.0, lambda c: 500.0 * np.sin(np.deg2rad(c)), even(-100))],
    "a rotary axis that turns on, and X": [
        ("A", -90.0, 270.0, lambda a: 300.0 * np.sin(np.deg2rad(a)), even(-40)),
        LONG,
    ],
    "tilting axis -120 to 30": [("A", -120.0, 30.0, lambda a: 400.0 * (a + 120.0) / 150.0, even(-50))],
}


@functools.cache
def table_of(machine):
    """The table of a machine: the same for every format."""
    return of(*MACHINES[machine])


@functools.cache
def turning(low, high):
    """The table of a rotary axis that turns on; its curve ends 180e-6 rad from where it began."""
    curve = lambda c: 500.0 * np.sin(np.deg2rad(c)) + 180.0 * (c - low) / 360.0  # noqa: E731
    return of(("C", low, high, curve, even(-100)), turning=("C",))


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("target", READ, ids=lambda t: t.name)
def test_read_by_the_manual_the_file_takes_the_deviation_back(target, machine):
    axes = MACHINES[machine]
    try:
        files = target.write(table_of(machine))
    except GateError as err:
        assert any(letter in "ABC" for letter, *_ in axes), err
        return
    for letter, low, high, mean, half in axes:
        if letter in "ABC" and target.name in LINEAR:  # left out; reported as lost
            continue
        unit = np.rad2deg(1e-6) if letter in "ABC" else 1e-3
        x = np.linspace(low, high, PLACES)[1:-1]
        want = {side: -unit * (mean(x) + side * half(x)) for side in (1, -1)}
        moved = getattr(manual_readers, target.name)(files, letter)
        by_name = {side: np.array([moved(float(p), side) for p in x]) for side in (1, -1)}
        if "screw" not in target.holds:  # the reversal alone, its mean over the travel
            gap = np.full(1, np.mean(by_name[1] - by_name[-1] - (want[1] - want[-1])))
        elif "both directions" in target.holds:
            gap = np.array([by_name[side] - want[side] for side in (1, -1)])
        else:
            gap = (by_name[1] + by_name[-1] - want[1] - want[-1]) / 2
        level = 0.0 if target.keeps_level else np.mean(gap)
        assert 1e3 * np.abs(gap - level).max() < max(1.05 * target.rounding_um, 0.3), letter


LINEAR = {"haas_pitch", "marlin_gcode", "mitsubishi_pitch", "reprap_heightmap", "smoothie_pitch"}  # no rotary axis
TURNS = {"0 to 360": (0.0, 360.0), "-180 to 180": (-180.0, 180.0), "0 to 330 of a turn": (0.0, 330.0)}
REPEAT = {
    "beckhoff_ssfk",
    "fagor_lscrw",
    "fanuc_pitch",
    "heidenhain_com",
    "pmac_comp",
    "sinumerik_cec",
    "sinumerik_lec",
    "twincat_nc_table",
}


@pytest.mark.parametrize("ends", TURNS)
@pytest.mark.parametrize("target", [t for t in READ if t.name not in LINEAR], ids=lambda t: t.name)
def test_an_axis_that_turns_on_does_not_step(target, ends):
    """From 350 to 370 deg and back: the curve, which ends 180e-6 rad from where it began, is closed in every file."""
    low, high = TURNS[ends]
    files = target.write(turning(low, high))
    moved = getattr(manual_readers, target.name)(files, "C")
    way = np.arange(350.0, 370.0, 0.25)
    for side in (1, -1):
        passes = np.array([moved(low + (x - low) % 360.0, side) for x in way])
        assert np.abs(np.diff(passes)).max() * 1e3 < 0.4 + target.rounding_um
        if target.name in REPEAT:  # by a flag or a rule of the control: where positions count on
            for turn in (-360.0, 360.0):
                again = [moved(x + turn, side) for x in way - 360.0]
                assert np.abs(again - np.array([moved(x, side) for x in way - 360.0])).max() < 1e-9
    if target.name in REPEAT:
        read = target.read_back(files)
        for side in (1, -1):
            x = np.linspace(low, low + 360.0, 91)
            own = read.correction("C", {"C": x}, np.full(x.size, side), {})
            # errpipe's own reader and the one by the manual agree, but for the step-wise pulses of the control
            assert 1e3 * np.abs(own - [moved(float(p), side) for p in x]).max() < 0.1 + (target.name == "fanuc_pitch")


def test_a_turn_that_does_not_close_is_refused_where_it_is_read():
    c = table_of("rotary axis 0 to 360")
    for name, key, pattern in (
        ("fanuc_pitch", "PITCH.TXT", r"N10003Q0P(-?\d+)"),
        ("sinumerik_lec", "AX4_C_EEC.INI", r"COMP\[0,0,AX4\]=(\S+)"),
        ("sinumerik_cec", "NC_CEC.INI", r"CEC\[0,0\]=(\S+)"),
        ("beckhoff_ssfk", "achskw4.lis", r"table\[0\].pos +(-?\d+)"),
    ):
        (target,) = [t for t in TARGETS if t.name == name]
        files = target.write(c)
        match = re.search(pattern, files[key])
        changed = files[key][: match.start(1)] + "5" + files[key][match.end(1) :]
        with pytest.raises(VerifyError):
            target.read_back({**files, key: changed})


def test_every_format_of_one_axis_is_read():
    alone = {t.name for t in TARGETS if {"screw", "reversal"} & set(t.holds)}
    whole = {t.name for t in TARGETS if {"screw", "temperature"} <= set(t.holds)}  # the evaluators: test_signs
    read, documented = {t.name for t in READ}, {t.name for t in TARGETS if t.confidence != "experimental"}
    assert read <= alone - whole
    assert not (missing := (alone - whole - read) & documented), f"no reader written from the manual: {sorted(missing)}"


@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_a_checklist_says_the_unit_and_labels_those_of_rotary_axes(target, tmp_path):
    stage.write_targets(machines.sample(target), [target.name], tmp_path)
    text = (tmp_path / target.name / stage.CHECKLIST).read_text()
    assert f"\nUnit: {target.unit}.\n" in text and "from below, um |" in text
    if target in READ and target.unit == AS_THE_AXIS:
        stage.write_targets(table_of("rotary axis 0 to 360"), [target.name], tmp_path)
        text = (tmp_path / target.name / stage.CHECKLIST).read_text()
        assert "deg/1000 rms" in text and "from below, um, deg/1000 |" in text and " um rms" not in text


def test_a_checklist_has_no_heading_above_nothing(tmp_path):
    """Nothing can be said to happen over temperatures whose range is not stated."""
    drift = Lowered(d.Affine(weights=(2.0,), of=(d.above("T", 20.0),)))
    table = tables.compile_table(
        [tables.ComponentSource("EZZ", "um", (drift,))],
        outputs=[tables.OutputSource("Z", (tables.MonomialSource(1.0, "EZZ"),), "Z")],
        inputs=[TableInput(name="T", kind="sensor", unit="degC", low=-40, high=100, default=20)],
        error_bound=0.01,
    )
    stage.write_targets(table, ["c_runtime"], tmp_path)
    lines = [line for line in (tmp_path / "c_runtime" / stage.CHECKLIST).read_text().splitlines() if line]
    headings = [line.startswith("#") for line in lines[1:]]
    assert not any(a and b for a, b in itertools.pairwise(headings)), lines


def test_marlin_and_duet_are_set_to_millimetres():
    table = machines.too_long_from_above()
    for name, file in (("marlin_gcode", "errpipe.gcode"), ("reprap_heightmap", "errpipe.g")):
        (target,) = [t for t in TARGETS if t.name == name]
        text = target.write(table)[file]
        assert text.index("\nG21\n") < text.index("\nM425 ")


def test_an_inch_list_holds_no_rotary_axis():
    (target,) = [t for t in TARGETS if t.name == "haas_pitch"]
    with pytest.raises(GateError, match="C: a list in inches holds no rotary axis"):
        target.write(table_of("rotary axis 0 to 360"))


@pytest.mark.parametrize("name", ["haas_pitch", "mitsubishi_pitch"])
def test_linear_axes_are_exported_without_a_rotary_one_of_the_same_table(name, tmp_path):
    """X, 10 um too long at +X, is corrected; the checklist says that the whole error of A stays."""
    table = table_of("a rotary axis that turns on, and X")
    (target,) = [t for t in TARGETS if t.name == name]
    stage.write_targets(table, [name], tmp_path)
    read = target.read_back(target.write(table))
    assert read.axes() == ("X",)
    end, start = (read.correction("X", {"X": np.array([x])}, np.ones(1), {})[0] for x in (500.0, 0.0))
    assert end - start == pytest.approx(-0.010, abs=0.003)
    lost = (tmp_path / name / "CHECKLIST.md").read_text().split("cannot express")[1]
    assert re.search(r"- A: (\S+) deg/1000 rms of \1", lost)


def test_lost_motion_of_an_axis_that_a_format_does_not_name_is_no_missing_lost_motion():
    half = Lowered(d.Direction(axis="X1"), None, lambda x: np.full(np.shape(x), -3.0))
    channel = TableInput(name="x1", kind="position", axis="X1", low=-50, high=550, default=0)
    source = tables.ComponentSource("EXX1", "um", (half,))
    gantry = tables.compile_table([source], inputs=[channel], travel={"X1": (0.0, 500.0)})
    for name, letters in (("grblhal_backlash", "X Y Z A B C U V"), ("marlin_gcode", "X Y Z")):
        (target,) = [t for t in TARGETS if t.name == name]
        with pytest.raises(GateError, match=rf"of those that the format has \({letters}; found: X1\)"):
            target.write(gantry)


def only_y():
    """The table reads X and Y and moves Y alone."""
    bow = Lowered(d.ONE, "X", lambda x: 4.0 * np.sin(np.pi * x / 500.0))
    own = (Lowered(d.ONE, "Y", lambda y: 0.02 * y), Lowered(d.Direction(axis="Y"), None, even(-3)))
    inputs = [TableInput(name=a.lower(), kind="position", axis=a, low=-50, high=550, default=0) for a in ("X", "Y")]
    sources = [tables.ComponentSource("EYX", "um", (bow,)), tables.ComponentSource("EYY", "um", own)]
    return tables.compile_table(sources, inputs=inputs, travel=dict.fromkeys("XY", (0, 500)))


@pytest.mark.parametrize("target", [t for t in TARGETS if t.numbering], ids=lambda t: t.name)
def test_a_file_that_counts_axes_says_which_one_it_means(target):
    """Y is the second of them; its number stands in the file, and the checklist asks to compare it."""
    table = machines.warm() if "temperature" in target.holds and len(target.holds) == 1 else only_y()
    files = target.write(table)
    lines = checklist(target, target.read_back(files), [], table).splitlines()
    steps = [x for x in lines if x.startswith(("2. ", "3. ", "4. "))]  # after how the axes were measured
    first = next(x for x in steps if "machine coordinates" not in x and "diameters" not in x)
    letters = _sample.axes_of(table)
    for n, letter in enumerate(letters):
        assert f"{letter} is {target.numbering.format(n, n + 1)}" in first
    assert "else another axis is moved" in first
    if table.outputs[0].axis == "Y":
        text = "".join(files.values())
        called = {
            "aerotech_cal": "OUTAXIS=2",
            "beckhoff_ssfk": "kopf.achs_nr                  2",
            "beckhoff_crosscomp": "kopf.achs_nr 2",
            "fanuc_pitch": "N03620Q1A2P",
            "linuxcnc_hal": "joint.1.pos-cmd => errpipe.in-y",
            "pmac_comp": "#2\nDEFINE BLCOMP",
            "sinumerik_cec": "$AN_CEC_OUTPUT_AXIS[0]=(AX2)",
            "sinumerik_lec": "$AA_ENC_COMP[0,0,AX2]",
        }
        assert called[target.name] in text


@pytest.mark.parametrize(("axis", "stated"), [("X", True), ("Z", False)])
def test_x_of_a_lathe_is_checked_at_twice_the_listed_position(axis, stated):
    """A lathe displays diameters: the listed 100 mm is its X200, and going to X100 compares another point."""
    inputs = [TableInput(name="p", kind="position", axis=axis, low=-50, high=550, default=0)]
    sources = [tables.ComponentSource(f"E{axis}{axis}", "um", (Lowered(d.ONE, axis, lambda v: 0.02 * v),))]
    table = tables.compile_table(sources, inputs=inputs, travel={axis: (0, 300)})
    (target,) = [t for t in TARGETS if t.name == "sinumerik_lec"]
    text = checklist(target, target.read_back(target.write(table)), [], table)
    assert ("counts X in diameters (a lathe) displays twice the positions below" in text) is stated


def test_a_cross_row_is_reached_from_both_sides_with_all_axes():
    """Y over X has Y's lost motion between its columns: with X alone from above nothing of it is seen."""
    (target,) = [t for t in TARGETS if t.name == "heidenhain_com"]
    text = checklist(target, target.read_back(target.write(only_y())), [], only_y())
    up, down = re.findall(r"[-+]\d+\.\d+", re.search(r"\| Y \| X \|.*", text)[0])[-2:]
    assert float(down) - float(up) == pytest.approx(-6.0, abs=0.1)
    assert "with all axes from below, then all from above" in text


@pytest.mark.parametrize("target", [t for t in TARGETS if t.numbering], ids=lambda t: t.name)
def test_no_text_names_a_step_by_number(target):
    """The checklist numbers a target's steps behind its own, as many as the table needs: step 3 was another one."""
    table = machines.warm() if "temperature" in target.holds and len(target.holds) == 1 else only_y()
    files = target.write(table)
    text = checklist(target, target.read_back(files), [], table) + "".join(files.values())
    assert not re.search(r"\bsteps? \d", text)


def test_a_rotary_array_states_degrees():
    (target,) = [t for t in TARGETS if t.name == "twincat_nc_table"]
    (text,) = target.write(table_of("rotary axis 0 to 360")).values()
    assert "WorkDirectionPositive: deg, added" in text and " mm" not in text


@pytest.mark.parametrize(
    ("axes", "numbers"), [("Y", "XYZ"), ("Z", "XYZ"), ("XZ", "XZ"), ("YZ", "XYZ"), ("C", "XYZC"), ("XZC", "XZC")]
)
def test_the_table_of_an_axis_measured_alone_is_not_that_of_the_first_axis(axes, numbers):
    """A table of Y alone went to axis 1, which is X: its data moved another axis. X and Z alone are a lathe's."""
    inputs = [TableInput(name=a.lower(), kind="position", axis=a, low=-50, high=550, default=0) for a in axes]
    sources = [tables.ComponentSource(f"E{a}{a}", "um", (Lowered(d.ONE, a, lambda v: 0.02 * v),)) for a in axes]
    table = tables.compile_table(sources, inputs=inputs, travel=dict.fromkeys(axes, (0, 300)))
    assert "".join(_sample.axes_of(table)) == numbers
    number = numbers.index(axes[-1])
    text = "".join(LinuxcncHal.write(table).values())
    assert f"joint.{number}.motor-pos-cmd => errpipe.planned-{axes[-1].lower()}" in text
    assert f"A{number + 1} {axes[-1]}" in FanucPitch.write(table)["PITCH.TXT"]


@pytest.mark.parametrize(
    ("name", "point"),
    [("fagor_lscrw", r"(?m)^P\d+ "), ("sinumerik_lec", r"\$AA_ENC_COMP\[0,\d"), ("sinumerik_cec", r"\$AN_CEC\[0,\d")],
)
def test_the_number_of_points_to_enter_is_that_of_the_file_on_an_axis_that_turns_on_too(name, point):
    """The reader repeats the curve to either side; a control asks for the points of one turn."""
    (target,) = (t for t in TARGETS if t.name == name)
    table = turning(0.0, 360.0)
    files = target.write(table)
    says = " ".join(number.text for number in target.by_hand(table, target.read_back(files), ()))
    count = len(re.findall(point, "".join(files.values())))
    assert count > 2 and re.search(rf"(NPOINTS \(P16\)|MAX_POINTS( of each table)?) = {count}\b", says), says


def test_no_backlash_value_of_the_control_with_a_file_of_both_directions():
    """PMAC's is in the file: set to 0 by hand, half of its tables would be lost."""
    table = table_of("reversal grows over the travel")
    says = {
        t.name: " ".join(number.text for number in t.by_hand(table, t.read_back(t.write(table)), ()))
        for t in TARGETS
        if "both directions" in t.holds and t.name not in ("c_runtime", "iec_st", "feedback_inject")
    }
    assert "leave I186" in says["pmac_comp"] and "backlash value = 0" not in says["pmac_comp"]
    for name in set(says) - {"pmac_comp"}:
        assert re.search(r"(?i)backlash.*? 0\b|no BACKLASH", says[name]), (name, says[name])


@pytest.mark.parametrize("machine", MACHINES)
def test_a_fanuc_point_has_one_pulse_where_points_allow_it(machine):
    """A control that does not interpolate puts the pulses of a point out at once: many would be wrong in between."""
    (target,) = [t for t in TARGETS if t.name == "fanuc_pitch"]
    text = target.write(table_of(machine))["PITCH.TXT"]
    pulses = [abs(int(p)) for p in re.findall(r"Q0P(-?\d+);", text)]
    intervals = [int(v) / 1e3 for v in re.findall(r"N03624Q1A\d+P(\d+);", text)]
    assert len(pulses) <= 1024
    assert max(pulses) <= (2 if machine == "rotary axis 0 to 360" else 1), intervals  # there 2 deg are the shortest
    assert min(intervals) >= 2.0


def test_a_fanuc_checklist_says_the_rapid_traverse_and_what_comes_at_once():
    (target,) = [t for t in TARGETS if t.name == "fanuc_pitch"]
    table = table_of("too long at +X")
    text = checklist(target, target.read_back(target.write(table)), [], table)
    assert re.search(r"X: rapid traverse at most \d+ mm/min \(3624\); a point has at most 1 pulses", text), text


@pytest.mark.parametrize("ends", TURNS)
@pytest.mark.parametrize("target", [t for t in READ if t.name not in LINEAR], ids=lambda t: t.name)
def test_a_file_that_ends_after_a_turn_says_how_the_control_must_count(target, ends):
    """Held beyond its ends, the file of an axis that counts on, or from another end, is wrong by twice the error."""
    table = turning(*TURNS[ends])
    files = target.write(table)
    text = checklist(target, target.read_back(files), [], table)
    moved = getattr(manual_readers, target.name)(files, "C")
    low = TURNS[ends][0]
    counts_on = all(abs(moved(low + x + 360.0, 1) - moved(low + x, 1)) < 1e-9 for x in (40.0, 130.0, 290.0))
    assert (f"C: the file covers one turn, {low:g} to {low + 360:g} deg" in text) == (not counts_on), text


@pytest.mark.parametrize("name", ["c_runtime", "iec_st", "linuxcnc_hal", "feedback_inject"])
def test_a_whole_table_asks_for_a_position_that_counts_on_through_turns(name):
    """Its checklist asked for one that begins anew: from 359.99 to 0 deg, a reversal that none was."""
    table = turning(0.0, 360.0).model_copy(update={"ramp_s": 0.0})
    (target,) = [t for t in TARGETS if t.name == name]
    text = checklist(target, target.read_back(target.write(table)), [], table)
    assert "C: the table repeats with every turn; its position must count on, from -50 to 410 deg at most" in text
    assert "the file holds one turn" not in text
    wide = table.inputs[0].model_copy(update={"low": -1e5, "high": 1e5})
    moved = {}
    for way in ("counts on", "begins anew"):
        evaluator = reference.Evaluator(table.model_copy(update={"inputs": (wide,)}))
        for x in np.r_[np.arange(350.0, 360.0, 0.01), np.full(500, 360.0005)]:
            cycle = evaluator.cycle({"c": x if way == "counts on" else x % 360.0})
        moved[way] = cycle.correction[table.outputs[0].name]
    lost = np.rad2deg(200e-6)
    assert moved["counts on"] - moved["begins anew"] == pytest.approx(lost, rel=0.01)


@pytest.mark.parametrize("target", [t for t in READ if t.name not in LINEAR], ids=lambda t: t.name)
def test_numbers_to_enter_for_a_rotary_axis_are_degrees(target):
    table = table_of("rotary axis 0 to 360")
    text = checklist(target, target.read_back(target.write(table)), [], table)
    numbers = text.partition("## Enter by hand")[2].partition("## Three-point")[0]
    assert not re.search(r"\d mm\b", numbers), numbers


@pytest.mark.parametrize("machine", [name for name in MACHINES if "rotary" not in name])
def test_a_table_that_rolls_over_holds_its_ends_first_and_says_where_it_does(machine):
    (target,) = [t for t in TARGETS if t.name == "pmac_comp"]
    table = table_of(machine)
    files = target.write(table)
    read = target.read_back(files)
    text = checklist(target, read, [], table)
    for letter, low, high, *_ in MACHINES[machine]:
        moved = manual_readers.pmac_comp(files, letter)
        step = float(np.diff(next(c.positions for c in read.curves if c.axis == letter))[0])
        for end, out in ((low, -step), (high, step)):
            for side in (1, -1):
                before, there, beyond = (moved(end + share * out, side) for share in (-0.2, 0.0, 0.99))
                slope = 5.0 * abs(there - before)  # the last interval goes on in its line up to the next entry
                assert abs(beyond - there) < slope + 1e-3, (letter, end, out)
        first, last = map(float, re.search(rf"{letter}: software limits .* within (\S+) to (\S+) ", text).groups())
        assert first <= low - 0.99 * step and last >= high + 0.99 * step


@pytest.mark.parametrize("target", [t for t in READ if "screw" in t.holds], ids=lambda t: t.name)
def test_a_table_without_lost_motion_does_not_take_the_control_s_backlash_away(target):
    """Measured from one side, with the control's own value at work: set to 0, the other side would lose it."""
    table = machines.too_long_at_plus_x()
    read = target.read_back(target.write(table))
    says = " ".join(number.text for number in target.by_hand(table, read, ()))
    assert not re.search(r"(?i)backlash\S*( \(\S+\))?( value)? = 0", says), says
    if target.name not in ("beckhoff_volumetric", "pmac_comp"):
        assert "stays as it was while measuring" in says or "measure both directions" in says, says
    text = checklist(target, read, [], table)
    assert "measured with the control's own compensation and backlash off" in text


def test_a_control_that_takes_turns_from_0_to_360_deg_gets_them_so():
    """TNC 407, p. 156: entries outside are not recognized. A table from -180 to 180 deg was half lost."""
    (target,) = [t for t in TARGETS if t.name == "heidenhain_com"]
    for ends in TURNS.values():
        text = target.write(turning(*ends))["C.COM"]
        x = [float(row.split()[1]) for row in text.splitlines() if row[:1].isdigit()]
        assert x[0] == 0.0 and x[-2] < 360.0 <= x[-1]
    table = table_of("tilting axis -120 to 30")
    text = checklist(target, target.read_back(target.write(table)), [], table)
    assert "A: its table runs from -120 to" in text and "from 0 to 360 deg only (TNC 407)" in text


@pytest.mark.parametrize(("ends", "start"), [((0.0, 360.0), 0), ((-180.0, 180.0), -180), ((-90.0, 270.0), 0)])
def test_a_list_starts_over_where_its_axis_does(ends, start):
    """P-COMP-00022: the list wraps where the position does, which -90 or 5 deg never is."""
    (target,) = [t for t in TARGETS if t.name == "beckhoff_ssfk"]
    table = turning(*ends)
    files = target.write(table)
    assert re.search(rf"kw_startpos +{start * 10_000}\n", files["achskw4.lis"])
    text = checklist(target, target.read_back(files), [], table)
    assert f"P-AXIS-00127 = {start * 10_000}, P-AXIS-00126 = {(start + 360) * 10_000}" in text
    moved = manual_readers.beckhoff_ssfk(files, "C")
    places = start + np.array([1.0, 100.0, 359.0])
    want = _sample.at_nodes(table, "C", "C", places).up
    assert [moved(float(x), 1) for x in places] == pytest.approx(want, abs=3e-4)


def test_beyond_its_points_a_multiplier_goes_on():
    """As the firmware integrates (PitchCompensation::integrate): 100 mm beyond travel the correction was 2 um more."""
    (target,) = [t for t in TARGETS if t.name == "smoothie_pitch"]
    table = of(("X", 100.0, 400.0, lambda x: 0.02 * (x - 100.0), even(0.0)))
    files = target.write(table)
    moved = manual_readers.smoothie_pitch(files, "X")
    assert moved(700.0, 1) == pytest.approx(moved(400.0, 1), abs=1e-5)
    assert moved(-200.0, 1) == pytest.approx(moved(100.0, 1), abs=1e-5)
    assert moved(400.0, 1) == pytest.approx(-6e-3, abs=2e-5)
    with pytest.raises(GateError, match="X, Y and Z only"):
        target.write(table_of("rotary axis 0 to 360"))
