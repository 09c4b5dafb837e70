"""A measurement beside its simulation, in words and quantities that people use: the same mismatch in all of them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from tests.unit.importing import known_test

PLACES = np.linspace(0.0, 600.0, 31)
SIMULATED = 0.02 * PLACES + 3.0 * np.sin(2 * np.pi * PLACES / 600.0)  # um
MISSING = 5.0  # um: the machine goes too far in plus by what the simulation lacks


def imported(tmp_path: Path, lines: list[str], **said: str) -> Recording:
    (tmp_path / "log.csv").write_text("\n".join(lines))
    return known_test.imported(tmp_path, tmp_path / "log.csv", **said)


def deviations(header: str) -> list[str]:
    return [header, *(f"{x:g},{s + MISSING:.5f},{s:.5f}" for x, s in zip(PLACES, SIMULATED, strict=True))]


def mismatch(recording: Recording, component: str) -> np.ndarray:
    (error,) = recording.names("error", component=component)
    (twin,) = recording.names("simulated", component=component)
    return recording.array(error) - recording.array(twin)


@pytest.mark.parametrize(
    "header",
    [
        "X_soll [mm],Abweichung [um],Modell [um]",
        "Target X (mm),Measured deviation (um),Digital twin (um)",
        "X [mm],EXX measured [um],EXX FEM [um]",
        "X [mm],deviation [um],simuliert [um]",
        "position [mm],error [um],prediction [um]",
    ],
)
def test_a_simulated_deviation_is_known_by_its_name(tmp_path: Path, header: str) -> None:
    recording = imported(tmp_path, deviations(header))
    assert mismatch(recording, "EXX") == pytest.approx(np.full(31, MISSING), abs=1e-4)


@pytest.mark.parametrize("header", ["cmd_X [mm],act_X [mm],sim_X [mm]", "X_soll,X_ist,X_sim"])
def test_simulated_positions_are_counted_from_the_command(tmp_path: Path, header: str) -> None:
    rows = (f"{x:.6f},{x + (s + MISSING) / 1e3:.6f},{x + s / 1e3:.6f}" for x, s in zip(PLACES, SIMULATED, strict=True))
    recording = imported(tmp_path, [header, *rows])
    (twin,) = recording.names("simulated", component="EXX")
    assert recording.array(twin) == pytest.approx(SIMULATED, abs=2e-3)
    assert mismatch(recording, "EXX") == pytest.approx(np.full(31, MISSING), abs=4e-3)


def forces(header: str) -> list[str]:
    t = np.arange(0.0, 20.0, 0.01)
    v = 60.0 * np.sin(2 * np.pi * t / 8.0)
    x = 300.0 + np.cumsum(v) * 0.01
    rows = zip(t, x, v, 80.0 * np.sign(np.round(v, 5)) + v / 2, v / 2, strict=True)
    return [header, *(",".join(f"{value:.5f}" for value in row) for row in rows)]


@pytest.mark.parametrize("names", ["Antriebskraft [N],Kraft simuliert [N]", "drive force (N),force model (N)"])
def test_a_force_with_its_simulation_is_the_response(tmp_path: Path, names: str) -> None:
    recording = imported(tmp_path, forces(f"Zeit [s],X [mm],vX [mm/s],{names}"))
    (speed,) = recording.names("velocity")
    sign = np.sign(recording.array(speed))
    assert mismatch(recording, "F_X") == pytest.approx(80.0 * sign, abs=1e-3)


def test_a_torque_of_a_linear_axis_and_several_forces_are_asked_for(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="divide by the lever"):
        imported(tmp_path, forces("t [s],X [mm],v [mm/s],torque [Nm],torque model [Nm]"))
    lines = [f"{line},{line.split(',')[3]}" for line in forces("t [s],X [mm],v [mm/s],force [N],force model [N]")]
    lines[0] = "t [s],X [mm],v [mm/s],force [N],force model [N],cutting force [N]"
    with pytest.raises(DataError, match="several forces"):
        imported(tmp_path, lines)


def turned(header: str, way: float) -> list[str]:
    """Commanded minus measured; way: sign of the simulation as it is written, beside that of the recording."""
    rows = zip(PLACES, SIMULATED, strict=True)
    return [header, *(f"{x:g},{-s - MISSING:.5f},{-way * s:.5f}" for x, s in rows)]


@pytest.mark.parametrize(
    "header, way",
    [
        ("X [mm],error (commanded - actual) [um],simulated (commanded - actual) [um]", 1.0),
        ("X [mm],error (commanded - actual) [um],simulated [um]", 1.0),
        ("X [mm],error (commanded - actual) [um],simulated (actual - commanded) [um]", -1.0),
        ("X [mm],error (commanded - actual) [um],simulated [um]", -1.0),
    ],
)
def test_a_simulation_has_the_sign_of_the_recording_with_it(tmp_path: Path, header: str, way: float) -> None:
    """Only the recorded column was turned: twice the simulation was called missing."""
    recording = imported(tmp_path, turned(header, way))
    assert mismatch(recording, "EXX") == pytest.approx(np.full(PLACES.size, MISSING), abs=1e-3)


def test_a_simulation_without_a_component_is_of_the_only_response(tmp_path: Path) -> None:
    rows = [f"{60 * k},{k // 10 + 1},{1.2 * (k % 10)},{0.3 * (k % 10)},0" for k in range(40)]
    recording = imported(tmp_path, ["t_s,tool,cut_length_m,diameter_error_um,simulated_um", *rows])
    assert recording.names("simulated", component="E_D")
    assert recording.names("cut_length") and recording.manifest.columns["tool"].of == "tool"


def test_a_following_error_does_not_keep_a_force_from_its_simulation(tmp_path: Path) -> None:
    """A log of a drive has command and actual position too: their difference has no simulation, the force has one."""
    rows = [line.split(",") for line in forces("")[1:]]
    lines = [f"{t},{x},{float(x) + 0.01},{force},{model}" for t, x, _, force, model in rows]
    head = "t [s],X command [mm],X actual [mm],motor force [N],simulated motor force [N]"
    recording = imported(tmp_path, [head, *lines])
    assert np.ptp(np.abs(mismatch(recording, "F_X"))) < 80.0 + 1e-3 and recording.names("error", component="EXX")
