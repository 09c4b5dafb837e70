"""A recording fitted batch by batch: the same as in memory, whatever the batches; refusals by name."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from errpipe import jsonfile
from errpipe.domain.manifest_text import manifest_text
from errpipe.domain.recording import Column, Constant, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting.batches import equivalent_rows
from errpipe.fitting.source import Source, survey
from errpipe.formats import manifest_folder
from errpipe.models.terms import Terms
from errpipe.terms import TERMS, example_of
from errpipe.validation import held_out

COLUMNS = {
    "run": Column(role="run"),
    "day": Column(role="group", of="day"),
    "t": Column(role="time", unit="s"),
    "x": Column(role="position", unit="mm", axis="X"),
    "side": Column(role="direction", axis="X"),
    "T_nut": Column(role="temperature", unit="degC", location="nut of X"),
    "T_bed": Column(role="temperature", unit="degC", location="bed"),
    "n": Column(role="spindle_speed", unit="rpm"),
    "EXX": Column(role="error", unit="um", component="EXX"),
    "E_Z": Column(role="error", unit="um", component="E_Z"),
}
MODEL = {
    "components": [
        {
            "component": "EXX",
            "terms": [
                {"term": "offset"},
                {"term": "scale_expansion", "axis": "X", "sensor": "T_nut"},
                {"term": "chebyshev", "axis": "X", "degree": 3, "span": (0.0, 500.0)},
                {"term": "backlash", "axis": "X"},
                {"term": "thermal_lag", "sensor": "T_bed", "reference": None, "fixed": {"tau": 4000.0}},
            ],
        },
        {
            "component": "E_Z",
            "terms": [
                {"term": "offset"},
                {
                    "term": "spindle_growth",
                    "column": "n",
                    "full_speed": 10000.0,
                    "fixed": {"tau": 1800.0, "exponent": 1.2},
                },
            ],
        },
    ]
}


def log(rows: int = 9000, runs: int = 7, seed: int = 5) -> Recording:
    """Days of one machine as a log: runs that follow each other in one session, then one after a night's pause."""
    rng = np.random.default_rng(seed)
    run = np.sort(rng.integers(0, runs, rows))
    t = np.arange(rows) * 20.0 + np.where(run >= runs - 2, 40000.0, 0.0)
    x = 250.0 + 250.0 * np.sin(t / 300.0)
    nut = 22.0 + 4.0 * np.sin(t / 9000.0) + 0.02 * rng.normal(size=rows)
    bed = 21.0 + 2.0 * np.sin(t / 15000.0 + 1.0)
    speed = 6000.0 * (np.sin(t / 5000.0) > 0.2)
    noise = np.zeros(rows)
    for i in range(1, rows):
        noise[i] = 0.9 * noise[i - 1] + 0.3 * rng.normal()
    exx = 3.0 + 0.011 * x * (nut - 20.0) + 2.0 * (bed - 21.0) - 1.5 * np.sign(np.cos(t / 300.0)) + noise
    frame = pd.DataFrame(
        {
            "run": np.char.add("r", run.astype(str)),
            "day": np.char.add("d", (run // 2).astype(str)),
            "t": t,
            "x": x,
            "side": np.where(np.cos(t / 300.0) >= 0, 1.0, -1.0),
            "T_nut": nut,
            "T_bed": bed,
            "n": speed,
            "EXX": np.where(rng.random(rows) < 0.02, np.nan, exx),
            "E_Z": 1.0 + 0.0004 * speed + rng.normal(size=rows),
        }
    )
    frame.loc[rng.random(rows) < 0.01, "T_nut"] = np.nan
    axis = Constant(role="axis", kind="linear", unit="mm", travel=(0.0, 500.0))
    return Recording(Manifest(recording=1, tables=("log.csv",), columns=COLUMNS, constants={"X": axis}), frame)


def on_disk(recording: Recording, folder, rows: int) -> Source:
    manifest_folder.write(recording, folder)
    batches = partial(manifest_folder.iter_batches, folder, rows=rows)
    ends, complete, runs = manifest_folder.summary_rows(folder)
    return Source(len(recording), ends, batches, complete, runs)


def same(one, other, path="", rtol=1e-9) -> None:
    """Equal plain values, numbers within a relative difference."""
    if isinstance(one, dict):
        assert one.keys() == other.keys(), path
        for key in one:
            same(one[key], other[key], f"{path}.{key}", rtol)
    elif isinstance(one, list | tuple):
        assert len(one) == len(other), path
        for k, pair in enumerate(zip(one, other, strict=True)):
            same(*pair, f"{path}[{k}]", rtol)
    elif isinstance(one, float) and isinstance(other, float):
        assert one == pytest.approx(other, rel=rtol, abs=1e-12), path
    else:
        assert one == other, path


@pytest.mark.parametrize("scheme", [None, "blocks:4", "leave-one-group-out:day", "forward:3", "batches:3"])
def test_batches_and_memory_give_the_same_model_and_the_same_held_out_figures(tmp_path, scheme):
    recording, family = log(), Terms(**MODEL)
    source = on_disk(recording, tmp_path, 50_000)
    if scheme is None:
        same(family.fit_batches(source).model.model_dump(), family.fit(recording).model.model_dump())
    chosen = None if scheme is None else held_out.holdout.parse(scheme)
    judged_in_batches_result, rows = held_out.cross_validate_in_batches(source, family, chosen)
    known, expected = held_out.cross_validate(recording, family, chosen)
    same(judged_in_batches_result, known)
    for name, folds in rows.items():
        for one, other in zip(folds, expected[name], strict=True):
            np.testing.assert_array_equal(one.rows, other.rows)
            np.testing.assert_allclose(one.after, other.after, rtol=1e-9, atol=1e-9)


def test_a_sensor_without_readings_at_first_is_no_warning_to_the_user(tmp_path, recwarn):
    recording, family = log(), Terms(**MODEL)
    late = np.where(np.arange(len(recording)) < 4000, np.nan, recording.array("T_nut"))
    recording = recording.with_columns({"T_nut": late}, {})
    models = family.fit_batches(on_disk(recording, tmp_path, 1000)).model, family.fit(recording).model
    values = [[p.value for c in model.components for t in c.terms for p in t.parameters] for model in models]
    np.testing.assert_allclose(*values, rtol=1e-6)
    assert not recwarn.list


def test_readings_between_empty_rows_are_held_over_the_borders_of_batches(tmp_path):
    """Every fifth row holds a reading of the nut, no run begins with one, and a long hole stays empty."""
    recording, family = log(), Terms(**MODEL)
    nut = recording.array("T_nut").copy()
    nut[np.arange(len(recording)) % 5 != 3] = np.nan
    nut[2100:2300] = np.nan
    recording = recording.with_columns({"T_nut": nut}, {})
    source = on_disk(recording, tmp_path, 131)
    whole = family.fit(recording).model
    assert 8500 < whole.components[0].rows < 8850  # of those with a deviation, all but the long hole
    for one, other in zip(family.fit_batches(source).model.components, whole.components, strict=True):
        same([t.values() for t in one.terms], [t.values() for t in other.terms])
        same([one.rms_after, one.rows, one.half_width90], [other.rms_after, other.rows, other.half_width90])
    judged, _ = held_out.cross_validate_in_batches(source, family, None)
    same(judged, held_out.cross_validate(recording, family, None)[0])


def test_states_go_on_over_the_borders_of_batches(tmp_path):
    """Batches of 701 rows cut every run and the session: lags, first values and speeds start from where they were."""
    recording, family = log(), Terms(**MODEL)
    model = family.fit_batches(on_disk(recording, tmp_path, 701)).model
    for one, other in zip(model.components, family.fit(recording).model.components, strict=True):
        same([t.values() for t in one.terms], [t.values() for t in other.terms])
        same([one.rms_after, one.rms_before, one.rows], [other.rms_after, other.rms_before, other.rows])
        spread = np.sqrt(np.diag(one.covariance)) / np.sqrt(np.diag(other.covariance))
        assert np.all(np.abs(spread - 1.0) < 0.05)  # the noise's memory ends with each batch


def cut(recording: Recording, rows: int) -> list[Recording]:
    from errpipe.domain.recording import CarriedState

    parts, past = [], CarriedState()
    for first in range(0, len(recording), rows):
        frame = recording.frame.iloc[first : first + rows].reset_index(drop=True)
        parts.append(Recording(recording.manifest, frame, recording.between, past))
        timed = recording.name("time") is not None
        past = CarriedState(parts[-1].run_labels()[-1], float(parts[-1].time()[-1]) if timed else -1.0, {})
        yield parts[-1]
        past.states.update(parts[-1].past.later)


@pytest.mark.parametrize("name", TERMS.tags)
def test_every_term_that_may_be_cut_has_the_same_basis_in_batches(name):
    case = example_of(TERMS[name])
    recording = case.recording
    if not case.term.splittable_in_batches(recording):
        pytest.skip("it needs the whole recording, and says so")
    values = case.term.nonlinear_values(case.parameters)
    numbers = recording.frame.select_dtypes("number")
    ends = pd.DataFrame(
        {n: [numbers[n].min(), numbers[n].max()] if n in numbers else ["1", "1"] for n in recording.frame}
    )
    term = case.term.settled(Recording(recording.manifest, ends))
    whole = case.term.settled(recording).basis(recording, *values)
    parts = np.vstack([term.basis(part, *values) for part in cut(recording, max(2, len(recording) // 7))])
    np.testing.assert_allclose(parts, whole, rtol=1e-9, atol=1e-12)


def test_few_rows_answer_for_all():
    rng = np.random.default_rng(3)
    rows = np.column_stack([np.ones(5000), rng.normal(size=(5000, 4)) * [1.0, 1e3, 1e-3, 5.0] + 7.0])
    few = equivalent_rows(np.linalg.qr(rows, mode="r"))
    np.testing.assert_allclose(few.T @ few, rows.T @ rows, rtol=1e-12)
    np.testing.assert_allclose(few.sum(0) ** 2 / few.shape[0], rows.sum(0) ** 2 / 5000, rtol=1e-9)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"method": "robust"}, "method: robust"),
        ({"datum": "run_start"}, "datum: run_start"),
        ({"term": {"term": "thermal_lag", "sensor": "T_bed"}}, r"thermal_lag of EXX \(non-linear: fix tau\)"),
        ({"term": {"term": "smooth_curve", "axis": "X"}}, "smooth_curve of EXX"),
        ({"term": {"term": "measured_points", "axis": "X"}}, "measured_points of EXX"),
    ],
)
def test_what_cannot_be_done_in_batches_is_refused_by_name_where_batches_are_asked_for(tmp_path, change, says):
    source = on_disk(log(2000), tmp_path, 1000)
    term = change.pop("term", {"term": "offset"})
    model = {"components": [{"component": "EXX", "terms": [term]}], **change}
    with pytest.raises(DataError, match=says):
        Terms(**model, rows_in_memory=1000).in_batches(source)
    assert not Terms(**model).in_batches(Source(5_000_000, source.ends, source.batches))
    assert Terms(**MODEL).in_batches(Source(5_000_000, source.ends, source.batches))


def test_a_run_that_comes_back_is_refused(tmp_path):
    recording = log(3000)
    recording.frame.loc[2900:, "run"] = "r0"
    with pytest.raises(DataError, match="run r0 appears again after run r6"):
        Terms(**MODEL).fit_batches(on_disk(recording, tmp_path, 1000))


def test_a_table_says_of_which_runs_it_consists_so_that_they_are_not_read(tmp_path):
    recording = log(3000).frame.assign(EXX=lambda frame: frame["EXX"].fillna(0.0))
    source = on_disk(Recording(log(10).manifest, recording), tmp_path, 1000)
    assert source.runs == dict(recording["run"].value_counts(sort=False))
    read = []
    batches = lambda names, **known: read.append(names) or source.batches(names, **known)  # noqa: E731
    text, counted = (survey(replace(source, batches=batches, runs=r), Terms(**MODEL)) for r in (source.runs, None))
    assert read == [["run"]]
    assert text.runs == counted.runs and text.scheme == counted.scheme
    np.testing.assert_array_equal(text.lengths, counted.lengths)
    for wrong in (b"[]", b"{", b'[["a", 1]]', b'[["a", -1], ["b", 3001]]', b'[["a", 1500], ["a", 1500]]', b"3", b"[3]"):
        table = pq.read_table(tmp_path / manifest_folder.TABLE)
        facts = {**table.schema.metadata, b"errpipe.runs": wrong}
        pq.write_table(table.replace_schema_metadata(facts), tmp_path / manifest_folder.TABLE)
        assert manifest_folder.summary_rows(tmp_path)[2] is None, wrong


PIPELINE = """\
pipeline: 1
stages:
  - {kind: ingest, recording: raw}
  - kind: fit
    rows_in_memory: 100000
    components:
      - component: EXX
        terms:
          - {term: offset}
          - {term: scale_expansion, axis: X, sensor: T_nut}
          - {term: backlash, axis: X}
          - {term: thermal_lag, sensor: T_bed, reference: null, fixed: {tau: 4000.0}}
  - {kind: validate}
"""


def two_years(folder, rows: int) -> None:
    """A recording folder of two Parquet tables, one a year, of `rows` rows in all."""
    recording = log(rows, runs=40, seed=9)
    (folder / "raw").mkdir()
    for name, part in (("a", recording.frame.iloc[: rows // 2]), ("b", recording.frame.iloc[rows // 2 :])):
        part.to_parquet(folder / "raw" / f"{name}.parquet", index=False)
    text = manifest_text(recording.manifest.model_copy(update={"tables": ("a.parquet", "b.parquet")}))
    (folder / "raw/recording.yaml").write_text(text, "utf-8")
    (folder / "pipeline.yaml").write_text(PIPELINE, "utf-8")


def peak_mb(folder) -> float:
    """Peak memory of `errpipe run` in a process of its own, MB; it must end well."""
    command = [sys.executable, "-m", "tests.peak_memory", "peak.txt", "run", "pipeline.yaml", "--out", "out"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    assert subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.DEVNULL).returncode == 0
    return int((folder / "peak.txt").read_text()) / 1024


def known(folder) -> None:
    """The fitted model and its validation say what the log was made of."""
    (component,) = jsonfile.read(folder / "out/fit/error_model.json")["components"]
    values = {p["name"]: p["value"] for t in component["terms"] for p in t["parameters"] if p["name"] != "tau"}
    assert values["coefficient"] == pytest.approx(11.0, abs=0.1)
    assert values["lost_motion"] == pytest.approx(3.0, abs=0.05)
    (judged,) = jsonfile.read(folder / "out/validate/validation.json")["components"]
    assert judged["verdict"] == "model"
    assert judged["rows"] == component["rows"]


@pytest.mark.slow
def test_a_pipeline_of_partitioned_parquet_is_fitted_in_batches(tmp_path):
    two_years(tmp_path, 150_000)
    peak_mb(tmp_path)
    known(tmp_path)


@pytest.mark.slow
def test_two_million_rows_stay_below_1_gb(tmp_path):
    two_years(tmp_path, 2_000_000)
    assert peak_mb(tmp_path) < 1000.0
    known(tmp_path)
