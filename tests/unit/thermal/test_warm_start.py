"""Starts on a warm machine: learnt from the later part of runs that started cold, without a change to cold starts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.statistics import rms
from errpipe.models.lagged import Lagged
from errpipe.models.rises import Rises
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import table_values
from errpipe.thermal import competition, linear, warm_start
from errpipe.thermal.arithmetic import predicted_since_start, since_start
from errpipe.thermal.model import ThermalModel

STEP, ROWS = 300.0, 72  # s, six hours a day


def lagged(u: np.ndarray, tau: float) -> np.ndarray:
    out = np.full(u.size, u[0])
    for k in range(1, u.size):
        out[k] = u[k] + (out[k - 1] - u[k]) * np.exp(-STEP / tau)
    return out


def days(seed: int, runs: int, start: int = 0) -> Recording:
    """A spindle that warms a column without a sensor; each day begins in equilibrium. start: first row of each run."""
    rng = np.random.default_rng(seed)
    frames = []
    for k in range(runs):
        room = 20.0 + rng.normal(0, 2) + np.cumsum(rng.normal(0, 0.03, ROWS))
        heat = np.r_[0.0, np.repeat(rng.uniform(0, 1, 6), ROWS // 6)[1:]]
        spindle = room + 12.0 * lagged(heat, 1500.0)
        flange = room + 6.0 * lagged(heat, 4000.0)
        growth = 2.0 * spindle - 5.0 * lagged(flange, 6000.0)
        frame = pd.DataFrame({"T_room": room, "T_spindle": spindle, "T_flange": flange})[start:]
        frame += rng.normal(0, 0.02, frame.shape)
        frame["E_Z"] = (growth + rng.normal(0, 0.3, ROWS))[start:] + rng.normal(0, 5)
        frames.append(frame.assign(run=f"day {k}", t=STEP * np.arange(start, ROWS)))
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {f"T_{n}": Column(role="temperature", unit="degC", location=n) for n in ("room", "spindle", "flange")}
    kinds["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), pd.concat(frames, ignore_index=True))


def left(model: ThermalModel, judged: Recording) -> np.ndarray:
    run = judged.run_codes()
    y = since_start(judged.array("E_Z"), run, 3)[0]
    return y - predicted_since_start(model.values(judged), run, 3, y == y)


@pytest.fixture(scope="module")
def models() -> tuple[ThermalModel, ThermalModel]:
    """Fitted to ten days, without and with later starts."""
    whole = days(1, 10)
    return Lagged(component="E_Z", warm_starts=False).train(whole), Lagged(component="E_Z").train(whole)


@pytest.mark.parametrize("start", [18, 35])
def test_a_day_that_starts_warm_is_predicted_from_days_that_started_cold(models, start: int) -> None:
    without, with_later = (rms(left(model, days(2, 6, start))) for model in models)
    assert with_later < 0.6 * without


def test_cold_starts_are_predicted_as_before_to_the_bit(models) -> None:
    cold = days(3, 6)
    predicted = [model.predict(cold) for model in models]
    assert_array_equal(predicted[0].predicted, predicted[1].predicted)
    assert_array_equal(predicted[0].upper, predicted[1].upper)


def test_the_interval_covers_warm_starts(models) -> None:
    warm = days(4, 8, 25)
    without, with_later = (float(np.mean(model.predict(warm).upper - model.values(warm))) for model in models)
    told = models[1].predict(warm)
    half = 0.5 * (told.upper - told.lower)
    assert with_later > 1.05 * without
    assert np.mean(np.abs(left(models[1], warm)) <= half) > 0.8


def test_the_interval_is_the_wider_the_further_a_start_is_from_those_known(models) -> None:
    warm = days(4, 4, 25)
    room = warm.array("T_room")
    hotter = warm.with_columns({n: room + 3.0 * (warm.array(n) - room) for n in ("T_spindle", "T_flange")}, {})
    first = np.diff(warm.run_codes(), prepend=-1) != 0
    half = [0.5 * (p.upper - p.lower)[first].mean() for p in (models[1].predict(warm), models[1].predict(hotter))]
    assert half[1] > 1.5 * half[0]


def test_the_table_gives_warm_starts_back() -> None:
    whole, warm = days(1, 10), days(2, 6, 25)
    family = Lagged(component="E_Z")
    model = family.fit(whole).model
    table = compile_model(model, CompileOptions())
    assert_allclose(table_values(table, model, warm)["E_Z"], family.train(whole).values(warm), atol=1e-3)


def test_a_mixture_without_lags_adds_no_gains_of_rounding_size() -> None:
    fitted = Rises(component="E_Z").train(days(1, 10))
    assert fitted.parts
    assert "start on a warm machine" not in {name for name, _, _ in fitted.parts}
    assert fitted.report["later_starts"][0] == fitted.report["later_starts"][1]


@pytest.mark.parametrize(("sizes", "added"), [((1.0,) * 6, True), ((10.0, 0.1, 0.1, 0.1, 0.1, 0.1), False)])
def test_gains_that_one_run_alone_supports_are_not_added(sizes: tuple[float, ...], added: bool) -> None:
    """All runs have the same gain, but in the second case only one shows that it helps."""
    rng, group = np.random.default_rng(3), np.repeat(np.arange(6), 50)
    column = np.repeat(sizes, 50) * np.sin(np.linspace(0.0, 40.0, 300))
    lacking = 2.0 * column + rng.normal(0.0, 0.01, 300)
    later = warm_start._Later(days(1, 1), group, group, group >= 0, lacking, 0.0 * lacking, lacking)
    folds = [(g,) for g in range(6)]
    gains, left, without = warm_start._chosen(range(6), folds, later, column[:, None], group >= 0, np.zeros((1, 1)))
    assert bool(gains.any()) == added
    assert (rms(left) < 0.1 * without) == added


@pytest.mark.parametrize(("beyond", "learnt"), [(1e-14, False), (1e-9, False), (0.1, True)])
def test_differences_of_later_starts_of_rounding_size_teach_nothing(beyond: float, learnt: bool) -> None:
    """Two sensors 0 or 0.4 K apart at the starts, and later 0.8 K, where what is beyond those recorded begins."""
    whole = days(1, 10)
    run, room = whole.run_codes(), np.round(whole.array("T_room"), 1)
    apart = np.where(np.diff(run, prepend=-1) != 0, 0.4 * (run % 2), 0.8 + beyond)
    columns = {n: c for n, c in whole.manifest.columns.items() if n != "T_flange"}
    frame = whole.frame[[*columns]].assign(T_room=room, T_spindle=room + apart, E_Z=3.0 * room)
    recording = Recording(whole.manifest.model_copy(update={"columns": columns}), frame)
    report = Lagged(component="E_Z").train(recording).report
    assert (report["later_starts"] is not None) == learnt


def test_a_later_start_is_left_out_with_its_run() -> None:
    """A run whose deviation is another one changes the predictions of the other runs, and none of its own."""
    whole = days(1, 6)
    other = whole.with_columns({"E_Z": whole.array("E_Z") * np.where(whole.run_codes() == 2, 3.0, 1.0)}, {})
    family, told = Lagged(component="E_Z"), []
    for recording in (whole, other):
        problem = linear.problem(recording, "E_Z", None, 3)
        ways = competition.groupings(problem.recording, problem.group, problem.groups, "season")
        one = [e for e in family.entrants(problem) if e.name == "lagged, ridge 0.0001"]
        outcome = competition.compete(one, ways, problem.response, problem.rows, problem.group)
        outcome = replace(outcome, weights=((one[0], 1.0),))
        told.append(warm_start._later(problem, outcome, ways[0].folds))
    moved = np.abs(told[1].predicted - told[0].predicted)
    assert moved[told[0].group == 2].max() == 0.0
    assert min(moved[told[0].group == g].max() for g in (0, 1, 3, 4, 5)) > 0.01


def test_runs_that_already_start_warm_and_cold_need_no_later_starts() -> None:
    cold, warm = days(1, 5), days(5, 5, 30)
    both = pd.concat([cold.frame, warm.frame.assign(run="warm " + warm.frame["run"])], ignore_index=True)
    whole = Recording(cold.manifest, both)
    models = [Lagged(component="E_Z", warm_starts=asked).train(whole) for asked in (False, True)]
    assert models[0].terms == models[1].terms


def test_a_sensor_that_is_off_at_a_cold_start_costs_little(models) -> None:
    cold = days(3, 6)
    off = cold.with_columns({"T_flange": cold.array("T_flange") + 1.0}, {})
    without, with_later = (left(model, off) for model in models)
    assert np.abs(with_later - without).max() < 0.5


@pytest.mark.parametrize("sensor", ["T_room", "T_spindle", "T_flange"])
@pytest.mark.parametrize("kelvin", [-40.0, 40.0])
def test_a_sensor_that_is_broken_at_a_cold_start_costs_no_correction(models, sensor: str, kelvin: float) -> None:
    """No later start differs so much: the rise is of use all the same, and nothing is added to it."""
    cold = days(3, 6)
    broken = cold.with_columns({sensor: cold.array(sensor) + kelvin}, {})
    without, with_later = (left(model, broken) for model in models)
    assert rms(with_later) < 1.1 * rms(without) < 1.0


def test_differences_of_many_sensors_are_of_few_operands() -> None:
    """A table holds 4096 operands in all, and 64 of one sum."""
    few = days(1, 4)
    names = [f"T{k}" for k in range(61)]
    column = Column(role="temperature", unit="degC", location="bed")
    many = few.with_columns(dict.fromkeys(names, few.array("T_room")), dict.fromkeys(names, column))
    problem = linear.problem(many, "E_Z", None, 3)
    pairs, _ = warm_start._beyond(problem, many.names("temperature"), many)
    nodes, new = set(), {node for pair in pairs for node in pair}
    while new:
        nodes |= new
        new = {child for node in new for child in _operands(node)} - nodes
    assert len(pairs) == 64 and sum(len(_operands(node)) for node in nodes) < 2500
    assert max(len(_operands(node)) for node in nodes) <= linear.MOST_OPERANDS


def _operands(node) -> tuple:
    of = getattr(node, "of", ())
    return of if isinstance(of, tuple) else (of,)


@pytest.mark.parametrize("name", ["T_room", "T_spindle", "T_flange"])
@pytest.mark.parametrize("off", [-1.5, 1.5])
def test_a_sensor_mounted_anew_is_no_warm_machine(models, name: str, off: float) -> None:
    cold = days(3, 6)
    judged = cold.with_columns({name: cold.array(name) + off}, {})
    without, with_later = (rms(left(model, judged)) for model in models)
    assert with_later < 1.2 * without
