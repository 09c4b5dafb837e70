"""A small recording with all that terms need: an axis at several temperatures, both directions, two sensors."""

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording


def axis_recording(letter: str = "X", *, runs: int = 8, targets: int = 30, same_warmth: bool = False, seed: int = 0):
    rng = np.random.default_rng(seed)
    frames = []
    for k in range(runs):
        warm = 24.0 if same_warmth else 20.0 + 8.0 * rng.random()
        other = 24.0 if same_warmth else 20.0 + 8.0 * rng.random()
        x = np.r_[np.linspace(0, 500, targets), np.linspace(500, 0, targets)] + rng.uniform(-3, 3, 2 * targets)
        t = 20000.0 * k + 6.0 * np.arange(x.size)
        frames.append(
            pd.DataFrame(
                {
                    "run": f"r{k}",
                    "t": t,
                    "x": x,
                    "dir": np.repeat([1.0, -1.0], targets),
                    "T_nut": warm + (0.0 if same_warmth else 1.0) * np.linspace(0, 1, x.size),
                    "T_bed": np.full(x.size, other),
                    "E": 0.0,
                }
            )
        )
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis=letter, unit="mm"),
        "dir": Column(role="direction", axis=letter),
        "T_nut": Column(role="temperature", unit="degC", location="ball-screw nut"),
        "T_bed": Column(role="temperature", unit="degC", location="bed"),
        "E": Column(role="error", component=f"E{letter}{letter}", unit="um"),
    }
    constants = {letter: Constant(role="axis", kind="linear", travel=(0.0, 500.0), screw_lead=10.0, unit="mm")}
    manifest = Manifest(recording=1, tables=("r.csv",), constants=constants, columns=columns)
    return Recording(manifest, pd.concat(frames, ignore_index=True))


def with_response(recording: Recording, values: np.ndarray, noise: float = 0.0, seed: int = 0) -> Recording:
    drawn = np.random.default_rng(seed).normal(0.0, noise, len(recording)) if noise else 0.0
    return Recording(recording.manifest, recording.frame.assign(E=values + drawn))
