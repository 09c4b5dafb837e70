"""Small simulated recordings for the templates of `errpipe init`. Equal bytes every time."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Derived, Recording
from errpipe.simulation.folder import of_one_table

SIMULATED = "simulated by errpipe; replace it with your own"


def _recording(title: str, columns: dict[str, Column], frame: pd.DataFrame, **constants: Constant) -> Recording:
    return of_one_table(title, SIMULATED, columns, frame, constants)


def _axis(travel: tuple[float, float]) -> Constant:
    return Constant(role="axis", kind="linear", travel=travel, unit="mm")


def _bidirectional(travel: float, targets: int, runs: int) -> pd.DataFrame:
    """Run, side and target of a test in both directions, in the order of measuring."""
    up = np.linspace(0.0, travel, targets)
    rows = [
        (str(run), side, x)
        for run in range(1, runs + 1)
        for side, order in ((1.0, up), (-1.0, up[::-1]))
        for x in order
    ]
    return pd.DataFrame(rows, columns=["run", "dir", "x"])


def laser(seed: int = 1) -> Recording:
    """Five runs after ISO 230-2 with a laser: 26 targets over 500 mm, both directions, deviations in um."""
    rng = np.random.default_rng(seed)
    f = _bidirectional(500.0, 26, 5)
    f["EXX"] = 18e-3 * f.x + 3.5 * np.sin(f.x / 60) + 1.2 * np.sin(f.x / 23 + 1) - 2.2 * f["dir"]
    f["EXX"] = np.round(f.EXX + 0.4 * rng.normal(size=len(f)), 2)
    columns = {
        "run": Column(role="run"),
        "dir": Column(role="direction", axis="X"),
        "x": Column(role="position", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    return _recording("X axis, laser, ISO 230-2", columns, f, X=_axis((0.0, 500.0)))


def dial_gauge(seed: int = 2) -> Recording:
    """A hobby machine with a dial gauge of 0.01 mm: commanded and actual positions, error derived from them."""
    rng = np.random.default_rng(seed)
    f = _bidirectional(250.0, 11, 4)
    deviation = 0.22e-3 * f.x + 0.012 * np.sin(f.x / 40) - 0.018 * f["dir"] + 0.002 * rng.normal(size=len(f))
    f = pd.DataFrame({"run": f.run, "dir": f["dir"], "commanded": f.x, "reading": np.round(f.x + deviation, 2)})
    columns = {
        "run": Column(role="run"),
        "dir": Column(role="direction", axis="X"),
        "commanded": Column(role="command", axis="X", unit="mm"),
        "reading": Column(role="position", axis="X", unit="mm"),
        "EXX": Column(role="error", component="EXX", unit="um", derived=Derived(minus=("reading", "commanded"))),
    }
    return _recording("X axis, dial gauge", columns, f, X=_axis((0.0, 250.0)))


def axis_log(seed: int = 3) -> Recording:
    """Eight seconds of an axis at 250 Hz: it lags behind its command, and dry friction makes it stick at reversals."""
    rng = np.random.default_rng(seed)
    t = np.arange(2000) * 0.004
    x = 150.0 + 80.0 * np.sin(1.3 * t) + 15.0 * np.sin(4.1 * t)
    v, a = np.gradient(x, t), np.gradient(np.gradient(x, t), t)
    deviation = -0.0012 * v - 0.003 * np.sign(v) + 0.0004 * rng.normal(size=t.size)
    current = 0.004 * v + 0.45 * np.sign(v) + 0.0006 * a + 0.01 * rng.normal(size=t.size)
    frame = pd.DataFrame(
        {
            "t": np.round(t, 4),
            "x_cmd": np.round(x, 5),
            "x_act": np.round(x + deviation, 5),
            "v": np.round(v, 4),
            "a": np.round(a, 3),
            "current": np.round(current, 3),
            "T_motor": np.round(31.0 + 0.02 * t, 2),
        }
    )
    columns = {
        "t": Column(role="time", unit="s"),
        "x_cmd": Column(role="command", axis="X", unit="mm"),
        "x_act": Column(role="position", axis="X", unit="mm"),
        "v": Column(role="velocity", axis="X", unit="mm/s"),
        "a": Column(role="acceleration", axis="X", unit="mm/s2"),
        "current": Column(role="current", axis="X", unit="A"),
        "T_motor": Column(role="temperature", unit="degC", location="motor"),
        "EXX": Column(role="error", component="EXX", unit="um", derived=Derived(minus=("x_act", "x_cmd"))),
        "EXX_sim": Column(role="simulated", component="EXX", unit="um", derived=Derived(constant=0.0)),
    }
    return _recording("X axis, log of the control", columns, frame, X=_axis((0.0, 300.0)))


# Bed and room at the start of each run, degC. A gain is validated over runs: three of them are too few.
WARM_UPS = ((60.0, 21.0), (90.0, 24.0), (105.0, 22.0), (75.0, 19.0), (100.0, 26.0))


def gantry(seed: int = 4) -> Recording:
    """Five warm-ups of a gantry with a heated bed: its Z reference drifts with frame and bed, 13 hours in all."""
    rng = np.random.default_rng(seed)
    parts = []
    for run, (bed, start) in enumerate(WARM_UPS, 1):
        t = np.arange(0.0, 9600.0, 60.0)
        bed_t = (
            start
            + (bed - start) * (1 - np.exp(-t / 400.0)) * (t < 7200)
            + (t >= 7200) * (bed - start) * np.exp(-np.maximum(t - 7200, 0) / 1500.0)
        )
        frame_t = np.empty(t.size)
        frame_t[0] = start
        for i in range(1, t.size):
            target = start + 0.16 * (bed_t[i - 1] - start)
            frame_t[i] = target + (frame_t[i - 1] - target) * np.exp(-60.0 / 2400.0)
        z = -9.5 * (frame_t - 22.0) + 0.55 * (bed_t - 22.0) + 1.5 * rng.normal(size=t.size)
        parts.append(
            pd.DataFrame(
                {
                    "run": f"warm-up-{run}",
                    "t": t + 20_000.0 * run,
                    "frame_t": np.round(frame_t + 0.02 * rng.normal(size=t.size), 2),
                    "bed_t": np.round(bed_t, 2),
                    "E_Z": np.round(z, 1),
                }
            )
        )
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "frame_t": Column(role="temperature", unit="degC", location="frame"),
        "bed_t": Column(role="temperature", unit="degC", location="heated bed"),
        "E_Z": Column(role="error", component="E_Z", unit="um"),
    }
    return _recording("Z reference of a gantry, warming up", columns, pd.concat(parts, ignore_index=True))


def drilled_plate(seed: int = 5) -> Recording:
    """Three plates of 9 by 7 holes drilled by one machine and measured on a CMM, each clamped separately."""
    rng = np.random.default_rng(seed)
    x, y = (g.ravel() for g in np.meshgrid(np.linspace(0, 400, 9), np.linspace(0, 300, 7)))
    parts = []
    for plate in range(1, 4):
        shift, turn = 5 * rng.normal(size=2), 20e-3 * rng.normal()
        ex = 22e-3 * x + 12e-3 * y + 5 * np.sin(x / 90) + shift[0] - turn * y + rng.normal(size=x.size)
        ey = -14e-3 * y + 4 * np.cos(y / 70) + 3e-5 * x**2 / 2 + shift[1] + turn * x + rng.normal(size=x.size)
        parts.append(
            pd.DataFrame({"plate": f"plate-{plate}", "x": x, "y": y, "E_X": np.round(ex, 1), "E_Y": np.round(ey, 1)})
        )
    columns = {
        "plate": Column(role="run"),
        "x": Column(role="position", axis="X", unit="mm"),
        "y": Column(role="position", axis="Y", unit="mm"),
        "E_X": Column(role="error", component="E_X", unit="um"),
        "E_Y": Column(role="error", component="E_Y", unit="um"),
    }
    return _recording("Holes drilled in three plates", columns, pd.concat(parts, ignore_index=True))
