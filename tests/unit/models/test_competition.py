"""Thermal families on simulated bodies: the competition finds what holds in a season that took no part."""

from __future__ import annotations

import subprocess
import sys
import threading

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from sklearn.linear_model import Lasso

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError, GateError
from errpipe.fitting import parallel
from errpipe.fitting.statistics import rms
from errpipe.models import FAMILIES, family_of, procedure
from errpipe.models.auto import Auto, competitors
from errpipe.models.lagged import Lagged
from errpipe.models.network import Network
from errpipe.models.neural import Neural
from errpipe.models.nothing import Nothing
from errpipe.models.rises import Rises
from errpipe.models.season import Season
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import table_values
from errpipe.thermal import competition, linear
from errpipe.thermal.arithmetic import held_readings, since_start
from errpipe.validation.gate import pass_gate
from tests.validation_document import held_out

STEP, ROWS = 300.0, 72  # s, six hours a day
LINEAR = ("lagged", "network", "rises")  # the quick ones
SEASONS = {"winter": 15.0, "spring": 20.0, "summer": 28.0}


def lagged(u: np.ndarray, tau: float) -> np.ndarray:
    out = np.empty_like(u)
    out[0] = u[0]
    for k in range(1, u.size):
        out[k] = u[k] + (out[k - 1] - u[k]) * np.exp(-STEP / tau)
    return out


def machine(seed: int, runs: int = 5, noise: float = 0.3, seasons=tuple(SEASONS), effect: float = 1.0) -> Recording:
    """A spindle and a bed that both grow; the bed's growth lags 1.5 h behind the sensor near it."""
    rng = np.random.default_rng(seed)
    frames = []
    for season in seasons:
        for k in range(runs):
            room = SEASONS[season] + rng.normal(0, 1) + np.cumsum(rng.normal(0, 0.05, ROWS))
            heat = np.repeat(rng.uniform(0, 1, 6), ROWS // 6)
            spindle = room + 12 * lagged(np.r_[0.0, heat[1:]], 1500.0)
            bed = room[0] + lagged(room - room[0], 7200.0) + 3 * lagged(np.r_[0.0, heat[1:]], 6000.0)
            growth = effect * (2.0 * spindle - 6.0 * lagged(bed, 5400.0))
            frame = {"T_room": room, "T_spindle": spindle, "T_bed": bed}
            frame = {n: v + rng.normal(0, 0.02, ROWS) for n, v in frame.items()}
            frame["E_Z"] = growth - growth[0] + rng.normal(0, 5) + rng.normal(0, noise, ROWS)
            label = {"run": f"{season}{k}", "season": season, "t": STEP * np.arange(ROWS)}
            frames.append(pd.DataFrame({**label, **frame}))
    kinds = {"run": Column(role="run"), "season": Column(role="group", of="season"), "t": Column(role="time", unit="s")}
    places = {"T_room": "ambient air", "T_spindle": "spindle bearing", "T_bed": "machine bed"}
    kinds |= {n: Column(role="temperature", unit="degC", location=p) for n, p in places.items()}
    kinds["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), pd.concat(frames, ignore_index=True))


def part(recording: Recording, season: str, inside: bool) -> Recording:
    return recording.take((recording.frame["season"].to_numpy() == season) == inside)


def left_in(model, recording: Recording) -> tuple[float, float]:
    """rms of a season that took no part: uncompensated, and what the model leaves."""
    run = recording.run_codes()
    y = since_start(recording.array("E_Z"), run, 3)[0]
    return rms(y), rms(y - since_start(model.values(recording), run, 3)[0])


@pytest.mark.parametrize("seed", [1])
def test_the_third_season_is_predicted_from_two(seed: int) -> None:
    """The lag matters here: rises alone leave several times more, and the competition knows."""
    whole = machine(seed)
    fitted, judged = part(whole, "summer", False), part(whole, "summer", True)
    before, auto = left_in(Auto(component="E_Z", among=LINEAR).train(fitted), judged)
    _, rises = left_in(Rises(component="E_Z").train(fitted), judged)
    _, late = left_in(Lagged(component="E_Z").train(fitted), judged)
    assert auto < 0.5 * rises and auto < 1.15 * late and auto < 0.1 * before


@pytest.mark.parametrize("family", [Auto(component="E_Z", among=LINEAR), Neural(component="E_Z")])
def test_the_table_gives_the_mixture_back(family) -> None:
    fitted = machine(3, runs=2)
    model = family.fit(fitted).model
    table = compile_model(model, CompileOptions())
    values = family.train(fitted).values(fitted)
    assert np.abs(values).max() > 1.0
    assert_allclose(table_values(table, model, fitted)["E_Z"], values, atol=1e-3)


def test_a_mixture_of_more_parts_than_a_sum_may_have_compiles() -> None:
    """Sixteen sensors and their lags: some hundred drivers."""
    plain = machine(7, runs=2, seasons=("winter", "spring"))
    rng = np.random.default_rng(7)
    more = {f"T_{k}": plain.array("T_bed") + rng.normal(0, 0.1, len(plain)) for k in range(13)}
    place = Column(role="temperature", unit="degC", location="machine bed")
    fitted = plain.with_columns(more, dict.fromkeys(more, place))
    family = Lagged(component="E_Z")
    model = family.fit(fitted).model
    table = compile_model(model, CompileOptions())
    assert_allclose(table_values(table, model, fitted)["E_Z"], family.train(fitted).values(fitted), atol=1e-3)


def test_a_bad_first_reading_weighs_less_in_a_zero_of_more_rows() -> None:
    clean = machine(1)
    first = np.diff(clean.run_codes(), prepend=-1) != 0
    bad = Recording(clean.manifest, clean.frame.assign(E_Z=clean.array("E_Z") + 30.0 * first))
    for count, moved in ((1, 30.0), (6, 5.0)):
        rows = Rises(component="E_Z", datum_rows=count).datum_rows
        responses = [linear.problem(recording, "E_Z", None, rows).response for recording in (clean, bad)]
        assert_allclose((responses[0] - responses[1])[~first], moved, atol=1e-9)


@pytest.mark.parametrize(
    "family",
    [
        pytest.param(Season(component="E_Z"), id="season", marks=pytest.mark.slow),
        pytest.param(Lagged(component="E_Z"), id="lagged"),
    ],
)
def test_folds_in_two_threads_are_judged_to_the_bit_as_one_by_one(family, monkeypatch) -> None:
    recording, threads, documents = machine(2, runs=2), set(), []
    judge = type(family).validate_fold

    def noted(self, *args):
        threads.add(threading.current_thread().name)
        return judge(self, *args)

    monkeypatch.setattr(type(family), "validate_fold", noted)
    monkeypatch.setitem(parallel.parallel_map.__kwdefaults__, "worth", 0.0)
    for cores in (1, 2):
        monkeypatch.setattr(parallel.os, "cpu_count", lambda cores=cores: cores)
        threads.clear()
        documents.append(held_out(recording, family, "leave-one-group-out:run"))
        assert (threads == {threading.main_thread().name}) == (cores == 1)
    assert documents[0] == documents[1]


def test_a_whole_season_sits_out_and_the_mixture_passes_the_gate() -> None:
    recording, family = machine(4, runs=4), Auto(component="E_Z", among=LINEAR)
    fitted = family.fit(recording)
    document = held_out(recording, family)
    assert document["scheme"] == "leave-one-group-out:season"
    assert [g["label"] for g in document["components"][0]["groups"]] == list(SEASONS)
    assert pass_gate(fitted.model, [document]).model.components[0].gain == 1.0
    output = fitted.documents["competition.json"]
    assert set(output["rms_um"]) == {"run", "season", "cold or warm starts"}
    assert sum(w["weight"] for w in output["weights"]) <= 1.0 + 1e-6
    (grid,) = family.grids(fitted.documents)
    assert grid.rows[0] == "nothing" and grid.best == "mixture" and grid.rows[-1] == "noise floor"
    assert grid.columns == ["every run", "every season", "cold or warm starts", *SEASONS, "cold", "warm"]
    assert all(len(row) == len(grid.columns) for row in grid.values)
    assert "um on each held-out run" in fitted.summary["E_Z"]


@pytest.mark.slow
def test_the_seasonal_family_competes_without_its_fade() -> None:
    """Alone it says less of a start far outside of what was seen; a mixture has its own limit."""
    fitted = machine(1, runs=3, seasons=("winter", "spring"))
    hot = fitted.with_columns({n: fitted.array(n) + 15.0 for n in fitted.names("temperature")}, {})
    alone = Season(component="E_Z").train(fitted)
    mixed = Auto(component="E_Z", among=("season",)).train(fitted)
    share = {n: rms(m.values(hot)) / rms(m.values(fitted)) for n, m in (("alone", alone), ("mixed", mixed))}
    assert share["alone"] < 0.85 * share["mixed"], share


def test_where_temperatures_say_nothing_nothing_is_exported() -> None:
    quiet = machine(5, runs=4, effect=0.0)
    for family in (Auto(component="E_Z", among=LINEAR), Nothing(component="E_Z")):
        with pytest.raises(GateError, match="not better than no compensation"):
            pass_gate(family.fit(quiet).model, [held_out(quiet, family)])


def test_of_one_labelled_season_what_bends_does_not_compete() -> None:
    """Nothing says that it holds in another one; without a label every family competes."""
    one = machine(6, seasons=("winter",), runs=6)
    competed = Auto(component="E_Z")._compete(one, None)[1].left["run"]
    assert not [name for name in competed if name.startswith(("neural", "bilinear"))]
    kinds = {n: c for n, c in one.manifest.columns.items() if n != "season"}
    bare = Recording(one.manifest.model_copy(update={"columns": kinds}), one.frame.drop(columns="season"))
    assert any(name.startswith("bilinear") for name in Auto(component="E_Z")._compete(bare, None)[1].left["run"])
    assert Auto(component="E_Z").folds(bare, None)[0] == "leave-one-run-out"


def test_time_constants_follow_the_recording() -> None:
    recording = machine(1, runs=2)
    slower = recording.with_columns({"t": 10.0 * recording.time()}, {})
    taus = linear.time_constants(recording)
    assert taus[-1] == pytest.approx(STEP * (ROWS - 1), rel=0.01) and taus[0] >= linear.SAMPLES * STEP
    assert_allclose(linear.time_constants(slower), 10.0 * np.array(taus), rtol=0.01)


def test_lasso_on_a_triangle_is_lasso_on_the_rows() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=(400, 6)) * [1, 2, 3, 1, 1, 5]
    y = x @ [1.0, 0, -0.5, 0, 0, 0.2] + rng.normal(0, 0.3, 400)
    triangle = np.linalg.qr(np.column_stack([x, y]), mode="r")
    (gains,) = linear.lasso_path(triangle[:, :-1], triangle[:, -1], 400.0, [0.1])
    size = np.sqrt(np.mean(x**2, axis=0))
    alpha = 0.1 * np.abs((x / size).T @ y).max() / 400
    assert_allclose(gains, Lasso(alpha, fit_intercept=False, tol=1e-8).fit(x / size, y).coef_ / size, atol=2e-3)


def test_common_gains_are_least_squares_where_groups_may_not_differ_and_their_mean_where_they_may() -> None:
    rng = np.random.default_rng(3)
    gains, rows = np.array([[1.0, 2.0], [3.0, 2.0]]), (900, 100)
    parts, whole = [], []
    for g, n in zip(gains, rows, strict=True):
        x = rng.normal(size=(n, 2))
        parts.append((x, x @ g, float(n)))
        whole.append((x, x @ g))
    pooled = np.linalg.lstsq(np.vstack([x for x, _ in whole]), np.concatenate([y for _, y in whole]), rcond=None)[0]
    assert_allclose(linear.common_gains(parts, 0.0, 1e-9), pooled, atol=1e-4)
    assert_allclose(linear.common_gains(parts, 0.0, 1e6), gains.mean(axis=0), atol=1e-3)
    still = [(np.zeros_like(x), y, n) for x, y, n in parts]
    assert_allclose(linear.common_gains(still, 1e-5, 1.0), 0.0)


def test_empty_cells_hold_the_reading_before_and_a_start_takes_the_first() -> None:
    whole = machine(4, runs=3)
    rng = np.random.default_rng(4)
    holes = {n: np.where(rng.random(len(whole)) < 0.05, np.nan, whole.array(n)) for n in ("T_room", "T_bed")}
    first = np.r_[True, np.diff(whole.run_codes()) != 0]
    holes["T_spindle"] = np.where(first, np.nan, whole.array("T_spindle"))
    patchy = whole.with_columns(holes, {})
    before, left = left_in(Rises(component="E_Z").train(patchy), whole)
    assert left < 0.25 * before
    filled = held_readings(patchy)
    assert held_readings(whole).frame is whole.frame and not np.isnan(filled.array("T_spindle")).any()
    assert filled.array("T_spindle")[0] == whole.array("T_spindle")[1]
    silent = whole.with_columns({"T_bed": np.full(len(whole), np.nan)}, {})
    assert "without T_bed" in Rises(component="E_Z").fit(silent).summary["E_Z"]
    none = silent.with_columns({n: np.full(len(whole), np.nan) for n in ("T_room", "T_spindle")}, {})
    with pytest.raises(DataError, match="most gaps: T_room, no reading in 648 of 648 rows"):
        Rises(component="E_Z").train(none)


def test_one_run_without_temperatures_is_a_clear_message() -> None:
    recording = machine(1, runs=1, seasons=("winter",))
    kinds = {n: c for n, c in recording.manifest.columns.items() if c.role != "temperature"}
    bare = Recording(recording.manifest.model_copy(update={"columns": kinds}), recording.frame[list(kinds)])
    with pytest.raises(DataError, match="has no temperature"):
        Auto(component="E_Z").fit(bare)
    with pytest.raises(DataError, match="only one group"):
        competition.compete([], [], np.zeros(3), np.ones(3, dtype=bool), np.zeros(3, dtype=int))


def test_every_family_is_read_back_from_its_procedure() -> None:
    for kind in competitors():
        family = kind.competitor({"component": "E_Z"})
        assert family_of(procedure(family, "")) == family and kind in FAMILIES and family.responses == ("E_Z",)
    with pytest.raises(ValueError, match="Did you mean lagged"):
        Auto(component="E_Z", among=("laged",))
    assert Network in competitors() and Auto not in competitors()


def test_every_thermal_family_competes_in_a_process_that_loaded_none() -> None:
    code = "from errpipe.models.auto import competitors; print(len(competitors()))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) == len(competitors()) >= 4


def test_a_list_of_families_competes(tmp_path) -> None:
    from errpipe.errors import ConfigError
    from errpipe.pipeline.spec import load_pipeline
    from errpipe.stages import STAGES

    stages = "  - {kind: ingest, recording: .}\n  - {kind: fit, family: [%s], component: E_Z}\n"
    (tmp_path / "p.yaml").write_text("pipeline: 1\nstages:\n" + stages % "lagged, network")
    fit = load_pipeline(tmp_path / "p.yaml", STAGES).stage("fit")
    assert fit.family_options() == Auto(component="E_Z", among=("lagged", "network"))
    (tmp_path / "p.yaml").write_text("pipeline: 1\nstages:\n" + stages % "lagged, netwrok")
    with pytest.raises(ConfigError, match="Did you mean network"):
        load_pipeline(tmp_path / "p.yaml", STAGES)


@pytest.mark.parametrize("family", [Lagged, pytest.param(Neural, marks=pytest.mark.slow)])
def test_deviations_sampled_less_often_than_temperatures_count_from_the_same_rows(family) -> None:
    """A probe every 30 min: the zero of a run is the mean of its first three touches, for the prediction too."""
    whole = machine(4)
    touched = np.arange(len(whole)) % 6 == 0
    seldom = whole.with_columns({"E_Z": np.where(touched, whole.array("E_Z"), np.nan)}, {})
    model = family(component="E_Z")
    left = []
    for recording in (whole, seldom):
        _, folds = model.folds(recording, None)
        left.append(rms(np.concatenate([model.validate_fold(recording, fold)["E_Z"].after for fold in folds])))
    assert left[1] < 1.5 * left[0], left


def test_temperatures_sampled_less_often_are_held_until_the_next_reading() -> None:
    whole = machine(4, runs=2)
    slow = np.where(np.arange(len(whole)) % 10 == 0, whole.array("T_bed"), np.nan)
    held = held_readings(whole.with_columns({"T_bed": slow}, {})).array("T_bed")
    assert np.isfinite(held).all()
    assert held[19] == whole.array("T_bed")[10]


@pytest.mark.parametrize("family", [Lagged, Season])
def test_runs_that_follow_each_other_are_fitted_as_they_are_predicted_each_by_itself(family) -> None:
    """A log cut into runs: what a prediction of one run does not know of the run before must not be learnt either."""
    apart = machine(5, runs=2)
    t = apart.array("t") + apart.run_codes() * (ROWS + 1) * STEP
    at_once = apart.with_columns({"t": t}, {})
    expected = family(component="E_Z").train(apart).values(apart)
    assert np.abs(expected).max() > 5.0
    assert_allclose(family(component="E_Z").train(at_once).values(at_once), expected, atol=1e-9)


def test_a_log_that_begins_before_its_sensors_do_is_fitted() -> None:
    """Nothing is read in the first 2 h of every run (the machine is off), longer than a hole is held for."""
    whole = machine(6, runs=3)
    late = np.arange(len(whole)) % ROWS >= 24
    names = (*whole.names("temperature"), "E_Z")
    silent = whole.with_columns({n: np.where(late, whole.array(n), np.nan) for n in names}, {})
    for family in (Season, Network):
        model = family(component="E_Z").train(silent)
        assert np.isfinite(model.values(silent)[late]).all()


def test_rows_that_lack_a_sensor_take_no_part_and_the_fit_says_so() -> None:
    """A sensor that was mounted after the first six of nine runs."""
    whole = machine(7, runs=3)
    later = np.where(whole.run_codes() < 6, np.nan, whole.array("T_bed"))
    said = Rises(component="E_Z").fit(whole.with_columns({"T_bed": later}, {})).summary["E_Z"]
    assert "fitted to 216 of 648 rows" in said and "most gaps: T_bed, no reading in 432 of 648 rows" in said
    assert "fitted to" not in Rises(component="E_Z").fit(whole).summary["E_Z"]


def test_a_deviation_that_changes_along_an_axis_is_named() -> None:
    """To and fro over 800 mm; a single pass says nothing, because drift and place are one there."""
    whole = machine(8, runs=3)
    at = np.arange(len(whole)) % ROWS
    to_and_fro, once = 100.0 * np.abs(at % 16 - 8), 800.0 * at / ROWS
    for place, named in ((to_and_fro, True), (once, False)):
        bent = whole.array("E_Z") + 0.05 * (place - 400.0)
        along = whole.with_columns({"x": place, "E_Z": bent}, {"x": Column(role="position", axis="X", unit="mm")})
        assert ("straight line over x" in Rises(component="E_Z").fit(along).summary["E_Z"]) is named
