"""Every screw format, read by its manual's words alone, moves every kind of axis by minus its deviation."""

from __future__ import annotations

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
from errpipe.targets import TARGETS, _sample
from tests.unit.targets import manual_readers
from tests.unit.targets.by_hand import LINEAR, MACHINES, PLACES, READ, REPEAT, TURNS, even, of, table_of, turning


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
