"""The network of positions and temperatures follows a field that no sum over axes is, and says nothing of noise."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from pydantic import TypeAdapter

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.shared import drive_all
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.models.neural_volume import NeuralVolume

NOISE = 0.3  # um
FAMILY = NeuralVolume(components=("E_X", "E_Z"), units=6)


def recording(size: float = 1.0, runs: int = 5, seed: int = 1) -> Recording:
    """Points in the volume while the column warms: E_X bends with x + 0.7 y, E_Z with the product of x and y."""
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), 80)
    x, y = rng.uniform(0, 500, run.size), rng.uniform(0, 400, run.size)
    warm = np.tile(np.linspace(0, 1, 80), runs) * rng.uniform(2, 8, runs)[run]
    e_x = size * (12 * np.sin((x + 0.7 * y) / 220) + 0.002 * warm * x)
    e_z = size * (10 * np.tanh((x - 250) * (y - 200) / 3e4) + 1.5 * warm)
    frame = pd.DataFrame({"run": run.astype(str), "t": np.arange(run.size) * 30.0, "x": x, "y": y, "T": 20 + warm})
    frame["ex"], frame["ez"] = (e + rng.normal(0, NOISE, run.size) for e in (e_x, e_z))
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "y": Column(role="position", axis="Y", unit="mm"),
        "T": Column(role="temperature", unit="degC", location="column"),
        "ex": Column(role="error", component="E_X", unit="um"),
        "ez": Column(role="error", component="E_Z", unit="um"),
    }
    return Recording(Manifest(recording=1, columns=columns, tables=("r.csv",)), frame)


def test_a_run_that_sat_out_is_left_with_little_more_than_its_noise():
    measured = recording()
    judged = FAMILY.judge(measured, holdout.groups(measured, "auto")[0])
    for one in judged.values():
        assert np.sqrt(np.mean(one.after**2)) < 0.15 * np.sqrt(np.mean(one.before**2)) < 3.0


def test_the_nodes_of_the_table_are_the_network():
    measured = recording()
    fitted = FAMILY.fit(measured).model
    x, y, _ = FAMILY._data(measured)
    network, penalty = FAMILY._trained(measured, x, y, np.ones(len(measured), dtype=bool))
    assert penalty is not None
    for k, component in enumerate(fitted.components):
        (term,) = component.terms
        (node,) = (TypeAdapter(d.Driver).validate_python(n) for n in term.term["driver"])
        assert drive_all([node], measured)[:, 0] == pytest.approx(network.values(x)[:, k], abs=0.05)


def test_of_noise_alone_it_says_nothing():
    fitted = FAMILY.fit(recording(size=0.0))
    assert set(fitted.summary.values()) == {"nothing on groups left out"}
    judged = FAMILY.judge(recording(size=0.0), holdout.groups(recording(size=0.0), "auto")[0])
    assert all(np.array_equal(one.before, one.after) for one in judged.values())


def test_a_recording_without_a_position_is_refused():
    measured = recording()
    columns = {n: c for n, c in measured.manifest.columns.items() if c.role != "position"}
    manifest = measured.manifest.model_copy(update={"columns": columns})
    with pytest.raises(DataError, match="no position of an axis"):
        FAMILY.fit(Recording(manifest, measured.frame.drop(columns=["x", "y"])))
