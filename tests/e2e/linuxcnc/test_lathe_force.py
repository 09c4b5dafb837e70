"""Cutting force in LinuxCNC's lathe: the force streamed in, simulated diameters before and after.

The table comes from the example's pipeline (push tests and beam elements); the truth is `lathe.gives`, which uses none.
"""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from errpipe.tables import batch, ect
from tests.e2e.linuxcnc import session, test_lathe

pytestmark = [*session.MARKS, pytest.mark.slow]
TOP = Path(__file__).parents[3]
PIPELINE = TOP / "examples" / "cutting-force" / "pipeline.yaml"
SECONDS = 14


@pytest.fixture(scope="module")
def lathe():
    """The simulated lathe of the example."""
    spec = importlib.util.spec_from_file_location("lathe", PIPELINE.with_name("lathe.py"))
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """From the command line."""
    import subprocess

    out = tmp_path_factory.mktemp("force")
    words = [sys.executable, "-m", "errpipe", "run", str(PIPELINE), "--out", str(out), "--to", "export"]
    subprocess.run(words, cwd=TOP, check=True, capture_output=True)
    return ect.read(out / "export" / "table.ect")


def forces() -> np.ndarray:
    """Radial force of each servo cycle, N: rises into a cut, wanders with the depth, and ends."""
    n = int(SECONDS / test_lathe.CYCLE)
    t = np.arange(n) / n
    force = 250.0 * np.clip(20 * t, 0, 1) * np.clip(20 * (1 - t), 0, 1) * (1 + 0.3 * np.sin(12 * np.pi * t))
    return np.r_[np.zeros(test_lathe.WAIT), force][:, None]


def write(folder: Path, table, readings: np.ndarray) -> None:
    """The files of the session of temperatures, with the force as its stream, and Z beside what X moved."""
    test_lathe.write(folder, table, readings, ["F"])
    connect = (folder / "connect.hal").read_text()
    connect = connect.replace("joint.0.pos-cmd => moved.in1 sampler.0.pin.0", "joint.0.pos-cmd => moved.in1")
    connect += "net z => sampler.0.pin.0\n"
    (folder / "connect.hal").write_text(connect)
    program = "G21 G90 G8\nF3000\nG0 Z170\n" + "G1 Z70\nG1 Z170\n" * 6 + f"G4 P{SECONDS}\nM2\n"
    (folder / "program.ngc").write_text(program)


def test_parts_turned_under_force_come_out_straight(lathe, table, capsys):
    """Every cycle X moves by minus what the table says of force and Z; the diameters' error falls by ten."""
    readings = forces()
    with session.alone() as folder:
        write(folder, table, readings)
        with session.installed(folder / "errpipe.comp"):
            facts, rows = session.run(folder, 120)
    assert facts["output"] == [] and facts["overruns"] == 0
    z, moved, force, count = rows[:, 1], 1e-3 * rows[:, 2], rows[:, 3], rows[:, 4].astype(int)
    cut = (count >= test_lathe.WAIT) & (count < len(readings) - 1) & (z >= 70.0) & (z <= 170.0)
    assert cut.sum() > 5000 and np.ptp(z[cut]) > 50, "the tool must have travelled while the force acted"
    gives = np.interp(z[cut], *curve(lathe))
    before = 2.0 * force[cut] * gives
    after = before + 2.0 * moved[cut]
    some = np.flatnonzero(cut)[::500]
    said = [
        batch.position(table, np.array([[place]]), ("Z",), {"F": push})[0, 0]
        for place, push in zip(z[some], force[some], strict=True)
    ]
    np.testing.assert_allclose(moved[some], -np.array(said), atol=0.3)  # um: a cycle late, within its slew
    rms = [float(np.sqrt(np.mean(v**2))) for v in (before, after)]
    with capsys.disabled():
        print(f"\nLinuxCNC lathe under force, diameters, um rms: {rms[0]:.2f}, compensated {rms[1]:.2f}", end="")
    assert rms[1] < 0.1 * rms[0]


def curve(lathe) -> tuple[np.ndarray, np.ndarray]:
    """Places and true compliance of the part, um/N."""
    at = np.linspace(60.0, 180.0, 61)
    return at, np.array([lathe.gives(z, lathe.WORK) for z in at])
