"""Values of another simulation for a recording, row by row: the `simulated` columns that a diagnosis compares with.

    recorded      the columns of role simulated that the recording already has
    csv           a file of simulated values over time, interpolated linearly inside a run, never beyond its ends
    error_model   errpipe's own fitted model, evaluated causally on the recording's columns
    fmu           a Functional Mock-up Unit, run over the recorded inputs (see `fmu`)

Simulated values become deviations (actual minus commanded) in the response's own unit. Rows without a simulated value
(outside the file's time, inside a gap, an input missing) are empty and reported; if they are more than
`most_missing` of the recorded rows, the simulation is rejected.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Recording
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.simulation.responses import Values, error_column
from errpipe.simulation.twin_csv import csv_by_name, csv_values
from errpipe.simulation.twin_options import AnySource, FromCsv, FromFmu, FromModel, FromRecorded, TwinOptions

FIRST_READINGS = 3  # readings averaged to a run's zero if the datum is its start: less noise than one reading

__all__ = ["AnySource", "FromCsv", "FromFmu", "FromModel", "FromRecorded", "by_name", "error_column", "with_twins"]

Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class Twin:
    """Origin of the simulated values of a response. rows: recorded ones; missing: reasons for rows without a value."""

    component: str
    column: str
    unit: str
    source: str
    rows: int
    with_twin: int
    missing: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def with_twins(
    recording: Recording,
    how: FromRecorded | FromCsv | FromModel | FromFmu,
    file: Path | None = None,
    model: ErrorModel | None = None,
    progress: Progress = lambda share, text: None,
) -> tuple[Recording, list[Twin], dict[str, Any]]:
    """The recording with a simulated column for each response, the origin of each, and figures of the source.

    file: the CSV or the FMU; model: the error model. Raises UsageError if an input of the source is missing,
    DataError if simulated values and recording do not match.
    """
    extra: dict[str, Any] = {}
    match how:
        case FromRecorded():
            by_component = _recorded(recording)
        case FromCsv():
            by_component = csv_values(recording, how, _needed(file, "a CSV file"))
        case FromModel():
            if model is None:
                raise UsageError("twin: no error model: name a file, or put a fit stage before it")
            by_component = _model(recording, model)
        case FromFmu():
            from errpipe.simulation import fmu

            result = fmu.run(recording, how, _needed(file, "an FMU"), progress)
            by_component = {
                c: Values(v, result.source, {"not finite": ~np.isfinite(v)}, result.notes)
                for c, v in result.values.items()
            }
            extra = result.figures
    twins = []
    for component, simulated in by_component.items():
        recording, twin = _placed(recording, component, simulated, how)
        twins.append(twin)
    return recording, twins, extra


def by_name(recording: Recording, file: Path) -> FromCsv | FromModel | FromFmu:
    """How to read a simulation's file if only its name is given: columns are matched by name.

    .csv: the time column is named as in the recording (or t, time), a response's column EXX, EXX_sim or as its error
    column (with _sim); .json: an error model; .fmu: see `fmu.by_name`. Units are the recording's own if the file
    states none. Raises DataError if no name matches.
    """
    match Path(file).suffix.lower():
        case ".csv":
            return csv_by_name(recording, Path(file))
        case ".json":
            return FromModel(kind="error_model")
        case ".fmu":
            from errpipe.simulation import fmu

            return FromFmu(kind="fmu", **fmu.by_name(recording, Path(file)))
    raise DataError(f"{Path(file).name}: a simulation is a .csv, an error model (.json) or an .fmu")


def _needed(file: Path | None, what: str) -> Path:
    if file is None:
        raise UsageError(f"twin: `file` is missing: the path of {what}")
    return Path(file)


def _placed(recording: Recording, component: str, simulated: Values, how: TwinOptions) -> tuple[Recording, Twin]:
    """The recording with one more (or one replaced) simulated column."""
    error = error_column(recording, component)
    recorded = recording.array(error)
    values, notes = simulated.values, list(simulated.notes)
    if (how.datum or simulated.datum) == "run_start":
        values = from_first_readings(recording, recorded, values)
        notes.append("each run's simulated values start at its first readings")
    known = np.isfinite(recorded)
    have = known & np.isfinite(values)
    missing = {why: int(np.count_nonzero(known & rows)) for why, rows in simulated.why.items()}
    missing = {why: count for why, count in missing.items() if count}
    unit = recording.manifest.columns[error].unit or "um"
    column = recording.name("simulated", component=component) or _free_name(recording, f"{error}_sim")
    twin = Twin(component, column, unit, simulated.source, int(known.sum()), int(have.sum()), missing, tuple(notes))
    _refuse_missing(twin, how.most_missing)
    kind = Column(role="simulated", component=component, unit=unit)
    return recording.with_columns({column: values}, {column: kind}), twin


def _free_name(recording: Recording, wanted: str) -> str:
    name = wanted
    while name in recording.manifest.columns:
        name += "_"
    return name


def _refuse_missing(twin: Twin, max_share: float) -> None:
    missing = twin.rows - twin.with_twin
    if not twin.with_twin or missing > max_share * twin.rows:
        reasons = "; ".join(f"{count} {why}" for why, count in twin.missing.items())
        raise DataError(
            f"twin: {twin.component}: {missing} of {twin.rows} recorded rows have no simulated value from "
            f"{twin.source} ({reasons or 'empty'}; allowed: {100 * max_share:.0f} %)"
        )


def from_first_readings(recording: Recording, recorded: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Values shifted run by run to start at the run's first readings, shape (rows,)."""
    run, out = recording.run_codes(), values.copy()
    both = np.isfinite(recorded) & np.isfinite(values)
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        first = rows[both[rows]][:FIRST_READINGS]
        out[rows] += np.mean(recorded[first] - values[first]) if first.size else np.nan
    return out


# ---------------------------------------------------------------- recorded, error model


def _recorded(recording: Recording) -> dict[str, Values]:
    by_component = {}
    for component in recording.components():
        twin = recording.name("simulated", component=component)
        if twin is None:
            continue
        error = error_column(recording, component)
        units_of = [recording.manifest.columns[n].unit for n in (error, twin)]
        if units_of[0] != units_of[1]:
            raise DataError(f"twin: {component}: recorded in {units_of[0]}, simulated in {units_of[1]}")
        values = recording.array(twin)
        by_component[component] = Values(values, "the recording itself", {"empty": ~np.isfinite(values)})
    if not by_component:
        raise DataError("twin: the recording has no column of role simulated for any of its responses")
    return by_component


def _model(recording: Recording, model: ErrorModel) -> dict[str, Values]:
    from errpipe.fitting.components import evaluate

    columns = set(recording.frame.columns)
    absent = [name for name in model.columns if name not in columns]
    if absent:
        raise DataError(
            f"twin: the error model reads {absent[0]}, which the recording lacks.{did_you_mean(absent[0], columns)}"
        )
    for name, facts in model.columns.items():
        here_is = recording.manifest.columns[name]
        if (here_is.role, here_is.unit) != (facts["role"], facts.get("unit", here_is.unit)):
            raise DataError(
                f"twin: {name}: the error model means {facts['role']} in {facts.get('unit')}, the recording holds "
                f"{here_is.role} in {here_is.unit}"
            )
    present = recording.components()
    own = [c for c in model.components if c.component in present]
    if not own:
        wanted = ", ".join(c.component for c in model.components)
        raise DataError(f"twin: the error model has {wanted or 'nothing'}, the recording of {', '.join(present)}")
    values = evaluate(model.model_copy(update={"components": tuple(own)}), recording)
    for c in own:
        unit = recording.manifest.columns[error_column(recording, c.component)].unit or "um"
        if unit != c.unit:
            raise DataError(f"twin: {c.component}: recorded in {unit}, modelled in {c.unit}")
    return {
        name: Values(v, "an error model", {"lack an input of the model": ~np.isfinite(v)}, datum=model.datum)
        for name, v in values.items()
    }
