"""The loop closed by the real controller: a warm, crooked machine behind LinuxCNC's joints, compensated in four ways.

Every servo cycle is recorded; the deviation of tool against program comes from full transforms with the machine's
true errors at the motors' positions. What the table promises per axis: its gridding and rounding (`bounds`), what a
first-order synthesis leaves (`second_order_bound`), and what heat does between two thermal cycles.
"""

from __future__ import annotations

import contextlib
import os

import numpy as np
import pytest

from errpipe.kernels import table_cycle
from errpipe.tables import batch, bounds, pack
from errpipe.targets import _loss
from errpipe.targets.linuxcnc_hal import COMPONENT, LinuxcncHal
from errpipe.targets.linuxcnc_screw import LinuxcncScrew
from tests.e2e.linuxcnc import machine, session
from tests.unit.targets import machines

pytestmark = [*session.MARKS, pytest.mark.slow]

MINUTES = float(os.environ.get("ERRPIPE_LINUXCNC_MINUTES", "0.25"))  # of the run that must not miss a cycle
# Cycles after a reversal in which a screw file's value may still be on its way: motmod smooths it, and a step just
# above a quarter of acceleration x period^2 (2.5 um here) waits until the value itself has come closer.
REVERSAL = 100
MARGIN = 1.1
COUNT = 0.1  # um, of an external offset


@pytest.fixture(scope="module")
def linuxcnc():
    """Runs sessions with the component of a table installed; removes it in the end."""
    with session.alone() as folder, contextlib.ExitStack() as stack:

        def run(name, way, made=None, **more):
            own = folder / name
            own.mkdir()
            (own / COMPONENT).write_text(LinuxcncHal.write(made or machine.table())[COMPONENT])
            stack.enter_context(session.installed(own / COMPONENT))
            return machine.run(own, way, made, **more)

        yield run


@pytest.fixture(scope="module")
def off(linuxcnc):
    return linuxcnc("off", "off")


@pytest.fixture(scope="module")
def hal(linuxcnc):
    return linuxcnc("hal", "hal", least_s=60 * MINUTES)


def rms(values):
    return np.sqrt(np.mean(values**2, axis=0))


def output(what, deviation):
    figures = " ".join(f"{v:9.4f}" for v in (*rms(deviation), *np.abs(deviation).max(axis=0)))
    return f"  {what:<34}{figures}"


def promise(record):
    """Per cycle and axis, um."""
    gridding = np.array([o.gridding for o in bounds.outputs(machine.table())])
    return gridding + record.second_order()[:, None] + record.held()


def columns(record):
    """The table's inputs, per cycle, as the component saw them."""
    known = {a: record.command[:, n] for n, a in enumerate("XYZ")}
    known |= {"T screw": record.screw, "T spindle": record.spindle}
    fixed = {"tool_length": machine.TOOL} | {f"tool_offset_{a}": 0.0 for a in "XYZ"}
    rows = len(record.command)
    return {i.name: known.get(i.name, np.full(rows, fixed.get(i.name, 0.0))) for i in machine.table().inputs}


def by_reference(record):
    """Deviations that the table says, um: the fixed-rate evaluator on the readings of every cycle."""
    made = machine.table()
    program = pack.program(made)
    readings = np.column_stack(list(columns(record).values()))
    fresh, enable = np.ones(readings.shape, dtype=np.uint8), np.ones(len(readings), dtype=np.uint8)
    deviation, correction = np.empty((2, len(readings), len(made.outputs)))
    table_cycle.stream(
        program, pack.state(program), readings, fresh, enable, deviation, correction, np.empty(len(readings), np.int64)
    )
    return deviation


def test_the_component_removes_what_the_table_promises(off, hal, capsys):
    before, after, allowed = off.deviation()[off.moving()], hal.deviation()[hal.moving()], promise(hal)[hal.moving()]
    seen = 1e3 * (hal.motor - hal.command) + by_reference(hal)
    with capsys.disabled():
        print("\nLinuxCNC, every servo cycle of a lattice in heat, um:        rms X Y Z, largest X Y Z")
        print(output("compensation off", before))
        print(output("HAL component", after))
        print(output("promised (largest)", allowed))
        print(output("component against reference", seen[hal.moving()]))
        print(f"  largest residual / promise: {np.max(np.abs(after) / allowed):.3f}")
    assert np.all(rms(before) > 10.0)
    assert np.all(np.abs(after) <= MARGIN * allowed)
    assert np.all(rms(after) < 2e-3 * rms(before))


def test_no_cycle_is_missed(hal, capsys):
    facts = hal.facts
    assert facts["overruns"] == 0 and facts["output"] == []
    assert np.all(np.diff(hal.number) == 1) and np.all(np.diff(hal.heartbeat) == 1)
    # Running and active, and at most beyond a profile's end by the last bit of a position.
    assert set(hal.status[hal.moving()]) <= {3, 3 + 1024}
    assert facts["cycles"] == pytest.approx(facts["elapsed_s"] / machine.CYCLE, rel=2e-3, abs=250)
    with capsys.disabled():
        print(
            f"\nHAL component: {len(hal.number)} cycles recorded, none missing; {facts['cycles']} counted in "
            f"{facts['elapsed_s']:.1f} s; tmax of the component {session.clocks(facts['errpipe.tmax'])}, of the whole "
            f"servo thread {session.clocks(facts['servo-thread.tmax'])}"
        )


def test_a_screw_file_leaves_what_was_predicted(linuxcnc, capsys):
    record = linuxcnc("screw", "screw")
    made = machine.table()
    read = LinuxcncScrew.read_back(LinuxcncScrew.write(made))
    time = machine.CYCLE * np.arange(len(record.command))
    whole = batch.evaluate(made, columns(record), time, np.zeros(len(time), dtype=int)).deviation
    at = {a: record.command[:, n] for n, a in enumerate("XYZ")}
    sides = [sign_of_travel(at[a]) for a in "XYZ"]
    settled = np.all([quiet for _, quiet in sides], axis=0)
    rest = np.column_stack(
        [whole[f"E_{a}"] + 1e3 * read.correction(a, at, sides[n][0], {}) for n, a in enumerate("XYZ")]
    )
    residual = record.deviation()
    gap = np.abs(residual - rest)[settled]
    general = {x.axis: x for x in _loss.losses(made, read)}
    with capsys.disabled():
        print("\nScrew files, um:                                             rms X Y Z, largest X Y Z")
        print(output("residual in LinuxCNC", residual[settled]))
        print(output("predicted, cycle by cycle", rest[settled]))
        print(output("difference", gap))
        print("  over the whole volume (errpipe)   " + " ".join(f"{general[a].rms:9.4f}" for a in "XYZ"))
    assert settled.sum() > 3000
    # The file's own rounding of positions, and what the table itself does not know.
    assert np.all(gap <= MARGIN * promise(record)[settled] + 0.002)
    assert np.allclose(rms(residual[settled]), rms(rest[settled]), rtol=0.01)


def sign_of_travel(x):
    """Side from which motmod says a joint comes (+1, -1), and where its compensation has arrived, per cycle."""
    step = np.sign(np.diff(x, prepend=x[0]))
    last = np.maximum.accumulate(np.where(step != 0, np.arange(x.size), -1))
    side = np.where(last >= 0, step[np.maximum(last, 0)], 0.0)
    turned = np.maximum.accumulate(np.where(np.diff(side, prepend=0.0) != 0, np.arange(x.size), -1))
    return side, (side != 0) & (np.arange(x.size) - turned > REVERSAL)


def test_origin_shift_by_external_offsets(linuxcnc, capsys):
    """The method of 1997: the controller shifts its origin. In steps of a count, at rest as good as the table."""
    record = linuxcnc("shift", "shift")
    residual = record.deviation()
    step = np.abs(np.diff(record.command, axis=0, prepend=record.command[:1])).max(axis=1)
    resting = np.convolve(step < 1e-6, np.ones(20), "full")[: len(step)] == 20
    resting[: record.moving().start] = False
    with capsys.disabled():
        print("\nExternal offsets, um:                                        rms X Y Z, largest X Y Z")
        print(output("residual at rest", residual[resting]))
        print(output("residual in motion", residual[record.moving()]))
    assert resting.sum() > 200  # cycles
    assert np.all(np.abs(residual[resting]) <= MARGIN * promise(record)[resting] + 0.5 * COUNT)


def test_four_emergency_stops_leave_the_axis_where_it_is(linuxcnc, capsys):
    """Once each reset moved it by the whole correction: the correction ramped out while the drive held."""
    there = "G21 G90 G61\nF30000\nG1 X450\nG4 P0.5\nM2\n"
    record = linuxcnc("stops", "hal", machines.too_long_at_plus_x(), program=there, stops=4)
    places = np.array(record.facts["stops"])
    with capsys.disabled():
        print(f"\nfour emergency stops at X = 450: motor told {places[0]:.6f} mm, moved {1e3 * np.ptp(places):.4f} um")
    assert len(places) == 5 and places[0] == pytest.approx(450.0 - 0.009, abs=1e-4)
    assert np.ptp(places) < 1e-5  # mm


def test_four_emergency_stops_with_external_offsets(linuxcnc, capsys):
    """LinuxCNC forgets a shift at each stop; it comes in again with the next motion, not with the reset."""
    there = "G21 G90 G61\nF30000\nG1 X450\nG4 P0.5\nM2\n"
    record = linuxcnc("shift-stops", "shift", machines.too_long_at_plus_x(), program=there, stops=4)
    *places, after = record.facts["stops"]
    with capsys.disabled():
        print(
            f"\nfour emergency stops, external offsets: moved {1e3 * np.ptp(places):.4f} um; told {after:.6f} mm after"
        )
    assert len(places) == 5 and places[0] == pytest.approx(450.0 - 0.009, abs=1e-4)
    assert np.ptp(places) < 1e-5  # mm
    assert after == pytest.approx(450.0 - 0.009, abs=1e-4)


@pytest.mark.parametrize("way", ["screw", "hal"])
def test_ten_um_too_long_goes_ten_um_less_far(linuxcnc, way):
    """The sign, in the real controller: at X = +500 the motor is commanded 10 um less."""
    there = "G21 G90 G61\nF30000\nG1 X500\nG4 P0.1\nM2\n"
    record = linuxcnc(f"sign-{way}", way, machines.too_long_at_plus_x(), program=there)
    end = record.command[:, 0] > 499.9999
    assert end.sum() > 50
    moved = 1e3 * (record.motor - record.command)[end]
    np.testing.assert_allclose(moved[-50:], np.tile([-10.0, 0.0, 0.0], (50, 1)), atol=0.01)


@pytest.mark.parametrize("way", ["screw", "hal"])
def test_lost_motion_behind_homing_without_a_move_is_right_from_the_next_move_on(linuxcnc, way):
    """X is homed where it stands, at 250: the jump from 0 counts as a move up, whatever side it stands on."""
    down = "G21 G90 G61\nF600\nG4 P1.5\nG1 X249\nG4 P0.3\nM2\n"
    record = linuxcnc(f"homed-{way}", way, machines.long_with_lost_motion(), program=down, home=250.0)
    moved = 1e3 * (record.motor - record.command)[:, 0]
    still = record.command[:, 0] > 249.9999
    assert moved[still][-60:-10] == pytest.approx(-5.0 + 3.0, abs=0.05), "as after a move up"
    assert moved[-50:] == pytest.approx(-4.98 - 3.0, abs=0.05), "and down from the first move on"
    assert "HOME_SEARCH_VEL" in " ".join((LinuxcncScrew if way == "screw" else LinuxcncHal).activation)
