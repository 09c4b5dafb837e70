"""From CSV to a name: orders of a wave, a resonance, a dead time, two time constants, wear of several tools.

The data are made with scipy and closed forms; each case says what must come back, and within its interval.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.signal import TransferFunction, lsim

from errpipe.diagnosis import diagnose
from errpipe.formats import manifest_folder
from trials import folder
from trials.folder import Sheet
from trials.rivals import first_order

Case = tuple[Sheet, str, dict[str, float]]
POSITION = {"role": "position", "axis": "X", "unit": "mm"}
TIME = {"role": "time", "unit": "s"}
AXIS = {"role": "axis", "kind": "linear", "travel": [0.0, 400.0], "unit": "mm"}


def sheet(data: dict, columns: dict, component: str, unit: str, model, seen, facts: dict | None = None) -> Sheet:
    """A recording of one response: what was seen beside what the simulation says."""
    columns = dict(columns)
    columns["seen"] = {"role": "error", "component": component, "unit": unit}
    columns["model"] = {"role": "simulated", "component": component, "unit": unit}
    table = pd.DataFrame({**data, "seen": np.round(seen, 2), "model": np.round(model, 3)})
    return Sheet("known answer", table, columns, "machine", {"X": facts} if facts else {})


def under_way(rng: np.random.Generator, hertz: float, seconds: float) -> tuple[dict, dict]:
    """A log of strokes between random places, at most 200 mm/s and 2 m/s2, with speed and acceleration."""
    x, n = [np.array([200.0])], int(hertz * seconds)
    while sum(map(len, x)) < n:
        goal, speed = rng.uniform(10, 390), 200 * rng.choice([0.3, 0.6, 1.0])
        way = goal - x[-1][-1]
        lasting = max(abs(way) / speed, 0.1) + 0.1
        s = np.arange(1 / hertz, lasting, 1 / hertz)
        up, down = np.minimum(s, 0.1), np.maximum(s - lasting + 0.1, 0)
        x.append(x[-1][-1] + way / (lasting - 0.1) * (up**2 / 0.2 + np.maximum(s - 0.1, 0) - down**2 / 0.2))
    place = np.concatenate(x)[:n]
    t = np.arange(n) / hertz
    v = np.gradient(place, t)
    columns = {"t": TIME, "x": POSITION, "v": {"role": "velocity", "axis": "X", "unit": "mm/s"}}
    columns["a"] = {"role": "acceleration", "axis": "X", "unit": "mm/s2"}
    return {"t": t.round(4), "x": place.round(5), "v": v.round(4), "a": np.gradient(v, t).round(3)}, columns


def cogging() -> Case:
    """Orders 1 and 6 of a pole pair of 24 mm, which the manifest does not state."""
    rng = np.random.default_rng(21)
    data, columns = under_way(rng, 250.0, 16.0)
    model = 0.08 * data["a"] + 15 * np.sign(data["v"])
    turn = 2 * np.pi * data["x"] / 24
    seen = model + 6 * np.sin(turn + 0.4) + 4 * np.sin(6 * turn + 2) + 2 * rng.normal(size=turn.size)
    sizes = {"amplitude": 6.0, "amplitude_6": 4.0, "period": 24.0}
    return sheet(data, columns, "F_X", "N", model, seen, AXIS), "torque_ripple", sizes


def slots() -> Case:
    """A motor of 7 pole pairs and 12 slots over one turn, both ways: orders 7, 28 and 12 of the turn."""
    rng = np.random.default_rng(27)
    x = np.r_[np.linspace(0, 359.3, 512), np.linspace(359.3, 0, 512)]
    side = np.repeat([1, -1], 512)
    turn = np.deg2rad(x)
    model = 0.4 * side
    seen = model + 2.5 * np.sin(7 * turn + 1) + 1.3 * np.sin(28 * turn) + 0.6 * np.sin(12 * turn + 2)
    seen = seen + 0.3 * rng.normal(size=x.size)
    data = {"t": np.arange(1024) * 1.5, "c": x.round(4), "dir": side}
    columns = {
        "t": TIME,
        "c": {"role": "position", "axis": "C", "unit": "deg"},
        "dir": {"role": "direction", "axis": "C"},
    }
    made = sheet(data, columns, "F_C", "N m", model, seen)
    made.constants["C"] = {"role": "axis", "kind": "rotary", "unit": "deg"}
    sizes = {"amplitude": 2.5, "amplitude_28": 1.3, "amplitude_12": 0.6, "period": 360 / 7}
    return made, "torque_ripple", sizes


def belt() -> Case:
    """A belt of 5 mm teeth on a pulley of 30: manifest and mismatch hold both waves."""
    rng = np.random.default_rng(22)
    x = np.tile(np.r_[np.arange(0, 1500, 2.0), np.arange(1500, 0, -2.0)], 2) + rng.uniform(-0.6, 0.6, 3000)
    model = 0.02 * x
    turn = 2 * np.pi * x / 150
    seen = model + 25 * np.sin(turn + 1) + 9 * np.sin(30 * turn) + 5 * rng.normal(size=x.size)
    facts = {**AXIS, "travel": [0.0, 1500.0], "tooth_pitch": 5.0, "teeth": 30}
    data = {"t": np.arange(3000) * 0.5, "x": x.round(4)}
    sizes = {"amplitude": 25.0, "amplitude_30": 9.0}
    return sheet(data, {"t": TIME, "x": POSITION}, "EXX", "um", model, seen, facts), "pitch_cyclic", sizes


def mode() -> Case:
    """A column of 37 Hz and 2 um per m/s2; the simulation holds its static lean."""
    rng = np.random.default_rng(23)
    data, columns = under_way(rng, 500.0, 12.0)
    w = 2 * np.pi * 37
    model = -2e-3 * data["a"]
    leaning = lsim(TransferFunction([w**2], [1, 2 * 0.04 * w, w**2]), data["a"], np.arange(model.size) / 500.0)[1]
    seen = -2e-3 * leaning + 0.4 * rng.normal(size=model.size)
    sizes = {"compliance": 2.0, "frequency": 37.0, "damping": 0.04}
    return sheet(data, columns, "EXX", "um", model, seen, AXIS), "flexible_mode", sizes


def delay() -> Case:
    """A smooth drive force that comes three quarters of a row late: three of the ms of which every fourth is read."""
    rng = np.random.default_rng(24)
    data, columns = under_way(rng, 1000.0, 16.0)
    force = np.convolve(60e-3 * data["a"] + 20 * np.tanh(data["v"] / 3), np.hanning(80) / 39.5, "same")
    late = np.r_[np.full(3, force[0]), force[:-3]]
    data = {name: values[::4] for name, values in data.items()}
    seen = late[::4] + 0.5 * rng.normal(size=data["t"].size)
    return sheet(data, columns, "F_X", "N", force[::4], seen, AXIS), "dead_time", {"delay": 0.003}


def two_bodies() -> Case:
    """A spindle nose of 900 s and a column of 9000 s follow one sensor."""
    rng = np.random.default_rng(25)
    t = 60.0 * np.arange(600)
    bearing = 20 + first_order(t, np.repeat(rng.uniform(0, 12, 20), 30), 400.0)
    room = 20 + 1.2 * np.sin(t / 5000)
    model = 2 * (room - 20)
    quick, slow = (first_order(t, bearing - bearing[0], tau) for tau in (900.0, 9000.0))
    seen = model + 1.5 * quick + 3 * slow + 0.4 * rng.normal(size=t.size)
    data = {"t": t, "T_b": bearing.round(3), "T_room": room.round(3)}
    columns = {"t": TIME, "T_b": {"role": "temperature", "unit": "degC", "location": "bearing"}}
    columns["T_room"] = {"role": "temperature", "unit": "degC", "location": "room"}
    sizes = {"gain": 1.5, "gain_slow": 3.0, "tau": 900.0, "tau_slow": 9000.0}
    return sheet(data, columns, "E_Z", "um", model, seen), "thermal_lag", sizes


def five_tools() -> Case:
    """8 um of wear after 120 m with each of five tools; the counter of the length cut runs on."""
    rng = np.random.default_rng(26)
    cut = np.cumsum(rng.uniform(1, 3, 300))
    tool = np.arange(300) // 60
    own = cut - np.r_[0.0, cut][tool * 60]
    model = 3 * np.sin(np.arange(300) / 40)
    seen = model + 8 * (own / 120) ** 0.7 + 0.6 * rng.normal(size=300)
    data = {"t": 40.0 * np.arange(300), "tool": tool, "L": cut.round(2)}
    columns = {"t": TIME, "tool": {"role": "group", "of": "tool"}, "L": {"role": "cut_length", "unit": "m"}}
    return sheet(data, columns, "E_D", "um", model, seen), "tool_wear", {"exponent": 0.7}


NOISE = {"cogging": 2.0, "slots": 0.3, "belt": 5.0, "mode": 0.4, "delay": 0.5, "two_bodies": 0.4, "five_tools": 0.6}
CASES = {make.__name__: make for make in (cogging, slots, belt, mode, delay, two_bodies, five_tools)}


SLOW = ("cogging", "delay")  # torque_ripple is also in `slots`, a delay of part of a row in `test_drives`


@pytest.mark.parametrize("name", [pytest.param(n, marks=pytest.mark.slow if n in SLOW else ()) for n in CASES])
def test_named_with_its_sizes_and_nothing_else(name: str, tmp_path: Path) -> None:
    made, effect, sizes = CASES[name]()
    folder.write(tmp_path / "recording", made)
    response = diagnose(manifest_folder.read(tmp_path / "recording"))[0].responses[0]
    findings = [f for f in response.findings if f.effect != "recalibration"]
    assert [f.effect for f in findings] == [effect]
    output = {p.name: p for p in findings[0].parameters}
    for size, true in sizes.items():
        low, high = output[size].ci95
        assert low <= true <= high, (size, output[size])
        assert abs(output[size].value) == pytest.approx(true, rel=0.15)
    assert effect.replace("_", " ") in findings[0].says
    assert (
        response.rms_after_um < 1.25 * response.noise_floor_um or response.rms_after_um < 0.2 * response.rms_before_um
    )


@pytest.mark.slow
def test_the_command_writes_it_down(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from errpipe.cli._verbs import app

    folder.write(tmp_path / "recording", cogging()[0])
    ran = CliRunner().invoke(app, ["diagnose", str(tmp_path / "recording"), "--out", str(tmp_path / "out")])
    assert ran.exit_code == 0, ran.output
    (response,) = json.loads((tmp_path / "out" / "diagnosis.json").read_text())["responses"]
    assert response["findings"][0]["effect"] == "torque_ripple"
    assert {"amplitude", "amplitude_6"} <= {p["name"] for p in response["findings"][0]["parameters"]}
