"""The exported sections in the Klipper host: the toolhead goes where the target's reader says it will."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from errpipe.targets.klipper_sections import FILE, KlipperSections
from tests.e2e.klipper import host
from tests.unit.targets import machines

pytestmark = [pytest.mark.toolchain, pytest.mark.slow]

PRINT_MM = 1.1e-6  # GET_POSITION prints six decimals; read_back's own numbers are not rounded


@pytest.fixture(scope="module")
def klippy(tmp_path_factory):
    if shutil.which("gcc") is None:
        pytest.skip("the Klipper host compiles its C part with gcc, which is not installed")
    if not Path("/usr/include/usb.h").is_file():
        pytest.skip("libusb (usb.h) is not installed; the Klipper host's package needs it to build")
    try:
        return host.make(tmp_path_factory.mktemp("klippy"))
    except subprocess.SubprocessError as problem:
        pytest.skip(f"the Klipper host cannot be installed from the package index here: {type(problem).__name__}")


def test_toolhead_positions_equal_what_is_read_back(klippy, tmp_path, capsys):
    files = KlipperSections.write(machines.bent())
    read = KlipperSections.read_back(files)
    (tmp_path / FILE).write_text(files[FILE])
    rng = np.random.default_rng(4)
    places = np.round([[rng.uniform(*machines.AXES[a]) for a in "XYZ"] for _ in range(40)], 3)
    places[:4] = [[0, 0, 0], [500, 400, -300], [500, 0, -1], [250, 400, -150]]
    lines = ["SET_KINEMATIC_POSITION X=0 Y=0 Z=0", "BED_MESH_PROFILE LOAD=errpipe", "SKEW_PROFILE LOAD=errpipe"]
    lines += [f"G1 X{x:.3f} Y{y:.3f} Z{z:.3f} F6000\nM400\nGET_POSITION" for x, y, z in places]
    motion = host.positions(klippy, tmp_path, host.printer(machines.AXES, FILE), "\n".join(lines) + "\n")
    assert len(motion) == len(places)
    at = dict(zip("XYZ", places.T, strict=True))
    worst = {}
    for axis in "XYZ":
        moved = read.correction(axis, at, np.ones(len(places)), {"T": np.full(len(places), 20.0)})
        worst[axis] = np.abs(np.array([row[axis] for row in motion]) - at[axis] - moved).max()
    with capsys.disabled():
        output = ", ".join(f"{axis} {gap * 1e6:.2f} nm" for axis, gap in worst.items())
        print(f"\nKlipper host against read-back, worst of {len(places)} places: {output}")
    assert max(worst.values()) < PRINT_MM
    # A bed 20 um high at X = +500 lifts Z by that much less; a positive C0Y leans Y to minus X and is undone.
    there = motion[2]
    assert (there["Z"] - -1.0) * 1e3 == pytest.approx(-20.0, abs=0.05)
    assert (motion[3]["X"] - 250.0) * 1e3 == pytest.approx(10.0, abs=0.05)


def test_a_warm_day_moves_z_by_what_is_read_back(klippy, tmp_path, capsys):
    """A Z that drifts 2 um/K: in batch mode the host's sensors read 0 degC, so the reference is moved instead."""
    files = KlipperSections.write(machines.warm())
    read = KlipperSections.read_back(files)
    (line,) = read.lines
    (tmp_path / FILE).write_text(files[FILE])
    sensor = "[z_thermal_adjust]\nsensor_type: temperature_host\nmin_temp: -60\nmax_temp: 100\n"
    by_name = {}
    for rise in (-12.0, 10.0, 25.0):
        gcode = f"SET_KINEMATIC_POSITION X=0 Y=0 Z=0\nSET_Z_THERMAL_ADJUST REF_TEMP={-rise}\n"
        gcode += "G1 X50 Y50 Z-100 F6000\nM400\nGET_POSITION\n"
        (place,) = host.positions(klippy, tmp_path, sensor + host.printer(machines.AXES, FILE), gcode)
        by_name[rise] = 1e3 * (place["Z"] + 100.0)
    with capsys.disabled():
        print("\nKlipper host, Z per warmth: " + ", ".join(f"{k:+g} K {v:+.3f} um" for k, v in by_name.items()))
    for rise, moved in by_name.items():
        want = read.correction(
            "Z",
            {"X": np.full(1, 50.0), "Y": np.full(1, 50.0), "Z": np.full(1, -100.0)},
            np.ones(1),
            {line.sensor: np.full(1, line.reference + rise)},
        )
        assert moved == pytest.approx(1e3 * want[0], abs=0.0011)
    assert by_name[10.0] == pytest.approx(-20.0, abs=0.05)  # 20 um too high: told to go 20 um less high
