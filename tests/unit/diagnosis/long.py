"""Recordings of 20 000 and a million rows, and the time and memory that a fresh process takes to diagnose one.

python -m tests.unit.diagnosis.long SHAPE        one line of JSON
"""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import numpy as np

from errpipe.domain.recording import Recording
from tests.peak_memory import peak_kb

from .machines import recording

ROWS = 20_000
THREE = ("EXX", "EYX", "EZX")
STEP = 1e-3  # s, of the 1 kHz log
WHERE = ("bed", "ball-screw nut", "air beside the beam", "room", "motor", "column")
AXIS = {"role": "axis", "kind": "linear", "travel": (0, 600), "screw_lead": 10.0, "drive_end": 0.0, "unit": "mm"}


def _kind(role: str, **more: Any) -> dict[str, Any]:
    return {"role": role, **more}


def _sensors(t: np.ndarray, count: int) -> tuple[dict, dict]:
    """Temperatures that rise and swing, each in its own time."""
    columns = {
        f"T_{k}": 20 + (1 + k) * (np.sin(t / (3500 + 1500 * k) + k) + 1 - np.exp(-t / 9000)) for k in range(count)
    }
    return columns, {n: _kind("temperature", unit="degC", location=w) for n, w in zip(columns, WHERE, strict=False)}


def linear_axis(runs: int, step: float, responses: tuple[str, ...], sensors: int = len(WHERE)) -> Recording:
    """An axis back and forth in `runs` sessions, a row every `step` seconds; backlash is left out of EXX."""
    rng = np.random.default_rng(0)
    i = np.arange(ROWS)
    run = i * runs // ROWS
    t = i * step + run * 20000.0
    x = 300 + 250 * np.sin(i * 0.026) + 30 * np.sin(i * 0.062)
    side = np.sign(np.gradient(x))
    read, kinds = _sensors(t, sensors)
    columns = {"run": [str(r + 1) for r in run], "t": t, "x": x, "dir": side, **read}
    kinds |= {"run": _kind("run"), "t": _kind("time", unit="s"), "dir": _kind("direction", axis="X")}
    kinds["x"] = _kind("position", axis="X", unit="mm")
    for name in responses:
        lead, drift = 15e-3 * x, 2.5 * (read["T_0"] - 20)
        gap = 2.0 * side if name == "EXX" else 8.0 * (x / 300 - 1) ** 3
        columns[name] = 1.08 * lead + 0.95 * drift + gap + 0.5 * rng.standard_normal(ROWS)
        columns[f"{name}_sim"] = lead + drift
        kinds[name] = _kind("error", component=name, unit="um")
        kinds[f"{name}_sim"] = _kind("simulated", component=name, unit="um")
    return recording(columns, kinds, {"X": AXIS})


def grid() -> Recording:
    """Points in a volume under loads and tool lengths; squareness is left out of E_X, sag of E_Y."""
    rng = np.random.default_rng(1)
    i = np.arange(ROWS)
    run = i * 8 // ROWS
    t = i * 4.0 + run * 5000.0
    place = {a: rng.choice(np.linspace(0, s, 11), ROWS) for a, s in (("x", 600), ("y", 400), ("z", 300))}
    columns = {
        "run": [str(r + 1) for r in run],
        "t": t,
        **place,
        "load": np.array([0.0, 200.0])[run % 2],
        "tool": np.array([50.0, 150.0, 250.0, 350.0])[run % 4],
        "T_bed": 20 + 2 * np.sin(t / 9000),
    }
    kinds = {
        "run": _kind("run"),
        "t": _kind("time", unit="s"),
        "load": _kind("load", unit="kg"),
        "tool": _kind("overhang", unit="mm"),
    }
    kinds["T_bed"] = _kind("temperature", unit="degC", location="bed")
    kinds |= {n: _kind("position", axis=n.upper(), unit="mm") for n in place}
    for name, gap in (("E_X", 20e-3 * place["y"]), ("E_Y", -1e-7 * (600 - place["x"]) ** 3)):
        known = 12e-3 * place["x"] + 2 * (columns["T_bed"] - 20)
        columns[name] = 1.1 * known + gap + 0.6 * rng.standard_normal(ROWS)
        columns[f"{name}_sim"] = known
        kinds[name] = _kind("error", component=name, unit="um")
        kinds[f"{name}_sim"] = _kind("simulated", component=name, unit="um")
    axes = {a: _kind("axis", kind="linear", travel=(0, s), unit="mm") for a, s in (("X", 600), ("Y", 400), ("Z", 300))}
    return recording(columns, kinds, axes)


def log(rows: int = 200_000, hidden=None, seed: int = 0):
    """A 1 kHz log of an axis that goes to and fro ever differently; the simulation holds lead and warmth."""
    rng = np.random.default_rng(seed)
    t = np.arange(rows) * STEP
    x = 150 - 120 * np.cos(2 * np.pi * t / 7.3) * (0.6 + 0.4 * np.cos(2 * np.pi * t / 61.0))
    v = np.gradient(x, STEP)
    warm = 20 + 4 * (1 - np.exp(-t / (300 * STEP * rows / 1000)))
    sensors = {f"T_{k}": warm + np.sin(t / (50 + 30 * k)) + 0.02 * rng.standard_normal(rows) for k in range(3)}
    force = 40 * np.sign(v) + 0.2 * v + 5 * rng.standard_normal(rows)
    columns = {"run": np.full(rows, "1"), "t": t, "x": x, "v": v, "a": np.gradient(v, STEP), **sensors, "F": force}
    columns["rpm"] = np.where((np.arange(rows) * 6 // rows) % 2 == 0, 0.0, 6000.0)
    sim = 0.02 * (x - 150) + 2.0 * (sensors["T_0"] - 20)
    noise = np.convolve(rng.standard_normal(rows), 0.4 * 0.6 ** np.arange(20), mode="same")
    columns |= {"EXX": sim + noise + (hidden({**columns, "d": np.sign(v)}) if hidden else 0.0), "EXX_sim": sim}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "command", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
        **{n: {"role": "temperature", "unit": "degC"} for n in sensors},
        "F": {"role": "force", "unit": "N"},
        "rpm": {"role": "spindle_speed", "unit": "rpm"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
        "EXX_sim": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    return recording(columns, kinds)


class Shape(NamedTuple):
    """A recording, and what its diagnosis must name and may use."""

    make: Callable[[], Recording]
    names: set[str]
    megabytes: float
    """Most memory: the README promises 1.5 GB for 20 000 rows, 2 GB for a million."""
    seconds: float
    """Aim of the bench, not of a test."""


SHAPES = {
    "one run": Shape(lambda: linear_axis(1, 5.0, ("EXX",)), {"backlash"}, 1000, 8),
    "16 sessions": Shape(lambda: linear_axis(16, 5.0, ("EXX",)), {"backlash"}, 1000, 8),
    "16 sessions of a fast trace": Shape(lambda: linear_axis(16, 0.02, ("EXX",)), {"backlash"}, 1000, 8),
    "3 responses": Shape(lambda: linear_axis(16, 0.02, THREE, sensors=2), {"backlash"}, 1500, 8),
    "3 responses of a fast trace": Shape(lambda: linear_axis(16, 0.02, THREE), {"backlash"}, 1500, 8),
    "a volume, 2 responses": Shape(grid, {"squareness"}, 1000, 8),
    "a million rows at 1 kHz": Shape(
        lambda: log(1_000_000, lambda c: 0.6 * np.sin(2 * np.pi * c["x"] / 0.9) - 0.03 * c["v"]),
        {"pitch_cyclic", "following_error"},
        2000,
        60,
    ),
}


def measured(shape: str) -> dict[str, Any]:
    """Seconds, CPU seconds and peak memory (MB) of a fresh process that diagnoses this shape, and what it named."""
    output = subprocess.run(
        [sys.executable, "-m", "tests.unit.diagnosis.long", shape],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    return json.loads(output.stdout)


def main(shape: str) -> None:
    """Diagnose and tell, in this process."""
    from errpipe.diagnosis import diagnose

    made = SHAPES[shape].make()
    start, cpu = perf_counter(), process_time()
    diagnosis, _ = diagnose(made)
    took = {"seconds": round(perf_counter() - start, 2), "cpu_seconds": round(process_time() - cpu, 2)}
    peak = peak_kb() / 1024
    output = {f.effect: [p.value for p in f.parameters if p.name == "period"] for f in diagnosis.responses[0].findings}
    rows, columns = made.frame.shape
    print(json.dumps({**took, "peak_mb": round(peak), "rows": rows, "columns": columns, "periods_by_name": output}))


if __name__ == "__main__":
    main(sys.argv[1])
