"""What the checklists of the formats have a person check and enter, and the numbers they state."""

from __future__ import annotations

import itertools
import re

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.stages import targets as stage
from errpipe.stages._checklist import checklist
from errpipe.tables import reference
from errpipe.targets import TARGETS, _sample
from errpipe.targets._base import AS_THE_AXIS
from errpipe.targets.fanuc_pitch import FanucPitch
from errpipe.targets.linuxcnc_hal import LinuxcncHal
from tests.unit.targets import machines, manual_readers
from tests.unit.targets.by_hand import LINEAR, READ, TURNS, only_y, table_of, turning


@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_a_checklist_says_the_unit_and_labels_those_of_rotary_axes(target, tmp_path):
    stage.write_targets(machines.sample(target), [target.name], tmp_path)
    text = (tmp_path / target.name / stage.CHECKLIST).read_text()
    assert f"\nUnit: {target.unit}.\n" in text and "from below, um |" in text
    if target in READ and target.unit == AS_THE_AXIS:
        stage.write_targets(table_of("rotary axis 0 to 360"), [target.name], tmp_path)
        text = (tmp_path / target.name / stage.CHECKLIST).read_text()
        assert "deg/1000 rms" in text and "from below, um, deg/1000 |" in text and " um rms" not in text


@pytest.mark.parametrize(("name", "added"), [("sinumerik_lec", " X 6.00 um"), ("linuxcnc_screw", "")])
def test_lost_motion_entered_by_hand_is_added_to_the_points_of_the_files(name, added, tmp_path):
    stage.write_targets(machines.long_with_lost_motion(), [name], tmp_path)
    points = (tmp_path / name / stage.CHECKLIST).read_text().partition("## Three-point check")[2]
    stated = re.search(r"lost motion entered by hand adds between both directions(.*)\.\n", points)
    assert (stated[1] if stated else "") == added


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
    assert "from below, then from above, with all axes" in text


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
