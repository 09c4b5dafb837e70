"""Feedback interception in the real controller: encoder, injected counts, counter, a position loop in LinuxCNC.

The machine is the simulated encoder's own count: what it stands at is not what the controller sees. 25 points from
both sides at two temperatures: counter minus encoder is minus the correction, within half a count and the bound.
"""

from __future__ import annotations

import re

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.tables import bounds
from errpipe.targets import TARGETS, _sample
from tests.e2e.linuxcnc import session

pytestmark = [*session.MARKS, pytest.mark.slow]
TRAVEL = (0.0, 50.0)  # mm
COUNTS = 1000  # per mm; one turn of the encoder, and one index, a millimetre
BASE = 50_000  # ns: 20 kHz
SPEED = 8.0  # mm/s
POINTS = 25
COLD, WARM, HOT = 20.0, 30.0, 39.0


def table():
    """40 um too long at X = 50 with a wave, 6 um of lost motion, 2 um/K on a warm screw: in LinuxCNC's servo cycle."""
    gap = Lowered(d.Direction(axis="X", threshold=0.01), None, lambda x: np.full(np.shape(x), -3.0))
    pairs = (
        Lowered(d.ONE, "X", lambda x: 0.8 * x + 4.0 * np.sin(x / 3.0)),
        gap,
        Lowered(d.above("T", COLD), "X", lambda x: 0.04 * x),
    )
    inputs = [
        TableInput(name="x", kind="position", axis="X", unit="mm", low=-10, high=60, default=0.0),
        TableInput(name="T", kind="sensor", unit="degC", low=-20, high=90, default=COLD, valid=(15, 40), margin=5),
    ]
    return tables.compile_table(
        [tables.ComponentSource("EXX", "um", pairs)],
        inputs=inputs,
        travel={"X": TRAVEL},
        error_bound=0.01,
        position_cycle_s=0.001,
        thermal_cycle_s=0.005,
        ramp_s=0.2,
    )


CORE = f"""loadrt trivkins coordinates=X
loadrt motmod base_period_nsec={BASE} servo_period_nsec=1000000 num_joints=1
loadrt sim_encoder num_chan=1
loadrt encoder num_chan=1
loadrt pid num_chan=1
loadrt errpipe
loadrt sampler depth=30000 cfg=fsssuubb
addf sim-encoder.make-pulses base-thread
"""
CONNECT = f"""addf encoder.update-counters base-thread
addf encoder.capture-position servo-thread 1
addf motion-command-handler servo-thread 2
addf motion-controller servo-thread 3
addf pid.0.do-pid-calcs servo-thread
addf sim-encoder.update-speed servo-thread
addf sampler.0 servo-thread
net enable motion.motion-enabled => errpipe.enable pid.0.enable
net homed motion.is-all-homed => errpipe.homed
net wanted joint.0.pos-cmd => errpipe.in-x sampler.0.pin.0
net planned joint.0.motor-pos-cmd => pid.0.command
setp errpipe.in-t {COLD}
setp sim-encoder.0.ppr {COUNTS // 4}
setp sim-encoder.0.scale 1
setp encoder.0.position-scale {COUNTS}
setp pid.0.Pgain 40
setp pid.0.FF1 1
setp pid.0.deadband 0.0006
setp pid.0.maxoutput {2 * SPEED}
net speed pid.0.output => sim-encoder.0.speed
net a sim-encoder.0.phase-A => errpipe-inject.x.phase-A
net b sim-encoder.0.phase-B => errpipe-inject.x.phase-B
net z sim-encoder.0.phase-Z => errpipe-inject.x.phase-Z
net out-a errpipe-inject.x.out-A => encoder.0.phase-A
net out-b errpipe-inject.x.out-B => encoder.0.phase-B
net out-z errpipe-inject.x.out-Z => encoder.0.phase-Z
net seen encoder.0.position => pid.0.feedback joint.0.motor-pos-fb
setp errpipe-inject.x.scale {COUNTS}
setp errpipe-inject.x.max-velocity {1.5 * SPEED}
setp errpipe-inject.x.base-period {BASE}
net raw errpipe-inject.x.counts => sampler.0.pin.1
net counter encoder.0.rawcounts => sampler.0.pin.2
net injected errpipe-inject.x.injected => sampler.0.pin.3
net illegal errpipe-inject.x.illegal => sampler.0.pin.4
net beat errpipe.heartbeat => sampler.0.pin.5
net refused errpipe-inject.x.refused => sampler.0.pin.6
net found errpipe-inject.x.found => sampler.0.pin.7
"""
TRAJ = f"DEFAULT_LINEAR_VELOCITY = {SPEED}\nMAX_LINEAR_VELOCITY = {SPEED}\n"
AXES = f"""[AXIS_X]
MIN_LIMIT = -5
MAX_LIMIT = 55
MAX_VELOCITY = {SPEED}
MAX_ACCELERATION = 200
[JOINT_0]
TYPE = LINEAR
HOME = 0
HOME_SEQUENCE = 0
MIN_LIMIT = -5
MAX_LIMIT = 55
MAX_VELOCITY = {SPEED}
MAX_ACCELERATION = 200
FERROR = 2
MIN_FERROR = 2
"""


def program() -> str:
    """Two millimetres over the first index, then all points upwards and downwards."""
    places = np.linspace(1.0, 49.0, POINTS)
    rows = [f"G1 X{x:.3f}\nG4 P0.15" for x in (*places, 50.0, *places[::-1])]
    return "\n".join(["G21 G90 G61", f"F{60 * SPEED:.0f}", "G1 X-2", "G1 X0", *rows, "G1 X0", "G1 X47.7", "M2", ""])


def test_the_loop_is_brought_to_the_corrected_place(capsys):
    made = table()
    (inject,) = [t for t in TARGETS if "quadrature" in t.limits]
    (whole,) = [t for t in TARGETS if t.controller == "LinuxCNC" and "temperature" in t.holds]
    files = inject.write(made)
    wiring = re.sub(r"^(setp|# |net errpipe-inject-(enable|homed)).*\n", "", files["errpipe-inject.hal"], flags=re.M)
    component = whole.write(made)["errpipe.comp"]
    fresh = re.findall(r"^pin in bit (fresh_\w+)", component, re.M)
    shared = "net enable => errpipe-inject.x.enable\nnet homed => errpipe-inject.x.homed\n"
    texts = {
        "errpipe.comp": component,
        "errpipe_inject.comp": files["errpipe_inject.comp"],
        "errpipe-inject.hal": wiring,
        "core.hal": CORE + session.IO + "addf errpipe servo-thread\n",
        "connect.hal": CONNECT + shared + "".join(f"setp errpipe.{p.replace('_', '-')} 1\n" for p in fresh),
        "sim.ini": session.ini("X", "errpipe-inject.hal", TRAJ, BASE) + AXES,
        "program.ngc": program(),
    }
    plan = {"settle_s": 0.3, "program_s": 120, "least_s": 1.0, "joints": 1, "while_stopped": {"errpipe.in-t": HOT}}
    plan |= {"stops": 4, "stop_pins": ["errpipe-inject.x.injected", "errpipe-inject.x.counts"]}
    results = []
    with session.alone() as folder:
        session.write(folder, texts)
        with session.installed(folder / "errpipe.comp"), session.installed(folder / "errpipe_inject.comp"):
            for temperature in (COLD, WARM):
                session.write(folder, texts, **plan, heat={"errpipe.in-t": temperature})
                results.append((temperature, *session.run(folder, 180)))
    for temperature, facts, rows in results:
        judge(made, temperature, facts, rows, capsys)


def judge(made, temperature, facts, rows, capsys) -> None:
    assert facts["output"] == [] and facts["overruns"] == 0
    # Injected counts and the encoder's own, in each of four emergency stops (in which it gets hot) and after it.
    stops = np.array(facts["stops"])
    assert stops.shape == (9, 2) and abs(stops[0, 0]) > 20 and np.ptp(stops, axis=0).tolist() == [0, 0], stops
    wanted, raw, counter, injected, illegal = rows[:, 1], *(rows[:, k].astype(int) for k in (2, 3, 4, 5))
    flags = rows[:, 8].astype(bool)
    assert not np.any(rows[:, 7]) and illegal[-1] == 0
    assert flags[-1] and not flags[0] and np.all(injected[: np.argmax(flags)] == 0), "nothing before the index"
    # Two counters that are read one after the other in a cycle may differ by the counts of one base period or two.
    rest = np.flatnonzero(
        np.convolve(np.abs(np.diff(wanted, prepend=wanted[0])) < 1e-9, np.ones(80), "full")[: len(wanted)] == 80
    )
    places = []
    for x in np.linspace(1.0, 49.0, POINTS):
        here = rest[np.abs(wanted[rest] - x) < 1e-6]
        groups = np.split(here, np.flatnonzero(np.diff(here) > 100) + 1)
        places += [(x, g[-1]) for g in groups if g.size]
    assert len(places) == 2 * POINTS
    x, at = np.array([p[0] for p in places]), np.array([p[1] for p in places])
    side = np.sign(x - np.array([wanted[max(0, k - 400)] for k in at]))
    side[side == 0] = 1.0
    sensors = {"x": x, "T": np.full(x.size, temperature)}
    correction = 1e3 * _sample.corrections(made, "X", sensors, side)  # um
    (bound,) = [o.gridding for o in bounds.outputs(made)]
    assert np.all(np.abs((counter - raw)[at] - injected[at]) <= 1)
    residual = -injected[at] * 1e3 / COUNTS - correction
    machine = raw[at] * 1e3 / COUNTS - 1e3 * x  # where the machine really is against the command
    with capsys.disabled():
        print(
            f"\nfeedback interception at {temperature:g} degC: {len(places)} points, correction up to "
            f"{np.abs(correction).max():.1f} um, largest residual {np.abs(residual).max():.3f} um "
            f"(half a count {500 / COUNTS:g} + bound {bound:.3f})"
        )
    assert np.all(np.abs(residual) <= 500 / COUNTS + bound + 1e-6)
    # The sign, in the loop: the machine itself stands where the correction sends it, within the loop's own deadband.
    assert np.all(np.abs(machine - machine_zero(wanted, raw) - correction) <= 3.0) and np.abs(correction).max() > 30


def machine_zero(wanted, raw) -> float:
    """Where encoder and command agreed at the start, um."""
    return float(raw[0] * 1e3 / COUNTS - 1e3 * wanted[0])
