"""Small recordings with a known cause, made from formulas: an axis, a spindle, a trace."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd

from errpipe.domain.recording import Manifest, Recording


def recording(columns: dict, kinds: dict, constants: dict | None = None) -> Recording:
    manifest = Manifest.model_validate(
        {"recording": 1, "title": "test", "tables": ["recording.csv"], "constants": constants or {}, "columns": kinds}
    )
    return Recording(manifest, pd.DataFrame(columns))


def axis(seed: int = 0, runs: int = 6, hidden=None, gains=(1.0, 1.0), noise: float = 0.5) -> Recording:
    """Bidirectional positioning; the simulation holds a lead error and a drift of the bed."""
    rng = np.random.default_rng(seed)
    goal = np.sort(rng.uniform(5, 595, 22))
    x = np.tile(np.r_[goal, goal[::-1]], 2 * runs)
    side = np.tile(np.repeat([1.0, -1.0], goal.size), 2 * runs)
    n = x.size
    run = np.repeat(np.arange(runs), n // runs)
    t = np.arange(n) * 5.0 + run * 900.0
    bed = 20 + 3 * (1 - np.exp(-t / 9000)) + 0.5 * np.sin(t / 4000)
    nut = bed + 4 * np.abs(np.sin(t / 3500))
    air = 21 + np.cos(t / 6000)
    lead, drift = 15e-3 * x, 2.5 * (bed - 20)
    sim = lead + drift
    columns = {"x": x, "dir": side, "T_bed": bed, "T_nut": nut, "T_air": air, "t": t}
    extra = hidden(columns) if hidden else 0.0
    error = gains[0] * lead + gains[1] * drift + extra + noise * rng.standard_normal(n)
    columns = {"run": [str(r + 1) for r in run], **columns, "EXX": np.round(error, 2), "EXX_sim": np.round(sim, 3)}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "dir": {"role": "direction", "axis": "X"},
        "T_bed": {"role": "temperature", "unit": "degC", "location": "bed"},
        "T_nut": {"role": "temperature", "unit": "degC", "location": "ball-screw nut"},
        "T_air": {"role": "temperature", "unit": "degC", "location": "air beside the beam"},
        "EXX": {"role": "error", "component": "EXX", "unit": "um"},
        "EXX_sim": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    constants = {
        "X": {
            "role": "axis",
            "kind": "linear",
            "travel": (0, 600),
            "screw_lead": 10.0,
            "drive_end": 0.0,
            "encoder_period": 0.02,
            "unit": "mm",
        }
    }
    return recording(columns, kinds, constants)


def spindle(seed: int = 0, hidden=None, gain: float = 1.0, noise: float = 0.3) -> Recording:
    """A spindle at changing speed; the simulation holds a drift of the bed."""
    rng = np.random.default_rng(seed)
    n = 600
    t = np.arange(n) * 60.0
    speed = np.repeat(rng.choice([0.0, 4000.0, 8000.0, 12000.0], n // 30), 30)
    bed = 20 + 1.5 * np.sin(t / 9000)
    room = 20 + 2 * np.sin(t / 14000 + 1)
    sim = 3.0 * (bed - 20)
    columns = {"t": t, "rpm": speed, "T_bed": bed, "T_room": room}
    extra = hidden(columns) if hidden else 0.0
    columns |= {"E_Z": gain * sim + extra + noise * rng.standard_normal(n), "E_Z_sim": sim}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "rpm": {"role": "spindle_speed", "unit": "rpm"},
        "T_bed": {"role": "temperature", "unit": "degC", "location": "bed"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room"},
        "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
        "E_Z_sim": {"role": "simulated", "component": "E_Z", "unit": "um"},
    }
    return recording(columns, kinds)


def trace(seed: int = 0, hidden=None, noise: float = 2.0) -> Recording:
    """The drive force of an axis under way; the simulation holds the moving mass."""
    rng = np.random.default_rng(seed)
    t = np.arange(4000) * 0.005
    x = 200 + 120 * np.sin(1.3 * t) + 30 * np.sin(3.1 * t)
    v = 156 * np.cos(1.3 * t) + 93 * np.cos(3.1 * t)
    a = -202.8 * np.sin(1.3 * t) - 288.3 * np.sin(3.1 * t)
    sim = 0.08 * a
    columns = {"t": t, "x": x, "v": v + 0.05 * rng.standard_normal(t.size), "a": a + 5 * rng.standard_normal(t.size)}
    extra = hidden({"x": x, "v": v}) if hidden else 0.0
    columns |= {"F_X": sim + extra + noise * rng.standard_normal(t.size), "F_X_sim": sim}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "v": {"role": "velocity", "axis": "X", "unit": "mm/s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
        "F_X": {"role": "error", "component": "F_X", "unit": "N"},
        "F_X_sim": {"role": "simulated", "component": "F_X", "unit": "N"},
    }
    return recording(columns, kinds)


def mornings(seed: int = 0, hidden=None, days: int = 10, noise: float = 0.3, pause: float = 57600.0) -> Recording:
    """A machine started on several days from cold; the simulation is a static model of two temperatures.

    hidden(columns) is what it lacks; columns holds `day` besides what is recorded. pause: seconds between days.
    """
    rng = np.random.default_rng(seed)
    rows = 110
    clock = np.arange(rows) * 150.0
    day = np.repeat(np.arange(days), rows)
    t = np.tile(clock, days) + day * (clock[-1] + pause)
    morning = np.repeat(rng.uniform(17, 23, days), rows)
    room = morning + np.tile(2 * (1 - np.exp(-clock / 9000)), days)
    works = np.tile(np.where((clock > 1500) & ((clock < 7000) | (clock > 9500)), 1.0, 0.0), days)
    works *= np.repeat(rng.uniform(0.6, 1.4, days), rows)
    bearing, warm = np.empty(t.size), 0.0
    for k in range(t.size):
        warm = 0.0 if k % rows == 0 else warm + 150.0 / 1800.0 * (9 * works[k] - warm)
        bearing[k] = room[k] + warm
    sim = 1.5 * (room - 20) + 2.0 * (bearing - 20)
    columns = {"t": t, "T_room": room, "T_bearing": bearing}
    extra = hidden({**columns, "day": day}) if hidden else 0.0
    columns = {"run": [f"d{d}" for d in day], **columns}
    columns |= {"E_Z": sim + extra + noise * rng.standard_normal(t.size), "E_Z_sim": sim}
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room"},
        "T_bearing": {"role": "temperature", "unit": "degC", "location": "spindle bearing"},
        "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
        "E_Z_sim": {"role": "simulated", "component": "E_Z", "unit": "um"},
    }
    return recording(columns, kinds)


def bare(made: Recording) -> Recording:
    """A recording without its columns of speed and acceleration."""
    kinds = {n: c for n, c in made.manifest.columns.items() if n not in ("v", "a")}
    return replace(made, manifest=made.manifest.model_copy(update={"columns": kinds}), frame=made.frame[list(kinds)])
