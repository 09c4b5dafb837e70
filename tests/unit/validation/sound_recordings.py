"""Axis tests that are declared rightly, of random layout: what a plausibility check must let through.

Travel, targets, runs, directions, the order of the rows, noise, drift and the size and shape of every error are drawn;
errors are as small against the noise, and as rough, as on machines that are good, short, long or badly measured.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording


def sound_recording(seed: int) -> Recording:
    """A linear axis measured at targets in sweeps, with deviation = actual - commanded in um."""
    rng = np.random.default_rng(seed)
    travel = float(np.exp(rng.uniform(np.log(20.0), np.log(6000.0))))
    count, runs = int(rng.integers(5, 45)), int(rng.integers(1, 8))
    low = float(rng.choice([0.0, -travel / 2, -travel, 25.0]))
    targets = low + travel * np.linspace(0.0, 1.0, count)
    if rng.random() < 0.4:
        targets = np.sort(
            targets + rng.uniform(-0.3, 0.3, count) * travel / count
        )  # ISO 230-2: no multiples of a pitch
    sides = [1.0, -1.0] if rng.random() < 0.8 else [1.0]
    pilgrim = rng.random() < 0.2  # both directions at one target, then on to the next
    frame = pd.DataFrame(_visits(runs, sides, targets, pilgrim), columns=["run", "dir", "x"])
    frame["t"] = rng.uniform(3.0, 30.0) * np.arange(len(frame))
    frame["EXX"] = _deviation(rng, frame, low, travel)
    if rng.random() < 0.3:
        frame = frame.sort_values(["run", "dir", "x"], ascending=[True, False, True], kind="stable")
        frame = frame.drop(columns="t").reset_index(drop=True)  # a table in the order of its targets has no clock
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="command", axis="X", unit="mm"),
        "dir": Column(role="direction", axis="X"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    columns = {name: column for name, column in columns.items() if name in frame}
    span = (low, low + travel)
    constants = {"X": Constant(role="axis", kind="linear", travel=span, unit="mm")} if rng.random() < 0.5 else {}
    return Recording(Manifest(recording=1, tables=("t.csv",), constants=constants, columns=columns), frame)


def _visits(runs: int, sides: list[float], targets: np.ndarray, pilgrim: bool) -> list[tuple[str, float, float]]:
    visits = []
    for run in range(runs):
        if pilgrim:
            order = [(side, x) for x in targets for side in sides]
        else:
            order = [(side, x) for side in sides for x in targets[:: int(side)]]
        visits += [(f"run-{run + 1}", side, float(x)) for side, x in order]
    return visits


def _deviation(rng: np.random.Generator, frame: pd.DataFrame, low: float, travel: float) -> np.ndarray:
    """Lead, smooth shape, pitch-periodic part, lost motion (constant and along the axis), drift and noise, um."""
    u = (frame.x.to_numpy() - low) / travel
    size = max(float(np.exp(rng.uniform(np.log(0.5), np.log(40.0)))), 3e-4 * travel)  # no axis is better than 0.3 ppm
    clock = frame.t.to_numpy() / max(frame.t.max(), 1e-9)
    lead = size * rng.normal() * u
    waves = rng.normal(size=6) / np.arange(1, 7) ** rng.uniform(0.0, 2.0)
    smooth = size * sum(a * np.sin(np.pi * k * u + rng.uniform(0, 6)) for k, a in enumerate(waves, start=1))
    cyclic = 0.3 * size * rng.random() * np.sin(2 * np.pi * frame.x.to_numpy() / rng.choice([5.0, 10.0, 20.0]))
    lost = size * rng.exponential(0.3) * (1 + rng.uniform(-1, 1) * np.sin(np.pi * u * rng.uniform(0.5, 3)))
    drift = size * rng.normal() * rng.choice([0.0, 0.3, 1.0]) * (1 - np.exp(-clock * rng.uniform(0.5, 6)))
    spread = size * float(np.exp(rng.uniform(np.log(0.003), np.log(0.6)))) + 2e-5 * travel  # um; air: 0.02 ppm
    noise = spread * rng.normal(size=len(frame))
    value = lead + smooth + cyclic - 0.5 * lost * frame.dir.to_numpy() + drift + noise
    resolution = rng.choice([0.0, 0.01, 0.1, 1.0 if size > 10 else 0.1])
    return np.round(value / resolution) * resolution if resolution else value
