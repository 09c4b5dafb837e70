"""A rotary table in LinuxCNC with WRAPPED_ROTARY: the joint counts on beyond a turn, its corrections repeat."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.targets.linuxcnc_hal import COMPONENT, JOINTS, LinuxcncHal
from tests.e2e.linuxcnc import session

pytestmark = [*session.MARKS, pytest.mark.slow]

LOST, LEVEL = 5.0, 40.0  # urad: half the lost motion, and what C goes too far everywhere
TURNED, SETTLED = 0.01, 60  # deg until the direction has turned; cycles until the lost motion is gone through
DEG = np.degrees(1e-6)  # of a urad
PROGRAM = "\n".join(
    [
        "G21 G90 G94 G61\nF12000\nG1 X250 C90\nG4 P0.2\nG91",
        *["G1 C350"] * 6,  # to 2190 deg
        *["G1 C-350"] * 11,  # to -1660 deg
        "G90\nG1 C359\nG1 C1\nG1 C-350\nG1 C10\nG1 X0 C90\nG4 P0.3\nM2\n",
    ]
)
CORE = """loadrt trivkins coordinates=XC
loadrt motmod servo_period_nsec=1000000 num_joints=2
loadrt scale names=nano
loadrt sampler depth=60000 cfg=fffu
addf motion-command-handler servo-thread
addf motion-controller servo-thread
"""
# A drive that follows without error measures its command.
CONNECT = """net errpipe-x-command => errpipe.measured-x
net errpipe-c-command => errpipe.measured-c
net errpipe-c-position => sampler.0.pin.0
net errpipe-c-feedback => sampler.0.pin.1
setp nano.gain 1e6
net moved errpipe.correction-c => nano.in
net moved-nano nano.out => sampler.0.pin.2
net status errpipe.status => sampler.0.pin.3
addf nano servo-thread
addf sampler.0 servo-thread
"""
TRAJ = """DEFAULT_LINEAR_VELOCITY = 200
MAX_LINEAR_VELOCITY = 500
DEFAULT_ANGULAR_VELOCITY = 200
MAX_ANGULAR_VELOCITY = 300
"""
AXES = """[AXIS_X]
MIN_LIMIT = -1
MAX_LIMIT = 501
MAX_VELOCITY = 300
MAX_ACCELERATION = 3000
[JOINT_0]
TYPE = LINEAR
HOME = 0
HOME_SEQUENCE = 0
MIN_LIMIT = -1
MAX_LIMIT = 501
MAX_VELOCITY = 300
MAX_ACCELERATION = 3000
FERROR = 0.001
[AXIS_C]
WRAPPED_ROTARY = 1
MAX_VELOCITY = 300
MAX_ACCELERATION = 2000
[JOINT_1]
TYPE = ANGULAR
WRAPPED_ROTARY = 1
HOME = 0
HOME_SEQUENCE = 0
MAX_VELOCITY = 300
MAX_ACCELERATION = 2000
FERROR = 0.001
"""


def bend(c: np.ndarray) -> np.ndarray:
    """Deviation of C without its lost motion, urad."""
    return LEVEL + 100.0 * np.sin(np.radians(c)) + 20.0 * np.cos(np.radians(3.0 * c))


def table() -> t.CompensationTable:
    """X is right; C turns on, measured from 0 to 360 deg."""
    inputs = [
        t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-1e5, high=1e5, default=0),
        t.TableInput(name="c", kind="position", axis="C", unit="deg", low=-1e5, high=1e5, default=0),
    ]
    side = Lowered(d.Direction(axis="C", threshold=TURNED), None, lambda c: np.full(np.shape(c), -LOST))
    sources = [
        tables.ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 0.0 * x + 0.01 * np.sin(x)),)),
        tables.ComponentSource("ECC", "urad", (Lowered(d.ONE, "C", bend), side)),
    ]
    made = tables.compile_table(sources, inputs=inputs, travel={"X": (0, 500), "C": (0, 360)}, turning=("C",))
    return tables.limited(made, {"X": 50.0, "C": 20.0})


def session_of(folder: Path, made: t.CompensationTable) -> np.ndarray:
    """Every servo cycle: number, joint position (deg), feedback (deg), correction (1e-6 deg), status."""
    files = {
        **{name: text.replace("joint.3.", "joint.1.") for name, text in LinuxcncHal.write(made).items()},  # no Y, no Z
        "core.hal": CORE + session.IO,
        "connect.hal": CONNECT,
        "sim.ini": session.ini("XC", JOINTS, TRAJ) + AXES,
        "program.ngc": PROGRAM,
    }
    session.write(folder, files, program_s=100, joints=2)
    with session.installed(folder / COMPONENT):
        facts, rows = session.run(folder, 150)
    assert facts["output"] == [] and facts["overruns"] == 0, facts
    return rows


def test_a_wrapped_rotary_axis_is_corrected_turn_after_turn(capsys):
    made = table()
    with session.alone() as folder:
        rows = session_of(folder, made)
    c, feedback, moved = rows[:, 1], rows[:, 2], 1e-6 * rows[:, 3] / DEG  # deg, deg, urad
    assert np.all(np.diff(rows[:, 0]) == 1), "a cycle was lost"
    assert c.max() > 1800.0 and c.min() < -1080.0, "the joint counts on beyond a turn"
    (slew,) = [o.slew for o in made.outputs if o.axis == "C"]
    step = np.abs(np.diff(moved))
    wraps = np.flatnonzero(np.diff(np.floor(c / 360.0)) != 0)
    side, settled = sides(c)
    off = np.abs(moved + bend(c) - LOST * side)
    on = (rows[:, 4].astype(int) & 2 > 0) & settled
    with capsys.disabled():
        print(
            f"\nWRAPPED_ROTARY, C from {c.min():.0f} to {c.max():.0f} deg, {wraps.size} wraps: at most "
            f"{off[on].max():.3f} urad off, largest step {step.max():.4f} urad, at a wrap {step[wraps].max():.4f}"
        )
    assert wraps.size > 10 and on.sum() > 0.7 * len(rows)
    assert step.max() <= 1e-3 * slew + 1e-4 and step[wraps].max() < 0.5
    # what its grid allows, and the last servo cycle that is still under way where the acceleration limits it
    assert off[on].max() < 0.05
    # 145 urad too far at 90 deg, approached from below: it is told to go 140 + 5 urad less far
    there = np.flatnonzero((np.abs(np.mod(c, 360.0) - 90.0) < 1e-4) & on)
    assert there.size > 100
    np.testing.assert_allclose(moved[there], LOST * side[there] - bend(90.0), atol=0.05)
    np.testing.assert_allclose(feedback[1:], c[:-1], atol=2e-6)  # neither the display nor the following error sees it


def sides(c: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Side from which C comes (+1, -1) per cycle, and where the lost motion has been gone through since."""
    side, at, last, out, calm = 1.0, c[0], -SETTLED, np.empty(c.size), np.empty(c.size, dtype=bool)
    for k, x in enumerate(c.tolist()):
        if side * (x - at) > 0:
            at = x
        elif side * (at - x) > TURNED:
            side, at, last = -side, x, k
        out[k], calm[k] = side, k - last >= SETTLED
    return out, calm
