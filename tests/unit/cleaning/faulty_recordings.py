"""Recordings with known faults for the tests of the cleaning rules."""

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording

KINDS = {
    "run": Column(role="run"),
    "t": Column(role="time", unit="s"),
    "x": Column(role="position", axis="X", unit="mm"),
    "v": Column(role="velocity", axis="X", unit="mm/s"),
    "E_Z": Column(role="error", component="E_Z", unit="um"),
    "E_Z_sim": Column(role="simulated", component="E_Z", unit="um"),
    "p": Column(role="pressure", unit="hPa"),
    "rh": Column(role="humidity", unit="%"),
}


def recording(constants=None, **columns):
    """A recording of the given columns; names starting with T are temperatures."""
    kinds = {n: KINDS.get(n) or Column(role="temperature", unit="degC") for n in columns}
    frame = pd.DataFrame({n: np.asarray(v) for n, v in columns.items()})
    manifest = Manifest(recording=1, tables=("t.csv",), columns=kinds, constants=constants or {})
    return Recording(manifest, frame)


def warm_up(seed=0, rows=600, runs=2, noise=0.05, step=0.0):
    """Two cold starts of a machine with four sensors that follow two heat sources, dt = 60 s; and a response."""
    rng = np.random.default_rng(seed)
    parts = []
    for run in range(runs):
        t = 60.0 * np.arange(rows)
        load = np.repeat(rng.uniform(0, 1, rows // 50 + 1), 50)[:rows]
        hot = np.zeros(rows)
        for i in range(1, rows):
            hot[i] = hot[i - 1] + (12 * load[i] - hot[i - 1]) * 60 / 1800
        slow = np.zeros(rows)
        for i in range(1, rows):
            slow[i] = slow[i - 1] + (hot[i] - slow[i - 1]) * 60 / 3600
        room = 20 + 1.5 * np.sin(2 * np.pi * t / 86400 + run)
        sensors = {
            "T_bearing": room + hot,
            "T_motor": room + 0.7 * hot + 0.2 * slow,
            "T_column": room + 0.4 * slow,
            "T_room": room,
        }
        sensors = {n: v + noise * rng.standard_normal(rows) for n, v in sensors.items()}
        if step:
            sensors = {n: np.round(v / step) * step for n, v in sensors.items()}
        error = 3 * slow + 0.5 * rng.standard_normal(rows)
        parts.append({"run": np.full(rows, str(run + 1), dtype=object), "t": t, **sensors, "E_Z": error})
    return recording(**{n: np.concatenate([p[n] for p in parts]) for n in parts[0]})


def changed(source, **columns):
    """The recording with some columns replaced."""
    return Recording(source.manifest, source.frame.assign(**columns))


def touched(report, rule, column=None):
    """Row numbers that a rule touched."""
    done = [d for r in report.rules if r.rule == rule for d in r.done if column in (None, d.column)]
    return sorted(row for d in done for start, end in d.rows for row in range(start, end))


def noise(rows, seed=0):
    return 0.1 * np.random.default_rng(seed).standard_normal(rows)
