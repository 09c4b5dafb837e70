"""A diameter in LinuxCNC's lathe: the turning centre's own table, its temperatures streamed in, X commanded to follow.

The table comes from the pipeline's stages: a season model of E_D that acts on X by half. A run of eight hours goes by
in a few seconds: the table's time constants are shortened by the same factor as the recording's time.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from errpipe.domain.table import CompensationTable, LagNode
from errpipe.stages import _artefacts
from errpipe.tables import batch
from errpipe.targets import TARGETS
from tests.e2e.linuxcnc import session

REAL = (
    Path(os.environ.get("ERRPIPE_REAL_DATA", Path(__file__).parents[4] / "shared/real-data")) / "turning-centre-thermal"
)
pytestmark = [
    *session.MARKS,
    pytest.mark.slow,
    pytest.mark.skipif(not REAL.is_dir(), reason="the turning centre's recording is not here"),
]
CYCLE = 0.001  # s
FASTER = 14_000  # ten servo cycles a row
WAIT = 9000  # cycles of the first row, in which the machine is switched on and homed
SECONDS = 18
PIPELINE = """pipeline: 1
title: Turning centre
stages:
  - {kind: ingest, recording: %s}
  - {kind: fit, family: season, component: E_D}
  - kind: export
    ungated: true
    acts_on:
      E_D: {axis: X, factor: 0.5}
"""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """(table, recording) from the command line."""
    from typer.testing import CliRunner

    from errpipe.cli._verbs import app

    folder = tmp_path_factory.mktemp("lathe")
    (folder / "p.yaml").write_text(PIPELINE % REAL)
    done = CliRunner().invoke(app, ["run", str(folder / "p.yaml"), "--out", str(folder / "out")])
    assert done.exit_code == 0, done.output
    recording = _artefacts.recording_in(folder / "out/ingest")
    return _artefacts.read_table(folder / "out/export" / _artefacts.TABLE), recording


def faster(table: CompensationTable) -> CompensationTable:
    """The table with its time constants shortened; rates of readings grow by the same factor, limits are left out."""
    lags = {"tau_up", "tau_down"}
    nodes = [
        n.model_copy(update={k: getattr(n, k) / FASTER for k in lags}) if isinstance(n, LagNode) else n
        for n in table.nodes
    ]
    inputs = [
        i.model_copy(update={"max_rate": i.max_rate * FASTER}) if i.max_rate is not None else i for i in table.inputs
    ]
    # A slow drift of the day is a fast one here: the limits of rate and acceleration would hold it back.
    outputs = [o.model_copy(update={"slew": None, "acceleration": None}) for o in table.outputs]
    changed = {"nodes": tuple(nodes), "inputs": tuple(inputs), "outputs": tuple(outputs)}
    return table.model_copy(update={**changed, "slow_every": 1, "ramp_s": 0.2})


def stream(recording, label: str, names: list[str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Readings per servo cycle (n, sensors), the recording's row of each, and the recorded deviations of the rows."""
    frame = recording.frame
    rows = frame[frame["run"] == label].dropna(subset=[*names, "dia_disp"])
    seconds = rows["t"].to_numpy() - rows["t"].iloc[0]
    cycles = np.arange(int(seconds[-1] / FASTER / CYCLE) + 1)
    which = np.concatenate([np.zeros(WAIT, int), np.searchsorted(seconds, cycles * CYCLE * FASTER, side="right") - 1])
    return rows[names].to_numpy()[which], which, rows["dia_disp"].to_numpy()


HAL = """loadrt trivkins coordinates=XZ
loadrt motmod servo_period_nsec=1000000 num_joints=2
loadrt streamer depth=16000 cfg=%s
loadrt sampler depth=30000 cfg=fffu
loadrt sum2 names=moved
loadrt scale names=nm
addf streamer.0 servo-thread
addf motion-command-handler servo-thread
addf motion-controller servo-thread
net z joint.1.motor-pos-cmd => joint.1.motor-pos-fb
loadusr -w ./feed.sh
"""
TRAJ = "DEFAULT_LINEAR_VELOCITY = 50\nMAX_LINEAR_VELOCITY = 500\n"
AXIS = "MIN_LIMIT = -300\nMAX_LIMIT = 300\nMAX_VELOCITY = 500\nMAX_ACCELERATION = 5000\n"


def write(folder: Path, table: CompensationTable, readings: np.ndarray, names: list[str]) -> None:
    """All files of a session."""
    (target,) = [t for t in TARGETS if t.controller == "LinuxCNC" and "temperature" in t.holds]
    files = target.write(table)
    pins = {
        n: p for p, n in re.findall(r"^# INPUT: net \S+ \(.*?\) => (\S+) +# (\S+)", files["errpipe-joints.hal"], re.M)
    }
    connect = [f"net sensor-{k} streamer.0.pin.{k} => {pins[n]}" for k, n in enumerate(names)]
    fresh = re.findall(r"^pin in bit (fresh_\w+)", files["errpipe.comp"], re.M)
    connect += [f"setp errpipe.{pin.replace('_', '-')} 1" for pin in fresh]
    connect += [
        "net errpipe-x-command => errpipe.measured-x moved.in0",
        "net x-wanted joint.0.pos-cmd => moved.in1 sampler.0.pin.0",
        "setp moved.gain1 -1",
        "setp nm.gain 1e6",
        "net moved moved.out => nm.in",
        "net nm nm.out => sampler.0.pin.1",
        "net sensor-0 => sampler.0.pin.2",
        f"net count streamer.0.pin.{len(names)} => sampler.0.pin.3",
        *(f"addf {f} servo-thread" for f in ("moved", "nm", "sampler.0")),
    ]
    axes = "".join(
        f"[AXIS_{a}]\n{AXIS}[JOINT_{n}]\nTYPE = LINEAR\nHOME = 0\nHOME_SEQUENCE = 0\n{AXIS}FERROR = 0.001\n"
        for n, a in enumerate("XZ")
    )
    texts = {
        **files,
        "core.hal": HAL % ("f" * len(names) + "u") + session.IO,
        "connect.hal": "\n".join([*connect, ""]),
        "sim.ini": session.ini("XZ", "errpipe-joints.hal", TRAJ, display="LATHE = 1\n") + axes,
        # A cylinder turned to and fro for as long as the readings last.
        "program.ngc": "G21 G90 G8\nF6000\n" + "G1 X20 Z-40\nG1 X21 Z0\n" * 10 + f"G4 P{SECONDS}\nM2\n",
        "readings.txt": "\n".join(" ".join([*(f"{v:.4f}" for v in row), str(k)]) for k, row in enumerate(readings))
        + "\n",
    }
    # In the background: the queue must be full before the servo thread starts, else the first readings are 0.
    texts["feed.sh"] = "#!/bin/sh\nnohup halstreamer -c 0 readings.txt >/dev/null 2>&1 &\nsleep 0.5\n"
    session.write(folder, texts, program_s=60, joints=2)
    (folder / "feed.sh").chmod(0o755)


def test_a_diameter_follows_the_temperatures_of_a_day(exported, capsys):
    """Every cycle: X moves by minus half of what the table says; the diameters end where the fit says."""
    made, recording = exported
    names = [i.name for i in made.inputs if i.kind == "sensor"]
    table = faster(made)
    spread = recording.frame.groupby("run")["dia_disp"].agg(lambda v: v.max() - v.min())
    label = str(spread.idxmax())  # the run in which the diameter drifts furthest
    readings, which, recorded = stream(recording, label, names)
    with session.alone() as folder:
        write(folder, table, readings, names)
        with session.installed(folder / "errpipe.comp"):
            facts, rows = session.run(folder, 120)
    assert facts["output"] == [] and facts["overruns"] == 0
    moved, count = 1e-3 * rows[:, 2], rows[:, 4].astype(int)  # um; the reading of the cycle
    first = int(np.argmax(count >= WAIT))
    assert count[-1] == len(readings) - 1 and first > 500, "the day must begin after the machine is on"
    columns = {n: readings[:, k] for k, n in enumerate(names)}
    replay = batch.evaluate(table, columns, CYCLE * np.arange(len(readings)), np.zeros(len(readings), int))
    wanted = -replay.deviation[table.outputs[0].name]  # um along X
    day = slice(first, first + len(readings) - WAIT)
    np.testing.assert_allclose(moved[day], wanted[count[day]], atol=0.01)
    last = np.searchsorted(which[WAIT:], np.arange(len(recorded)), side="right") - 1  # the last cycle of each row
    seen = (last >= 0) & (which[WAIT:][last] == np.arange(len(recorded)))
    before = recorded[seen] - recorded[0]
    after = before + 2.0 * (moved[day][last[seen]] - moved[day][0])
    fit = before + 2.0 * (wanted[WAIT:][last[seen]] - wanted[WAIT])
    with capsys.disabled():
        rms = [float(np.sqrt(np.mean(v**2))) for v in (before, after, fit)]
        print(f"\nLinuxCNC lathe, diameters of run {label}, um rms: {rms[0]:.2f}, compensated {rms[1]:.2f}", end="")
        print(f" (the fit says {rms[2]:.2f})")
    np.testing.assert_allclose(after, fit, atol=0.02)
    assert np.sqrt(np.mean(after**2)) < 0.4 * np.sqrt(np.mean(before**2))
