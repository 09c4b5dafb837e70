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
from errpipe.models import _volume_network
from errpipe.models.auto import Auto
from errpipe.models.neural_volume import NeuralVolume
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import table_values
from errpipe.thermal import linear
from errpipe.thermal.arithmetic import since_start
from tests.validation_document import held_out

NOISE = 0.3  # um
FAMILY = NeuralVolume(components=("E_X", "E_Z"), units=6)


def recording(size: float = 1.0, runs: int = 5, seed: int = 1, bent: float = 1.0, warmer: float = 1.0) -> Recording:
    """Points in the volume while the column warms: E_X bends with x + 0.7 y, E_Z with the product of x and y.

    bent: size of what depends on positions alone; without it E_Z follows the column's temperature. warmer: each
    run beside the run before it.
    """
    rng = np.random.default_rng(seed)
    run = np.repeat(np.arange(runs), 80)
    x, y = rng.uniform(0, 500, run.size), rng.uniform(0, 400, run.size)
    warm = np.tile(np.linspace(0, 1, 80), runs) * (rng.uniform(2, 8, runs) * warmer ** np.arange(runs))[run]
    e_x = size * (bent * 12 * np.sin((x + 0.7 * y) / 220) + 0.002 * warm * x)
    e_z = size * (bent * 10 * np.tanh((x - 250) * (y - 200) / 3e4) + 1.5 * warm)
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
    judged = FAMILY.validate_fold(measured, holdout.groups(measured, "auto")[0])
    for one in judged.values():
        assert np.sqrt(np.mean(one.after**2)) < 0.15 * np.sqrt(np.mean(one.before**2)) < 3.0


def test_the_nodes_of_the_table_are_the_network():
    measured = recording()
    fitted = FAMILY.fit(measured).model
    x, y, _ = _volume_network.data(measured, FAMILY.components)
    network, penalty = _volume_network.chosen(measured, x, y, np.ones(len(measured), dtype=bool), FAMILY.units)
    assert penalty is not None
    for k, component in enumerate(fitted.components):
        (term,) = component.terms
        (node,) = (TypeAdapter(d.Driver).validate_python(n) for n in term.term["driver"])
        assert drive_all([node], measured)[:, 0] == pytest.approx(network.values(x)[:, k], abs=0.05)


def test_of_noise_alone_it_says_nothing():
    fitted = FAMILY.fit(recording(size=0.0))
    assert set(fitted.summary.values()) == {"nothing on held-out groups"}
    judged = FAMILY.validate_fold(recording(size=0.0), holdout.groups(recording(size=0.0), "auto")[0])
    assert all(np.array_equal(one.before, one.after) for one in judged.values())


def test_a_recording_without_a_position_is_refused():
    measured = recording()
    columns = {n: c for n, c in measured.manifest.columns.items() if c.role != "position"}
    manifest = measured.manifest.model_copy(update={"columns": columns})
    with pytest.raises(DataError, match="no column of role position"):
        FAMILY.fit(Recording(manifest, measured.frame.drop(columns=["x", "y"])))


BESIDE = Auto(component="E_Z", among=("neural_volume", "rises"))
ALONE = Auto(component="E_Z", among=("rises",))


def left(family: Auto, fitted: Recording, judged: Recording) -> float:
    """rms of runs that took no part, um."""
    run = judged.run_codes()
    predicted = since_start(family.train(fitted).values(judged), run, 3)[0]
    return float(np.sqrt(np.mean((since_start(judged.array("ez"), run, 3)[0] - predicted) ** 2)))


def neural_weight(family: Auto, fitted: Recording) -> float:
    weights = family.fit(fitted).documents["competition.json"]["weights"]
    return sum(w["weight"] for w in weights if w["family"] == "neural_volume")


def test_in_a_competition_it_wins_where_positions_matter():
    fitted, judged = recording(), recording(seed=2, runs=3)
    assert neural_weight(BESIDE, fitted) > 0.8
    assert left(BESIDE, fitted, judged) < 0.3 * left(ALONE, fitted, judged)


@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in (2, 3))])
def test_in_a_competition_it_is_not_chosen_where_it_is_worse(seed):
    """Deviations follow a temperature alone, and every run is warmer than the last: tanh ends where rises go on."""
    whole = recording(bent=0.0, runs=8, seed=seed, warmer=1.5)
    fitted, judged = (whole.take(np.flatnonzero((whole.run_codes() == 7) == sat_out)) for sat_out in (False, True))
    output = BESIDE.fit(fitted).documents["competition.json"]
    (network, rises) = (
        min(rms for name, rms in output["rms_um"]["run"].items() if name.startswith(family))
        for family in ("neural_volume", "rises")
    )
    assert network > 1.5 * rises
    assert [w["family"] for w in output["weights"]] == ["rises"]
    assert left(BESIDE, fitted, judged) == pytest.approx(left(ALONE, fitted, judged), rel=0.01)


def test_in_a_competition_over_noise_nothing_wins():
    assert BESIDE.fit(recording(size=0.0)).documents["competition.json"]["weights"] == []


def test_in_a_competition_its_table_is_what_was_judged():
    measured = recording()
    model = BESIDE.fit(measured).model
    assert {"x", "y"} <= set(model.validity.ranges)
    run = measured.run_codes()
    values = since_start(BESIDE.train(measured).values(measured), run, 1)[0]
    of_table = table_values(compile_model(model, CompileOptions()), model, measured)["E_Z"]
    assert of_table == pytest.approx(values, abs=1e-3)
    problem = linear.problem(measured, "E_Z", None, 3)
    for entrant in NeuralVolume.competitor({"component": "E_Z"}).entrants(problem):
        parts = entrant.parts(tuple(problem.groups))
        compiled = drive_all([node for _, _, node in parts], measured) @ [gain for _, gain, _ in parts]
        compiled = since_start(compiled, run, 3)[0]
        assert entrant.predict(tuple(problem.groups)) == pytest.approx(compiled, abs=0.1)


@pytest.mark.slow
def test_the_competition_is_judged_on_whole_runs():
    (component,) = held_out(recording(), BESIDE)["components"]
    assert component["rms_after"] < 0.3 * component["rms_before"]
    assert [g["label"] for g in component["groups"]] == [f"{k}" for k in range(5)]


def test_without_a_position_it_does_not_compete():
    measured = recording()
    columns = {n: c for n, c in measured.manifest.columns.items() if c.role != "position"}
    manifest = measured.manifest.model_copy(update={"columns": columns})
    problem = linear.problem(Recording(manifest, measured.frame.drop(columns=["x", "y"])), "E_Z", None, 3)
    assert not NeuralVolume.competitor({"component": "E_Z"}).entrants(problem)
