"""A small recording with every role in it, and worked cases of terms bound to it."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.terms._base import Example, Term

ROWS = 480  # of an example recording
COMPONENTS = {"EXX": "um", "EYX": "um", "E_X": "um", "E_R": "um", "F_X": "N"}


def rows(step: float = 15.0) -> Recording:
    """A milling machine that circles in X and Y, warms up, cuts and carries; deviations of zero. step: s per row.

    Every column varies and no two are equal, so that a term that reads the wrong one fails.
    """
    k = np.arange(ROWS)
    t = step * k
    x, y = 200.0 + 200.0 * np.sin(2 * np.pi * k / 97), 150.0 * np.cos(2 * np.pi * k / 97 + 0.3)
    vx, vy = np.gradient(x, t), np.gradient(y, t)
    motion = {
        "x": (x, Column(role="position", axis="X", unit="mm")),
        "y": (y, Column(role="position", axis="Y", unit="mm")),
        "z": (100.0 + 80.0 * np.sin(k / 31), Column(role="position", axis="Z", unit="mm")),
        "vx": (vx, Column(role="velocity", axis="X", unit="mm/s")),
        "vy": (vy, Column(role="velocity", axis="Y", unit="mm/s")),
        "ax": (np.gradient(vx, t), Column(role="acceleration", axis="X", unit="mm/s2")),
        "ay": (np.gradient(vy, t), Column(role="acceleration", axis="Y", unit="mm/s2")),
        "dx": (np.where(vx >= 0, 1.0, -1.0), Column(role="direction", axis="X")),
        "dy": (np.where(vy >= 0, 1.0, -1.0), Column(role="direction", axis="Y")),
        "feed": (1000.0 + 500.0 * np.sin(k / 40), Column(role="feed", axis="X", unit="mm/min")),
    }
    state = {
        "speed": (np.where(k % 160 < 80, 6000.0, 1500.0), Column(role="spindle_speed", unit="rpm")),
        "T_nut": (20.0 + 5.0 * (1 - np.exp(-k / 90)), Column(role="temperature", unit="degC", location="nut")),
        "T_head": (20.0 + np.sqrt(k / 60), Column(role="temperature", unit="degC", location="head")),
        "T_air": (20.5 + 2.0 * np.sin(k / 70), Column(role="temperature", unit="degC", location="air")),
        "p": (1000.0 + 10.0 * np.sin(k / 110), Column(role="pressure", unit="hPa")),
        "h": (50.0 + 10.0 * np.cos(k / 90), Column(role="humidity", unit="%")),
        "coolant": ((k % 120 < 60).astype(float), Column(role="coolant")),
        "force": (100.0 * np.sin(k / 17), Column(role="force", axis="X", unit="N")),
        "load": (np.where(k % 200 < 100, 50.0, 200.0), Column(role="load", unit="kg")),
        "depth": (1.0 + 0.5 * np.sin(k / 23), Column(role="depth_of_cut", unit="mm")),
        "overhang": (100.0 + 30.0 * np.cos(k / 29), Column(role="overhang", unit="mm")),
        "cut": (0.5 * k, Column(role="cut_length", unit="m")),
    }
    responses = {name: (0.0 * k, Column(role="error", component=name, unit=u)) for name, u in COMPONENTS.items()}
    responses["EXX_sim"] = (0.02 * x, Column(role="simulated", component="EXX", unit="um"))
    responses["F_X_sim"] = (2000.0 * np.sin(k / 17), Column(role="simulated", component="F_X", unit="N"))
    all_of_them = {**motion, **state, **responses}
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    axis = {"role": "axis", "kind": "linear", "screw_lead": 10.0, "encoder_period": 0.02, "unit": "mm"}
    manifest = Manifest(
        recording=1,
        tables=("rows.csv",),
        constants={"X": Constant(travel=(0.0, 400.0), **axis), "Y": Constant(travel=(-150.0, 150.0), **axis)},
        columns=columns | {name: column for name, (_, column) in all_of_them.items()},
    )
    run = np.repeat(["first", "second"], ROWS // 2)
    values = {name: value for name, (value, _) in all_of_them.items()}
    return Recording(manifest, pd.DataFrame({"run": run, "t": t, **values}))


def example_of(kind: type[Term]) -> Example:
    """The worked case that generic tests and the reference derive the rest from."""
    sampled = None if kind.sample is None else typical_example(kind(**kind.sample))
    return kind.example() or sampled or first_binding(kind)


def first_binding(kind: type[Term], recording: Recording | None = None) -> Example:
    """The first sensible binding of a term to these rows. Raises LookupError if there is none."""
    recording = recording or rows()
    for component in COMPONENTS:
        for term in kind.bind(recording, component):
            return typical_example(term, recording)
    raise LookupError(f"{kind.__name__} binds to nothing in the example's rows")


def typical_example(term: Term, recording: Recording | None = None) -> Example:
    """A term on these rows with sizes that machines have: the middle of each parameter's typical range."""
    recording = recording or rows()
    term = term.settled(recording)
    parameters = {}
    for p in (*term.linear(), *term.nonlinear()):
        low, high = p.typical
        middle = float(np.sqrt(low * high) if low > 0 else (low + high) / 2)
        parameters[p.name] = term.fixed.get(p.name, middle)
    return Example(term, recording, parameters)
