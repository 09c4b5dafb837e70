"""Twins from a recording, a CSV and an error model: aligned in time, in sign and in unit, and never invented."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError, UsageError
from errpipe.simulation import external


def recorded(runs: int = 1, simulated: str | None = None, **columns) -> Recording:
    """Rows every 10 s for 500 s, runs one after the other; EXX is 2 um/K over 20 degC and 5 um besides."""
    t = np.arange(0.0, 510.0 * runs, 10.0)
    rise = np.linspace(0.0, 6.0, t.size)
    frame = {"run": np.repeat([f"r{k}" for k in range(runs)], 51), "t": t, "T": 20 + rise, "EXX": 5 + 2 * rise}
    kinds = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "T": Column(role="temperature", unit="degC"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    if simulated is not None:
        frame["sim"], kinds["sim"] = 2 * rise, Column(role="simulated", component="EXX", unit=simulated)
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), pd.DataFrame(frame | columns))


def from_csv(tmp_path: Path, recording: Recording, text: str, **options):
    file = tmp_path / "sim.csv"
    file.write_text(text)
    column = {"column": "dev", "unit": options.pop("unit", "um"), "means": options.pop("means", "deviation")}
    how = external.FromCsv.model_validate({"kind": "csv", "columns": {"EXX": column}, **options})
    out, (twin,), _ = external.with_twins(recording, how, file)
    return out.array(twin.column), twin


def table(t, values, run=None) -> str:
    frame = pd.DataFrame({"t": t, "dev": values} | ({} if run is None else {"run": run}))
    return frame.to_csv(index=False)


def test_a_csv_is_interpolated_between_its_rows(tmp_path: Path) -> None:
    values, twin = from_csv(tmp_path, recorded(), table([0, 300, 500], [0.0, 30.0, 10.0]))
    t = recorded().time()
    assert_allclose(values, np.interp(t, [0, 300, 500], [0, 30, 10]), atol=1e-12)
    assert (twin.rows, twin.with_twin, twin.missing) == (51, 51, {})


@pytest.mark.parametrize("unit, factor", [("um", 1.0), ("mm", 1e3), ("nm", 1e-3)])
def test_units_become_the_response_s_own(tmp_path: Path, unit: str, factor: float) -> None:
    values, _ = from_csv(tmp_path, recorded(), table([0, 500], [1.0, 1.0]), unit=unit)
    assert_allclose(values, factor)


def test_a_correction_is_minus_a_deviation(tmp_path: Path) -> None:
    values, _ = from_csv(tmp_path, recorded(), table([0, 500], [3.0, 3.0]), means="correction")
    assert_allclose(values, -3.0)


def test_another_dimension_is_refused(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="recorded in um, simulated in N"):
        from_csv(tmp_path, recorded(), table([0, 500], [1, 1]), unit="N")


def test_minutes_count(tmp_path: Path) -> None:
    values, _ = from_csv(tmp_path, recorded(), table([0, 10], [0.0, 600.0]), time_unit="min")
    assert_allclose(values, recorded().time())


def test_nothing_is_extrapolated(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"10 of 51 recorded rows have no simulated value.*10 outside its time"):
        from_csv(tmp_path, recorded(), table([0, 400], [0, 4]))
    values, twin = from_csv(tmp_path, recorded(), table([0, 400], [0, 4]), most_missing=0.3)
    assert np.isnan(values[recorded().time() > 400]).all() and np.isfinite(values[:41]).all()
    assert twin.missing == {"outside its time": 10}


def test_a_gap_stays_empty_and_is_reported(tmp_path: Path) -> None:
    t = np.r_[np.arange(0, 101, 5.0), np.arange(200, 501, 5.0)]
    values, twin = from_csv(tmp_path, recorded(), table(t, t), most_missing=0.3)
    inside = (recorded().time() > 100) & (recorded().time() < 200)
    assert np.isnan(values[inside]).all() and np.isfinite(values[~inside]).all()
    assert twin.missing == {"inside its gaps": 9} and twin.notes == ("gap in run r0: 9 rows from 110 to 190 s",)
    values, _ = from_csv(tmp_path, recorded(), table(t, t), longest_gap=120.0)
    assert_allclose(values, recorded().time())


def test_empty_cells_are_gaps_too(tmp_path: Path) -> None:
    t = np.arange(0, 501, 5.0)
    simulated = np.where((t > 100) & (t < 300), np.nan, t)
    _, twin = from_csv(tmp_path, recorded(), table(t, simulated), most_missing=0.5)
    assert twin.missing == {"inside its gaps": 19}


def test_no_value_crosses_from_one_run_into_the_next(tmp_path: Path) -> None:
    recording = recorded(runs=2)
    rows = table([0, 500, 510, 1010], [0, 0, 9, 9], ["r0", "r0", "r1", "r1"])
    values, _ = from_csv(tmp_path, recording, rows, run="run")
    assert_allclose(values, np.repeat([0.0, 9.0], 51))


def test_a_run_missing_in_the_file_is_reported(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="51 of runs that the file does not have"):
        from_csv(tmp_path, recorded(runs=2), table([0, 500], [0, 0], ["r0", "r0"]), run="run")


def test_runs_that_overlap_in_time_need_a_label(tmp_path: Path) -> None:
    t = np.tile(np.arange(0, 510, 10.0), 2)
    with pytest.raises(DataError, match="overlap in time"):
        from_csv(tmp_path, recorded(runs=2, t=t), table([0, 500], [0, 0]))


@pytest.mark.parametrize(
    "text, message",
    [
        ("t,dev\n0,1\n500,x\n", r"sim.csv:3  dev: 'x' is not a number"),
        ("t,dev\n0,1\n20,1\n10,1\n500,2\n", r"sim.csv:4  t: time must increase"),
        ("time,dev\n0,1\n", r"no column 't' \(present: time, dev\)"),
        ("t,dev\n", "a header, but no rows"),
        ("t,dev\n0,nan\n500,\n", "51 of 51"),
        ("", "not a CSV table"),
    ],
)
def test_a_file_that_cannot_be_used_says_where(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(DataError, match=message):
        from_csv(tmp_path, recorded(), text)


def test_at_an_event_the_later_row_counts(tmp_path: Path) -> None:
    values, _ = from_csv(tmp_path, recorded(), table([0, 250, 250, 500], [0, 0, 8, 8]))
    assert values[24] == pytest.approx(8 * 240 / 250) and values[25] == 8.0  # linear towards what holds at 250 s


def test_each_run_may_start_at_its_first_readings(tmp_path: Path) -> None:
    recording = recorded(runs=2)
    flat = table([0, 1010], [100.0, 100.0])
    values, twin = from_csv(tmp_path, recording, flat, datum="run_start")
    exx = recording.array("EXX")
    assert_allclose(values, np.repeat([exx[:3].mean(), exx[51:54].mean()], 51))
    assert "starts at its first readings" in twin.notes[0] or "start at its first readings" in twin.notes[0]


def test_columns_that_are_there_serve_as_they_are() -> None:
    recording = recorded(simulated="um")
    out, (twin,), _ = external.with_twins(recording, external.FromRecorded(kind="recorded"))
    assert twin.column == "sim" and out.frame.equals(recording.frame)


def test_columns_in_another_unit_or_none_at_all_are_refused() -> None:
    how = external.FromRecorded(kind="recorded")
    with pytest.raises(DataError, match="recorded in um, simulated in N"):
        external.with_twins(recorded(simulated="N"), how)
    with pytest.raises(DataError, match="no column of role simulated"):
        external.with_twins(recorded(), how)


def model(datum: str = "absolute", sensor: str = "T", component: str = "EXX", unit: str = "um") -> ErrorModel:
    gain = FittedParameter(name="gain", value=2.0, unit="um/K")
    term = FittedTerm(term={"term": "thermal_drift", "sensor": sensor, "reference": 20.0}, parameters=(gain,))
    return ErrorModel(
        components=(ComponentModel(component=component, unit=unit, terms=(term,)),),
        columns={sensor: {"role": "temperature", "unit": "degC"}},
        datum=datum,
    )


def test_an_error_model_is_its_own_simulation() -> None:
    out, (twin,), _ = external.with_twins(recorded(), external.FromModel(kind="error_model"), model=model())
    assert twin.column == "EXX_sim" and out.manifest.columns["EXX_sim"].role == "simulated"
    assert_allclose(out.array("EXX") - out.array("EXX_sim"), 5.0)  # the datum is no part of the model


def test_a_model_that_counts_from_the_run_s_start_does_so_here_too() -> None:
    how = external.FromModel(kind="error_model")
    out, (twin,), _ = external.with_twins(recorded(), how, model=model("run_start"))
    left = out.array("EXX") - out.array(twin.column)
    assert_allclose(left, 0.0, atol=1e-9)


def test_a_model_of_something_else_is_refused() -> None:
    how = external.FromModel(kind="error_model")
    with pytest.raises(DataError, match="reads T_nut, which the recording lacks"):
        external.with_twins(recorded(), how, model=model(sensor="T_nut"))
    with pytest.raises(DataError, match="the error model has E_Z, the recording of EXX"):
        external.with_twins(recorded(), how, model=model(component="E_Z"))
    with pytest.raises(DataError, match="recorded in um, modelled in N"):
        external.with_twins(recorded(), how, model=model(unit="N"))
    with pytest.raises(UsageError, match="no error model"):
        external.with_twins(recorded(), how)


def test_a_response_that_is_not_there_is_named(tmp_path: Path) -> None:
    file = tmp_path / "sim.csv"
    file.write_text("t,dev\n0,1\n500,1\n")
    how = external.FromCsv.model_validate({"kind": "csv", "columns": {"EXY": {"column": "dev", "unit": "um"}}})
    with pytest.raises(DataError, match=r"no response EXY \(present: EXX\)"):
        external.with_twins(recorded(), how, file)
    with pytest.raises(UsageError, match="`file` is missing"):
        external.with_twins(recorded(), how)


def test_by_name_what_is_called_alike_belongs_together(tmp_path: Path) -> None:
    recording = recorded(runs=2)
    file = tmp_path / "sim.csv"
    frame = pd.DataFrame({"run": recording.frame["run"], "t": recording.time(), "EXX_sim": 2.0, "other": 1.0})
    file.write_text(frame.to_csv(index=False))
    how = external.by_name(recording, file)
    assert (how.time, how.run, how.columns["EXX"].column, how.columns["EXX"].unit) == ("t", "run", "EXX_sim", "um")
    out, _, _ = external.with_twins(recording, how, file)
    assert_allclose(out.array("EXX_sim"), 2.0)
    assert external.by_name(recording, tmp_path / "model.json").kind == "error_model"


@pytest.mark.parametrize(
    "name, text, message",
    [
        ("sim.csv", "t,dev\n0,1\n", r"no column for any response of the recording \(EXX; found t, dev\)"),
        ("sim.csv", "a,EXX\n0,1\n", r"needs a time column \(found a, EXX\)"),
        ("sim.csv", "", r"needs a time column \(found nothing\)"),
        ("sim.mat", "", r"a simulation is a \.csv, an error model"),
    ],
)
def test_by_name_where_nothing_is(tmp_path: Path, name: str, text: str, message: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(DataError, match=message):
        external.by_name(recorded(), tmp_path / name)
