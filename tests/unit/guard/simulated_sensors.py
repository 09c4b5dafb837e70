"""A machine whose six sensors are related by heat conduction, and the five ways in which a sensor fails."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording

STEP = 60.0  # s between rows
NAMES = ("T_bearing", "T_motor", "T_housing", "T_column", "T_bed", "T_room")
# Heat capacity over conductance, s; what each body takes from bearing heat, motor heat and its neighbours.
WAYS = ("dead", "stuck", "drift", "step", "swap")


def machine(runs: int, seed: int, hours: float = 8.0, noise: float = 0.05, display: float = 0.01) -> Recording:
    """Cold starts of a machine under changing spindle load, in a room that warms up over the day."""
    rng = np.random.default_rng(seed)
    rows = int(hours * 3600 / STEP)
    steps = rows // 20 + 1
    load = np.repeat(rng.uniform(0, 1, (runs, steps)) * (rng.random((runs, steps)) > 0.25), 20, axis=1)[:, :rows]
    drive = np.repeat(rng.uniform(0, 1, (runs, steps)), 20, axis=1)[:, :rows]
    t = STEP * np.arange(rows)
    room = rng.uniform(18, 26, (runs, 1)) + rng.uniform(0, 4, (runs, 1)) * np.sin(np.pi * t / 43200)
    bearing = _lag(14 * load**1.3 + 1.0 * drive, 1500)
    motor = _lag(6 * load + 5 * drive, 2400)
    housing = _lag(0.6 * bearing + 0.35 * motor, 1200)
    column = _lag(0.5 * housing, 5400)
    bed = _lag(0.3 * motor + 0.2 * column, 7200)
    slow_room = _lag(room, 3600, start=True)
    x = np.stack([bearing + room, motor + room, housing + room, column + slow_room, bed + slow_room, room])
    x = np.round((x + noise * rng.standard_normal(x.shape)) / display) * display
    return recording(x.reshape(len(NAMES), -1).T, np.repeat(np.arange(runs), rows), np.tile(t, runs))


def recording(x: np.ndarray, run: np.ndarray, t: np.ndarray) -> Recording:
    """Readings (rows, sensors) as a recording."""
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    columns |= {n: Column(role="temperature", unit="degC") for n in NAMES}
    frame = pd.DataFrame({"run": run.astype(str), "t": t, **{n: x[:, i] for i, n in enumerate(NAMES)}})
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=columns), frame)


def failed(healthy: Recording, way: str, sensor: int, start: float, drift: float, step: float) -> Recording:
    """The recording with one sensor failing from `start` s on in every run: drift in K/h, step in K."""
    x = np.column_stack([healthy.array(n) for n in NAMES])
    run, t = healthy.run_codes(), healthy.time()
    out, late = x.copy(), t >= start
    other = (sensor + 1) % len(NAMES)
    if way == "dead":
        out[late, sensor] = 0.0
    elif way == "stuck":
        for r in np.unique(run):
            rows = np.flatnonzero(late & (run == r))
            out[rows, sensor] = x[rows[0], sensor]
    elif way == "drift":
        out[late, sensor] += drift * (t[late] - start) / 3600
    elif way == "step":
        out[late, sensor] += step
    elif way == "swap":
        out[late, sensor], out[late, other] = x[late, other], x[late, sensor]
    return recording(out, run, t)


def _lag(u: np.ndarray, tau: float, start: bool = False) -> np.ndarray:
    y = np.zeros_like(u)
    if start:
        y[:, 0] = u[:, 0]
    for i in range(1, u.shape[1]):
        y[:, i] = u[:, i - 1] + (y[:, i - 1] - u[:, i - 1]) * np.exp(-STEP / tau)
    return y
