"""Recordings of 20 000 rows in several shapes, and what it takes to diagnose one: time and memory of a fresh process.

python -m tests.unit.diagnosis.long SHAPE        one line of JSON
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from tests.peak_memory import peak_kb

from .machines import recording

ROWS = 20_000
WHERE = ("bed", "ball-screw nut", "air beside the beam", "room", "motor", "column")
AXIS = {"role": "axis", "kind": "linear", "travel": (0, 600), "screw_lead": 10.0, "drive_end": 0.0, "unit": "mm"}


def _kind(role: str, **more: Any) -> dict[str, Any]:
    return {"role": role, **more}


def _sensors(t: np.ndarray) -> tuple[dict, dict]:
    """Six temperatures that rise and swing, each in its own time."""
    columns = {
        f"T_{k}": 20 + (1 + k) * (np.sin(t / (3500 + 1500 * k) + k) + 1 - np.exp(-t / 9000)) for k in range(len(WHERE))
    }
    return columns, {n: _kind("temperature", unit="degC", location=w) for n, w in zip(columns, WHERE, strict=True)}


def linear_axis(runs: int, step: float, responses: tuple[str, ...]) -> Recording:
    """An axis back and forth in `runs` sessions, a row every `step` seconds; backlash is left out of EXX."""
    rng = np.random.default_rng(0)
    i = np.arange(ROWS)
    run = i * runs // ROWS
    t = i * step + run * 20000.0
    x = 300 + 250 * np.sin(i * 0.026) + 30 * np.sin(i * 0.062)
    side = np.sign(np.gradient(x))
    sensors, kinds = _sensors(t)
    columns = {"run": [str(r + 1) for r in run], "t": t, "x": x, "dir": side, **sensors}
    kinds |= {"run": _kind("run"), "t": _kind("time", unit="s"), "dir": _kind("direction", axis="X")}
    kinds["x"] = _kind("position", axis="X", unit="mm")
    for name in responses:
        lead, drift = 15e-3 * x, 2.5 * (sensors["T_0"] - 20)
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


SHAPES = {  # what it is -> (the recording, the effect that its first response lacks)
    "one run": (lambda: linear_axis(1, 5.0, ("EXX",)), "backlash"),
    "16 sessions": (lambda: linear_axis(16, 5.0, ("EXX",)), "backlash"),
    "16 sessions of a fast trace": (lambda: linear_axis(16, 0.02, ("EXX",)), "backlash"),
    "3 responses of a fast trace": (lambda: linear_axis(16, 0.02, ("EXX", "EYX", "EZX")), "backlash"),
    "a volume, 2 responses": (grid, "squareness"),
}


def measured(shape: str) -> dict[str, Any]:
    """Seconds, CPU seconds and peak memory (MB) of a fresh process that diagnoses this shape, and what it named."""
    told = subprocess.run(
        [sys.executable, "-m", "tests.unit.diagnosis.long", shape],
        check=True,
        capture_output=True,
        text=True,
        cwd=Path(__file__).parents[3],
    )
    return json.loads(told.stdout)


def main(shape: str) -> None:
    """Diagnose and tell, in this process."""
    from errpipe.diagnosis import diagnose

    made = SHAPES[shape][0]()
    start, cpu = perf_counter(), process_time()
    found, _ = diagnose(made)
    took = {"seconds": round(perf_counter() - start, 2), "cpu_seconds": round(process_time() - cpu, 2)}
    peak = peak_kb() / 1024
    first = [r.findings[0].effect if r.findings else "" for r in found.responses]
    print(json.dumps({**took, "peak_mb": round(peak), "columns": len(made.frame.columns), "named": first}))


if __name__ == "__main__":
    main(sys.argv[1])
