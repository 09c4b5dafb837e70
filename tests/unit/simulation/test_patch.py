"""What rings and what comes late: the generated Python and the generated FMU against closed forms."""

from __future__ import annotations

import importlib.util
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import CubicSpline
from scipy.signal import TransferFunction, lsim

from errpipe.domain.recording import Manifest, Recording
from errpipe.drivers.simulated import DelayDifference, Ringing, between
from errpipe.simulation import external, patch, patch_fmu

STEP, HERTZ, DAMPING, DELAY = 0.002, 23.0, 0.05, 0.0331
W = 2 * np.pi * HERTZ
RINGS = patch.Piece("EXX_mode", "EXX", "um", "rings", (Ringing("a", HERTZ, DAMPING, -2.5),))
LATE = patch.Piece("EYX_late", "EYX", "um", "late", (DelayDifference(DELAY, axis="X", gain=0.9),))


def recording(runs: int = 1) -> Recording:
    """Two runs, the later of them a day after, of an axis that is pushed to and fro."""
    t = np.arange(1500) * STEP
    push = 800 * np.sign(np.sin(9 * t)) + 300 * np.sin(40 * t)
    x = 100 + 60 * np.sin(5 * t)
    every = {name: np.tile(v, runs) for name, v in {"a": push, "x": x}.items()}
    day = np.repeat(np.arange(runs), t.size)
    frame = pd.DataFrame({"run": day.astype(str), "t": np.tile(t, runs) + 86400.0 * day, **every})
    kinds = {
        "run": {"role": "run"},
        "t": {"role": "time", "unit": "s"},
        "a": {"role": "acceleration", "axis": "X", "unit": "mm/s2"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
    }
    for name in ("EXX", "EYX"):
        frame[name], kinds[name] = 0.0, {"role": "error", "component": name, "unit": "um"}
    facts = {"recording": 1, "title": "test", "tables": ["r.csv"], "columns": kinds}
    return Recording(Manifest.model_validate(facts), frame)


def closed_forms(made: Recording) -> dict[str, np.ndarray]:
    """Of one run: the second-order system by another library; the sine a delay earlier, its first value before that."""
    t, a = made.time(), made.array("a")
    start = [a[0] / W**2, 0.0]  # state of the transfer function below in equilibrium
    model = TransferFunction([W**2], [1, 2 * DAMPING * W, W**2]).to_ss()
    scale = float(np.asarray(model.C).ravel()[1])
    q = lsim(model, a, t, X0=[start[1], a[0] / scale])[1]
    earlier = 100 + 60 * np.sin(5 * np.maximum(t - DELAY, 0.0))
    return {"EXX": -2.5 * q, "EYX": 0.9e3 * (earlier - made.array("x"))}


def module(where: Path, made: Recording):
    (where / "patch.py").write_text(patch.python_module((RINGS, LATE), made, "test", {}))
    spec = importlib.util.spec_from_file_location("patch_of_test", where / "patch.py")
    outcome = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(outcome)
    return outcome


def test_python(tmp_path: Path) -> None:
    made = recording(runs=2)
    columns = {n: made.array(n) for n in ("a", "x")}
    day = np.repeat([0, 1], 1500)
    output = module(tmp_path, made).deviation(columns, made.time(), day)
    for piece, component in ((RINGS, "EXX"), (LATE, "EYX")):
        assert_allclose(output[component], patch.value(piece, made), rtol=1e-9, atol=1e-9)
        wanted = np.tile(closed_forms(recording())[component], 2)
        assert_allclose(output[component], wanted, atol=2e-3 * np.abs(wanted).max())


@pytest.mark.slow
@pytest.mark.toolchain
@pytest.mark.skipif(shutil.which("cc") is None or not importlib.util.find_spec("fmpy"), reason="needs cc and FMPy")
def test_fmu(tmp_path: Path) -> None:
    """Its output is a twentieth of a row behind its input."""
    made = recording()
    data, problem = patch_fmu.build((RINGS, LATE), made)
    assert problem == ""
    (tmp_path / "patch.fmu").write_bytes(data)
    both, twins, _ = external.with_twins(made, external.by_name(made, tmp_path / "patch.fmu"), tmp_path / "patch.fmu")
    for twin in twins:
        wanted = closed_forms(made)[twin.component]
        assert np.nanmax(np.abs(both.array(twin.column) - wanted)) < 0.02 * np.abs(wanted).max(), twin.component


def test_values_between_rows_are_those_of_scipy_s_natural_spline():
    rng = np.random.default_rng(4)
    t = np.cumsum(rng.uniform(0.5, 2.0, 200))
    u, when = np.sin(t / 3.0) + 0.1 * rng.normal(size=200), rng.uniform(t[0], t[-1], 500)
    assert_allclose(between(t, u, when), CubicSpline(t, u, bc_type="natural")(when), atol=1e-6)
    assert_allclose(between(t, u, np.array([t[0] - 5.0, t[-1] + 5.0])), u[[0, -1]])
