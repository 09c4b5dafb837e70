"""The exported component in a realtime thread: 7000 cycles from streamer to sampler equal the reference."""

from __future__ import annotations

import subprocess
import time

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.tables import bounds, ect
from errpipe.tables.reference import Evaluator
from errpipe.targets.linuxcnc_hal import COMPONENT, LinuxcncHal
from tests.e2e.linuxcnc import session

pytestmark = session.MARKS

CYCLES = 7000
PERIOD_NS = 50_000  # twenty times faster than a machine's servo thread: the same cycles in less time
PRINT_NM = 0.6e-6  # halsampler prints six decimals; corrections are scaled to nm before


def table() -> t.CompensationTable:
    """Two axes, a lost motion, a lagged and a rate-limited sensor, tool length; limits of magnitude and slew."""
    inputs = [
        t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-50, high=550, default=0),
        t.TableInput(name="y", kind="position", axis="Y", unit="mm", low=-50, high=450, default=0),
        t.TableInput(
            name="T nut",
            kind="sensor",
            unit="degC",
            low=-20,
            high=90,
            default=20,
            max_rate=50.0,
            hold_s=0.01,
            valid=(15, 40),
            margin=5,
        ),
        t.TableInput(name="tool_length", kind="tool", unit="mm", low=0, high=300, default=100),
    ]
    warm = d.Lag(of=d.above("T nut", 20.0), tau_up=0.05, tau_down=0.09)
    components = [
        tables.ComponentSource(
            "EXX",
            "um",
            (
                Lowered(d.ONE, "X", lambda x: 12.0 * np.sin(x / 60.0)),
                Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -3.0)),
                Lowered(warm, "X", lambda x: 0.011 * x),
            ),
        ),
        tables.ComponentSource("EBX", "urad", (Lowered(d.ONE, "X", lambda x: 20.0 * np.cos(x / 90.0)),)),
        tables.ComponentSource("EYY", "um", (Lowered(d.ONE, "Y", lambda y: 8.0 * np.sin(y / 70.0)),)),
    ]
    outputs = [
        tables.OutputSource(
            "E_X",
            (tables.MonomialSource(1.0, "EXX"), tables.MonomialSource(-1e-3, "EBX", (d.Input(name="tool_length"),))),
            "X",
        ),
        tables.OutputSource("E_Y", (tables.MonomialSource(1.0, "EYY"),), "Y"),
    ]
    table = tables.compile_table(
        components,
        inputs=inputs,
        outputs=outputs,
        travel={"X": (0, 500), "Y": (0, 400)},
        position_cycle_s=PERIOD_NS * 1e-9,
        thermal_cycle_s=20 * PERIOD_NS * 1e-9,
        ramp_s=0.02,
        fade_s=0.01,
    )
    return tables.with_limits(table, {"E_X": tables.Limits(magnitude=12.0, slew=4000.0, acceleration=2e6)})


def stimulus() -> np.ndarray:
    """x, y, T, tool length, enable per cycle: leaves the table on all sides, loses the sensor, is switched off."""
    k = np.arange(CYCLES)
    x = 250 + 320 * np.sin(2 * np.pi * k / 3001)
    y = 200 + 260 * np.cos(2 * np.pi * k / 1777)
    warm = 20 + 25 * (1 - np.exp(-k / 900.0))
    warm = np.where((k > 4000) & (k < 4600), np.where(k % 2, 500.0, -273.0), warm)  # out of range: lost
    tool = 80 + 40 * np.sin(k / 500)
    enable = (k > 100) & ((k < 5000) | (k > 5600))
    return np.column_stack([x, y, warm, tool, enable])


STREAM = f"""loadrt threads name1=servo-thread period1={PERIOD_NS}
loadrt streamer depth=8000 cfg=ffffb
loadrt errpipe
loadrt scale count=2
setp scale.0.gain 1e6
setp scale.1.gain 1e6
loadrt sampler depth=8000 cfg=ffuuub
addf streamer.0 servo-thread
addf errpipe servo-thread
addf scale.0 servo-thread
addf scale.1 servo-thread
addf sampler.0 servo-thread
net x streamer.0.pin.0 => errpipe.in-x
net y streamer.0.pin.1 => errpipe.in-y
net t streamer.0.pin.2 => errpipe.in-t-nut
net l streamer.0.pin.3 => errpipe.in-tool-length
net e streamer.0.pin.4 => errpipe.enable
net cx errpipe.correction-x => scale.0.in
net cy errpipe.correction-y => scale.1.in
net cxn scale.0.out => sampler.0.pin.0
net cyn scale.1.out => sampler.0.pin.1
net s errpipe.status => sampler.0.pin.2
net h errpipe.heartbeat => sampler.0.pin.3
net f errpipe.fault-t-nut => sampler.0.pin.4
net w errpipe.wrong-rate => sampler.0.pin.5
"""


@pytest.fixture(scope="module")
def place():
    """A folder of which LinuxCNC has the use, for the time of these tests; the component is installed."""
    with session.alone() as folder:
        (folder / COMPONENT).write_text(LinuxcncHal.write(table())[COMPONENT])
        with session.installed(folder / COMPONENT):
            yield folder


@pytest.fixture
def folder(place, request):
    own = place / request.node.name
    own.mkdir()
    return own


def stream(folder, readings, text=STREAM, bits=1):
    """Feed one line per cycle (numbers, then `bits` of 0 and 1), record one line per cycle."""
    (folder / "stream.hal").write_text(text)
    lines = (" ".join([*(f"{v:.9f}" for v in row[:-bits]), *(str(int(v)) for v in row[-bits:])]) for row in readings)
    (folder / "in.txt").write_text("\n".join(lines) + "\n")
    env = session.environment(folder)
    session.end(env, folder)
    try:
        assert session.quiet(["halcmd", "-f", "stream.hal"], env, folder, 30) == 0, session.said(folder)
        with (folder / "in.txt").open() as given:
            subprocess.run(["timeout", "30", "halstreamer", "-c", "0"], stdin=given, env=env, cwd=folder, check=True)
        with (folder / "out.txt").open("w") as taken:
            sampler = subprocess.Popen(
                ["timeout", "60", "halsampler", "-c", "0", "-n", str(len(readings)), "-t"],
                stdout=taken,
                env=env,
                cwd=folder,
                stdin=subprocess.DEVNULL,
            )
            time.sleep(0.2)
            assert session.quiet(["halcmd", "start"], env, folder, 10) == 0
            assert sampler.wait(70) == 0
        session.quiet(["halcmd", "stop"], env, folder, 10)
        (folder / "talk.txt").write_text("")
        session.quiet(["halcmd", "getp", "errpipe.tmax"], env, folder, 10)
        session.quiet(["halcmd", "getp", "errpipe.table-crc"], env, folder, 10)
        tmax, crc = (int(v, 0) for v in session.values(folder))
    finally:
        session.end(env, folder)
    return np.loadtxt(folder / "out.txt"), tmax, crc


def test_seven_thousand_cycles_equal_the_reference(folder, capsys):
    made = table()
    given = np.array([[float(f"{v:.9f}") for v in row] for row in stimulus()])
    rows, tmax, crc = stream(folder, given)
    assert rows.shape == (CYCLES, 7)
    assert np.array_equal(rows[:, 0], np.arange(rows[0, 0], rows[0, 0] + CYCLES)), "a cycle was lost"
    assert crc == int(ect.fingerprint(made), 16)
    evaluator = Evaluator(made)
    names = [i.name for i in made.inputs]
    assert names == ["x", "y", "T nut", "tool_length"]
    want = []
    for row in given:
        cycle = evaluator.cycle(dict(zip(names, row[:4], strict=True)), hold=not row[4])
        fault = t.FAULTS.index(cycle.faults["T nut"])
        moved = [cycle.correction[name] * 1e6 for name in ("E_X", "E_Y")]
        want.append([*moved, cycle.status, cycle.heartbeat, fault])
    want = np.array(want)
    gap = np.abs(rows[:, 1:3] - want[:, :2]).max()
    assert gap < PRINT_NM
    assert np.array_equal(rows[:, 3], want[:, 2]), "status words differ"
    assert np.array_equal(rows[:, 4], np.arange(1, CYCLES + 1)), "heartbeats"
    assert np.array_equal(rows[:, 5], want[:, 4]), "faults of the sensor"
    assert not rows[:, 6].any()
    assert np.abs(want[:, :2]).max() > 11_000 and len(set(want[:, 2])) > 6  # the stimulus reaches far
    cost = bounds.cost(made)[1]
    with capsys.disabled():
        print(
            f"\nHAL component: {CYCLES} cycles at {1e9 / PERIOD_NS:.0f} Hz, none lost; worst difference to the "
            f"reference {gap:.1e} nm (print {0.5e-6:.0e}); tmax {session.clocks(tmax)}; {cost.operations} operations"
        )


def halrun(folder, text: str) -> int:
    """Exit code of a HAL file run to its end."""
    (folder / "run.hal").write_text(text)
    env = session.environment(folder)
    try:
        return session.quiet(["halrun", "-f", "run.hal"], env, folder, 20)
    finally:
        session.end(env, folder)


def test_a_thread_of_another_rate_moves_nothing_and_says_so(folder):
    code = halrun(
        folder,
        "loadrt threads name1=servo-thread period1=1000000\nloadrt errpipe\naddf errpipe servo-thread\n"
        "setp errpipe.in-x 123\nsetp errpipe.in-y 100\nsetp errpipe.enable 1\nstart\nloadusr -w sleep 0.3\n"
        "getp errpipe.wrong-rate\ngetp errpipe.correction-x\ngetp errpipe.heartbeat\n",
    )
    wrong, moved, beats = session.values(folder)
    assert (code, wrong, float(moved)) == (0, "TRUE", 0.0) and int(beats, 0) > 10


@pytest.mark.parametrize(
    "allowed", [pytest.param(True, id="own", marks=pytest.mark.slow), pytest.param(False, id="other")]
)
def test_only_the_allowed_table_moves(folder, allowed):
    only = int(ect.fingerprint(table()), 16) + (0 if allowed else 1)
    code = halrun(
        folder,
        f"loadrt threads name1=servo-thread period1={PERIOD_NS}\nloadrt errpipe\naddf errpipe servo-thread\n"
        f"setp errpipe.only {only}\nsetp errpipe.in-x 123\nsetp errpipe.in-y 100\nsetp errpipe.enable 1\n"
        "setp errpipe.in-t-nut 21\nsetp errpipe.in-tool-length 0\n"
        "start\nloadusr -w sleep 2\ngetp errpipe.refused\ngetp errpipe.correction-x\ngetp errpipe.heartbeat\n",
    )
    assert code == 0, session.said(folder)
    refused, moved, beats = session.values(folder)
    assert code == 0 and refused == str(not allowed).upper() and int(beats, 0) > 10
    assert (float(moved) != 0.0) == allowed


def test_a_damaged_table_is_refused_by_the_controller(folder):
    """One wrong byte in the component's table: LinuxCNC does not start with it, and says why."""
    text = LinuxcncHal.write(table())[COMPONENT]
    start = text.index("errpipe_table[")
    at = text.index("0x", start + 4000)
    wrong = f"0x{int(text[at + 2 : at + 4], 16) ^ 1:02x}"
    changed = (text[:at] + wrong + text[at + 4 :]).replace("component errpipe ", "component errpipe_damaged ")
    (folder / "errpipe_damaged.comp").write_text(changed)
    with session.installed(folder / "errpipe_damaged.comp"):
        assert halrun(folder, "loadrt errpipe_damaged\n") != 0
    assert "table refused: damaged (checksum)" in session.said(folder)
