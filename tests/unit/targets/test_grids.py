"""Where a format's grid begins, ends and divides: references, travels below zero, odd lengths, companions, names."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.errors import GateError
from errpipe.stages import targets as stage
from errpipe.targets import TARGETS, _loss, _sample
from errpipe.terms._base import Lowered
from tests.unit.targets import machines

BY_NAME = {t.name: t for t in TARGETS}


def over(low, high, um=10.0, lost=0.0):
    """Z over a travel, `um` too long at the upper end, nothing at the lower one, with lost motion."""
    pairs = [Lowered(d.ONE, "Z", lambda z: um * (z - low) / (high - low))]
    if lost:
        pairs.append(Lowered(d.Direction(axis="Z"), None, lambda z: np.full(np.shape(z), -lost / 2)))
    place = TableInput(name="z", kind="position", axis="Z", low=low - 50, high=high + 50, default=low)
    return tables.compile_table(
        [tables.ComponentSource("EZZ", "um", tuple(pairs))], inputs=[place], travel={"Z": (low, high)}
    )


@pytest.mark.parametrize(
    ("low", "high"), [(-300.0, 0.0), (0.0, 500.0), (-400.0, 800.0), (120.0, 420.0), (-700.0, -9.5)]
)
def test_fanuc_counts_from_the_reference_position(low, high):
    """Parameter 3620 is the point at machine coordinate 0, whichever part of the travel lies on which side of it."""
    text = BY_NAME["fanuc_pitch"].write(over(low, high, lost=4.0))["PITCH.TXT"]
    facts = {int(k): int(v) for k, v in re.findall(r"N0(36\d\d)Q1A3P(-?\d+)", text)}
    steps = {int(n) - 10000: int(v) for n, v in re.findall(r"N(1\d{4})Q0P(-?\d+)", text)}
    interval = facts[3624] / 1000

    def moved(z, first):
        """As the control does it, one pulse after the other, on the way from the reference to z."""
        last = facts[3620] + round(z / interval)
        up, down = range(facts[3620] + 1, last + 1), range(last + 1, facts[3620] + 1)
        shift = first - facts[3621]
        return sum(steps.get(n + shift, 0) for n in up) - sum(steps.get(n + shift, 0) for n in down)

    assert facts[3620] >= 0 and facts[3621] >= 0 and facts[3627] == -4
    points = interval * np.arange(math.ceil(low / interval), math.floor(high / interval) + 1)
    assert points.size >= 2
    want = -10.0 * (points - points[0]) / (high - low)
    for first in (facts[3621], facts[3626]):
        sums = np.array([moved(z, first) for z in points])
        assert sums - sums[0] == pytest.approx(want, abs=1.0)
    assert low > 0 or moved(0.0, facts[3621]) == 0
    (curve,) = BY_NAME["fanuc_pitch"].read_back({"PITCH.TXT": text}).curves
    up = 1e3 * np.interp(points, curve.positions, curve.up)
    assert up - up[0] == pytest.approx(want, abs=1.0)


@pytest.mark.parametrize("name", ["sinumerik_lec", "sinumerik_cec"])
def test_sinumerik_divides_without_a_rest(name):
    """(MAX - MIN) / STEP, cut off as a control may do it, is the number of intervals that are written."""
    rng = np.random.default_rng(7)
    for _ in range(40):
        low = -round(float(rng.uniform(0, 2000)), 3)
        (text,) = BY_NAME[name].write(over(low, low + round(float(rng.uniform(3, 3000)), 3), lost=2.0)).values()
        counts = len(re.findall(r"\$A[AN]_\w+\[0,\d+[,\]]", text))
        facts = {k: float(v) for k, v in re.findall(r"_(STEP|MIN|MAX)\[0[^\]]*\]=(\S+)", text)}
        assert int((facts["MAX"] - facts["MIN"]) / facts["STEP"]) == counts - 1
        assert facts["MIN"] + facts["STEP"] * (counts - 1) == facts["MAX"]


def test_heidenhain_steps_are_powers_of_two():
    text = BY_NAME["heidenhain_com"].write(over(-317.0, 12.3))["Z.COM"]
    x = np.array([line.split()[1] for line in text.splitlines() if line[:1].isdigit()], dtype=float)
    steps = np.diff(x) / 1e-4
    assert np.allclose(np.log2(steps), np.round(np.log2(steps)), atol=1e-3) and x[0] == -317.0 and x[-1] >= 12.3


@pytest.mark.parametrize("lost", [0.0, 6.0])
def test_one_screw_in_two_files_of_one_control_acts_once(tmp_path, lost):
    """Leadscrew and cross table asked for together: the second holds what the first cannot say, or is left out."""
    table = over(-300.0, 0.0, lost=lost)
    parts = [BY_NAME[n] for n in ("sinumerik_lec", "sinumerik_cec")]
    files = stage.write_targets(table, [p.name for p in parts], tmp_path)
    assert {f["file"].split("/")[0] for f in files} == {p.name for p in parts[: 2 if lost else 1]}
    if lost:
        _, read = stage.write_together(table, parts)
        (whole,) = _loss.losses(table, read)
        assert whole.largest < 0.1


@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_a_checklist_names_the_readings_at_which_it_holds_and_stays_within_the_travel(target, tmp_path):
    table = machines.sample(target)
    stage.write_targets(table, [target.name], tmp_path)
    text = (tmp_path / target.name / stage.CHECKLIST).read_text()
    assert "| axis | over |" in text, "an empty list"
    assert ("T = 22.5" in text or "T = 20" in text) == any(i.name == "T" for i in table.inputs)
    for row in re.findall(r"^\| \w+ \| (.+?) \| ([-\d., ]+) \|", text, re.M):
        if row[0] in machines.AXES:
            low, high = _sample.span(table, row[0])
            assert low - 1e-3 <= float(row[1]) <= high + 1e-3


@pytest.mark.parametrize("form", ["a wave of the screw", "lost motion alone"])
def test_a_table_says_how_far_its_axis_travels(form, tmp_path):
    """A curve that repeats every 10 mm is written over the travel; no list sends an axis to where no reading ends."""
    wave = Lowered(d.ONE, "X", lambda x: 3 * np.sin(2 * np.pi * x / 10), period=10.0)
    lost = Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -3.0))
    anywhere = TableInput(name="x", kind="position", axis="X", low=-1e5, high=1e5, default=0)
    source = tables.ComponentSource("EXX", "um", (wave if "wave" in form else lost,))
    table = tables.compile_table([source], inputs=[anywhere], travel={"X": (0.0, 500.0)})
    assert _sample.span(table, "X") == (0.0, 500.0)
    for name in ("linuxcnc_screw", "iec_st", "sinumerik_cec"):
        stage.write_targets(table, [name], tmp_path)
        rows = re.findall(r"^\| X \| X \| ([-\d.]+) \|", (tmp_path / name / stage.CHECKLIST).read_text(), re.M)
        assert rows and all(0.0 <= float(x) <= 500.0 for x in rows)
    (read,) = BY_NAME["linuxcnc_screw"].read_back(BY_NAME["linuxcnc_screw"].write(table)).curves
    if "wave" in form:
        assert 1e3 * float(np.interp(492.5, read.positions, read.up)) == pytest.approx(-3.0, abs=0.6)


def test_a_table_of_an_axis_that_turns_on_does_not_step_at_a_turn():
    curve = Lowered(d.ONE, "C", lambda c: 500.0 * np.sin(np.deg2rad(c)) + c / 2)
    place = TableInput(name="c", kind="position", axis="C", unit="deg", low=-1e4, high=1e4, default=0.0)
    for travel in ((0.0, 360.0), (0.0, 330.0)):
        source = tables.ComponentSource("ECC", "urad", (curve,))
        table = tables.compile_table([source], inputs=[place], travel={"C": travel}, turning=("C",))
        way = np.arange(350.0, 370.0, 0.25)
        wrapped, counted = (_sample.curve(table, "C", "C", x).up for x in (way % 360.0, way))
        assert np.abs(np.diff(wrapped)).max() < 0.5e-3 and np.abs(wrapped - counted).max() < 1e-9


FEW = {  # deviation (um) and travel of tables with one value, or so little travel that two points are all
    "a constant": (lambda x: np.full(np.shape(x), 5.0), (0.0, 500.0)),
    "a straight line": (lambda x: x / 50.0, (0.0, 500.0)),
    "a micrometre of travel far from 0": (lambda x: (x - 5000.0) * 100.0, (5000.0, 5000.001)),
}


@pytest.mark.parametrize("case", FEW)
@pytest.mark.parametrize("target", list(TARGETS), ids=lambda t: t.name)
def test_one_or_two_points_are_written_or_refused(target, case):
    curve, travel = FEW[case]
    place = TableInput(name="x", kind="position", axis="X", low=-1e5, high=1e5, default=travel[0])
    source = tables.ComponentSource("EXX", "um", (Lowered(d.ONE, "X", curve),))
    table = tables.compile_table([source], inputs=[place], travel={"X": travel})
    try:
        read = target.read_back(target.write(table))
    except GateError as err:
        assert target.name in str(err) or "points of" in str(err)
        return
    x = np.linspace(*travel, 5)
    made = 1e3 * read.correction("X", {"X": x}, np.ones(5), {})
    gap = made + curve(x)
    assert np.ptp(gap) < 0.3 + target.rounding_um
    assert not target.keeps_level or np.abs(gap).max() < 0.3 + target.rounding_um


def test_a_travel_of_one_place_is_a_message():
    place = TableInput(name="x", kind="position", axis="X", low=-1e5, high=1e5, default=250.0)
    curve = Lowered(d.ONE, "X", lambda x: 4.0 + x, nodes=(250.0,))
    with pytest.raises(GateError, match="nothing to grid between 250 and 250"):
        tables.compile_table(
            [tables.ComponentSource("EXX", "um", (curve,))], inputs=[place], travel={"X": (250.0, 250.0)}
        )


def test_a_curve_too_steep_for_pulses_is_refused_for_that():
    """It said that 511 points were needed where 512 fit."""
    with pytest.raises(GateError, match="Z changes by more than 7 pulses from point to point of 512"):
        BY_NAME["fanuc_pitch"].write(over(-20.0, 0.0, um=9000.0))
    with pytest.raises(GateError, match=r"fanuc_pitch: \d+ points are needed, 512 fit"):
        BY_NAME["fanuc_pitch"].write(over(5000.0, 5001.0))
