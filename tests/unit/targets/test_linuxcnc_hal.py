"""The HAL component as text: names that HAL takes, sums per axis, refusals; LinuxCNC itself runs it in tests/e2e."""

from __future__ import annotations

import re
import shutil
import subprocess

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import CompensationTable, TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError, VerifyError
from errpipe.targets import linuxcnc_hal, linuxcnc_screw
from errpipe.targets.linuxcnc_hal import COMPONENT, JOINTS, SHIFT, LinuxcncHal
from tests.unit.targets import machines

PIN = re.compile(r"^pin (?:in|out) \w+ (\w+)", re.M)
HAL_NAME_LENGTH = 47


def with_sensors(*names, machine="test"):
    """X warmed by sensors of any name."""
    inputs = machines.INPUTS[:1] + [
        TableInput(name=n, kind="sensor", unit="degC", low=-40, high=100, default=20, stale_after_s=2.0) for n in names
    ]
    pairs = [machines.straight("X", 1.0 + k, driver=d.above(n, 20.0)) for k, n in enumerate(names)]
    return tables.compile_table(
        [tables.ComponentSource("EXX", "um", tuple(pairs))], inputs=inputs, travel=machines.AXES, machine=machine
    )


def test_names_become_hal_names_one_each():
    table = with_sensors("T nut", "T-nut", "t_nut", "Ölsumpf °C", "_", "a very long name of a sensor 31")
    pins = PIN.findall(LinuxcncHal.write(table)[COMPONENT])
    assert len(pins) == len(set(pins))
    for pin in pins:
        assert re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", pin)
        assert len(f"errpipe.{pin}") <= HAL_NAME_LENGTH
    assert {"in_t_nut", "in_t_nut_2", "in_t_nut_3", "in_lsumpf_c", "in_pin", "fresh_t_nut"} <= set(pins)


def test_every_pin_in_the_hal_files_is_a_pin_of_the_component():
    files = LinuxcncHal.write(machines.warm())
    known = {f"errpipe.{linuxcnc_hal.hal(name)}" for name in PIN.findall(files[COMPONENT])}
    known |= {"errpipe.count-size", "errpipe.feedback"}  # a parameter and a function
    for name in (JOINTS, SHIFT):
        used = set(re.findall(r"errpipe\.[a-z][a-z0-9-]*", files[name]))
        assert used <= known, used - known
        assert {"errpipe.enable", "errpipe.homed", "errpipe.in-x"} <= used


def test_corrections_of_one_axis_are_added():
    """Two components along X, each its own output: HAL has one pin for X."""
    bow = Lowered(d.ONE, "Y", lambda y: 3.0 * np.sin(y / 50.0))
    table = machines.compile_(("EXX", [machines.straight("X", 10.0)]), ("EXY", [bow]))
    text = LinuxcncHal.write(table)[COMPONENT]
    assert "*inst->correction_x = errpipe_state.outputs[0].correction + errpipe_state.outputs[1].correction;" in text
    assert text.count("pin out float correction_") == 1


def test_a_table_that_moves_no_axis_is_refused():
    table = machines.too_long_at_plus_x()
    output = table.outputs[0].model_dump() | {"axis": ""}
    with pytest.raises(GateError, match="no output of the table moves an axis"):
        LinuxcncHal.write(CompensationTable.model_validate(table.model_dump() | {"outputs": [output]}))


def test_a_table_too_large_to_compile_is_refused(monkeypatch):
    monkeypatch.setattr(linuxcnc_hal, "MAX_TABLE_BYTES", 1000)
    with pytest.raises(GateError, match="allow a larger error_bound"):
        LinuxcncHal.write(machines.warm())


@pytest.mark.parametrize("damage", ["byte", "missing", "cut"])
def test_a_damaged_component_is_not_read_back(damage):
    files = LinuxcncHal.write(machines.warm())
    text = files[COMPONENT]
    start = text.index("0x", text.index("errpipe_table["))
    at = text.index("0x", start + 4000)
    changed = {
        "byte": text[:at] + f"0x{int(text[at + 2 : at + 4], 16) ^ 4:02x}" + text[at + 4 :],
        "missing": text[:at] + text[at + 6 :],
        "cut": text[: len(text) // 2],
    }[damage]
    with pytest.raises(VerifyError):
        LinuxcncHal.read_back({**files, COMPONENT: changed})


@pytest.mark.toolchain
@pytest.mark.skipif(shutil.which("halcompile") is None, reason="halcompile (linuxcnc-uspace-dev) is not installed")
def test_halcompile_takes_any_title(tmp_path):
    table = with_sensors("T (nut) [1]", "x:/ y%", machine='a "b" \\ */ """ ; c')
    (tmp_path / COMPONENT).write_text(LinuxcncHal.write(table)[COMPONENT])
    env = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path), "LANG": "C.UTF-8"}
    run = subprocess.run(
        ["halcompile", "--compile", COMPONENT], cwd=tmp_path, env=env, capture_output=True, text=True, timeout=120
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "warning" not in run.stdout + run.stderr


@pytest.mark.parametrize(
    ("units", "starts"), [("mm", True), ("metric", True), ("inch", False), ("in", False), ("1", False)]
)
@pytest.mark.parametrize("name", [JOINTS, SHIFT, linuxcnc_screw.GUARD])
def test_a_machine_in_inches_does_not_start(name, units, starts):
    """It took corrections in mm as inches, at positions in inches: 25.4 times too far, at the wrong place."""
    target = linuxcnc_screw.LinuxcncScrew if name == linuxcnc_screw.GUARD else LinuxcncHal
    text = target.write(machines.too_long_at_plus_x())[name]
    waited, loaded = re.search(r"^loadusr -w (.*)\n(.*)$", text, re.M).groups()
    assert loaded == ("loadrt errpipe" if target is LinuxcncHal else "")  # nothing is loaded before it
    done = subprocess.run(waited.replace("[TRAJ]LINEAR_UNITS", units).split(), capture_output=True, check=False)
    assert (done.returncode == 0) == starts


def test_no_origin_shift_for_drives_that_are_no_axes_of_linuxcnc():
    """`axis.x1` and `axis.x2` of a gantry do not exist: LinuxCNC did not start with that file."""
    pairs = {n: (Lowered(d.ONE, n, lambda x: 0.01 * x),) for n in ("X1", "X2")}
    table = tables.compile_table(
        [tables.ComponentSource(f"EX{n}", "um", p, True) for n, p in pairs.items()],
        inputs=[TableInput(name=n, kind="position", axis=n, unit="mm", low=-500, high=1500, default=0) for n in pairs],
        travel=dict.fromkeys(pairs, (0.0, 1000.0)),
    )
    files = LinuxcncHal.write(table)
    assert SHIFT not in files and "joint.1" in files[JOINTS]
    stated = [note.text for note in LinuxcncHal.by_hand(table, LinuxcncHal.read_back(files), ())]
    assert any(SHIFT in text and "X1, X2" in text for text in stated)
    assert SHIFT in LinuxcncHal.write(machines.too_long_at_plus_x())
