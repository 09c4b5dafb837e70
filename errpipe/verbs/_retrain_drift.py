"""Drift since the champion was fitted: sensors, its residual, single runs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.operations import LARGEST_NUMBER
from errpipe.domain.recording import Recording
from errpipe.errors import VerifyError
from errpipe.fitting.components import evaluate
from errpipe.validation import input_drift, outlying_runs, response_drift, retraining
from errpipe.validation.what_changed import changed_again, what_changed

MIN_SLOPE = 1.0  # 1/K2: a run tells a sensor's error to 1 K (a standard error of 1/sqrt(slope)), or does not count


def predictions(model: ErrorModel, recording: Recording) -> dict[str, np.ndarray]:
    """Component -> the model's deviation on every row, um; last inputs are held over gaps, 0 where nothing is known."""
    frame = recording.frame
    gaps = [name for name in model.columns if name in frame.columns and frame[name].isna().any()]
    if gaps:
        frame = frame.assign(**frame[gaps].groupby(recording.run_codes()).ffill())
    predicted = evaluate(model, Recording(recording.manifest, frame, recording.between))
    known = {component: np.nan_to_num(values) for component, values in predicted.items()}
    for component, values in known.items():
        if np.abs(values).max(initial=0.0) > LARGEST_NUMBER:
            raise VerifyError(
                f"the champion's {component} predicts more than {LARGEST_NUMBER:g} um: its file was changed"
            )
    return known


def runs_without_readings(model: ErrorModel, recording: Recording) -> dict[str, list[str]]:
    """Column that a model reads -> labels of the runs in which it holds no reading; only such columns."""
    run, labels, out = recording.run_codes(), recording.run_labels(), {}
    for name in (n for n in model.columns if n in recording.frame and recording.manifest.columns[n].unit):
        with_reading = set(run[np.isfinite(recording.array(name))].tolist())
        if runs := [label for code, label in enumerate(labels) if code not in with_reading]:
            out[name] = runs
    return out


def drift(model: ErrorModel, old: Recording, recording: Recording, known: frozenset[str]) -> dict[str, Any]:
    """Drift of inputs (which sensor), of the champion's residual and of the size of a response, each with since when.

    The reference is what the champion was fitted on, also where those runs are no longer kept with the new ones.
    """
    both, reference = with_new_runs(old, recording, known)
    if both is not None:  # no prediction where a sensor is silent: the residual there is no change of the machine
        lacking = {label for runs in runs_without_readings(model, both).values() for label in runs}
        complete = ~np.isin(np.asarray(both.run_labels())[both.run_codes()], list(lacking))
        both, reference = (
            (both.take(complete), reference[complete]) if (complete & ~reference).any() else (None, reference)
        )
    if both is None:
        return {"inputs": [], "residuals": [], "sizes": [], "rms": [], "changes": [], "runs": []}
    outliers, single = _outlying_runs(model, both, reference)
    labels = np.asarray(both.run_labels())[both.run_codes()]
    sound = ~np.isin(labels, single)
    both, reference = both.take(sound), reference[sound]
    prediction = predictions(model, both)
    apparent = _apparent_errors(model, both, prediction, reference)
    moved = response_drift.drifts(both, reference, prediction)
    sensors = [asdict(d) for d in input_drift.sensor_drift(both, reference, apparent)]
    read = [d["column"] for d in sensors if d["flagged"] and d["column"] in model.columns]
    if read:  # what the champion predicts is wrong, not what was measured
        meaning = {"meaning": f"it predicts by {read[0]}, which drifts"}
        moved["sizes"] = [s | meaning if s["meaning"] else s for s in moved["sizes"]]
    wrong = any(s["meaning"] for s in moved["sizes"])
    changes = [] if read or wrong else _changes(model, both, reference, prediction, moved)
    return {"inputs": sensors, **moved, "changes": changes, "runs": outliers}


def _outlying_runs(model: ErrorModel, both: Recording, reference: np.ndarray) -> tuple[list[dict[str, Any]], list[str]]:
    """New runs that are outliers, and the labels of those that are no evidence of a lasting change.

    Deviations that are outliers up to the last run are a lasting change: these stay; runs with wrong sensors do not.
    """
    sensors = outlying_runs.outliers_of_sensors(both, reference)
    wrong = [o.run for o in sensors]
    responses = outlying_runs.outliers_of_responses(both, reference, predictions(model, both), wrong)
    last = both.run_labels()[-1]
    lasting = {(o.what, o.says) for o in responses if o.run == last}
    single = [o for o in responses if (o.what, o.says) not in lasting]
    return [asdict(o) for o in (*sensors, *single)], [*wrong, *(o.run for o in single)]


def _changes(model, both, reference, prediction, moved) -> list[dict[str, Any]]:
    """Terms of the model that changed, for every component with a changed residual, since the first affected run.

    Where the machine changed twice it is since the second time: challengers are fitted on the runs of one machine.
    """
    labels, run, out = both.run_labels(), both.run_codes(), []
    for part in model.components:
        signs = [[m for m in moved[key] if m["component"] == part.component] for key in ("residuals", "sizes", "rms")]
        seen = [*signs[0], *signs[1]] or signs[2]  # of a moved level or size, the rms is the later sign
        if not seen:
            continue
        residual = both.array(str(both.name("error", component=part.component))) - prediction[part.component]
        first = max(labels.index(m["since"]) for m in seen)  # the level and the size may be dated a run apart
        first += changed_again(model, part, both, residual, reference, first)
        since = run >= first
        noise = float(np.sqrt(np.nanmean(residual[reference] ** 2)))
        terms = what_changed(model, part, both.take(since), residual[since], noise)
        entry = {"component": part.component, "since": labels[first], "unit": part.unit}
        out.append({**entry, "terms": [asdict(t) for t in terms]})
    return [e for e in out if e["terms"]]


def _apparent_errors(model: ErrorModel, recording: Recording, prediction, reference) -> dict[str, np.ndarray]:
    """Column -> how far, per run, the sensor would be off if it alone explained the champion's residual, K.

    Least squares of the residual on the prediction's change per kelvin; columns that the champion does not read, or
    whose constant offset it does not show, are left out.
    """
    run = recording.run_codes()
    measured = {c: recording.name("error", component=c) for c in prediction}
    residual = {c: recording.array(name) - prediction[c] for c, name in measured.items() if name is not None}
    out = {}
    for column in (n for n in recording.names("temperature") if n in model.columns):
        warmer = predictions(model, recording.with_columns({column: recording.array(column) + 1.0}, {}))
        above, below = np.zeros(len(recording)), np.zeros(len(recording))
        for component, left in residual.items():
            known, noise = np.isfinite(left), float(np.nanstd(left[reference]))
            slope = np.where(known, warmer[component] - prediction[component], 0.0) / max(noise, 1e-9)
            above, below = above - slope * np.where(known, left, 0.0) / max(noise, 1e-9), below + slope**2
        by_run, weight = np.bincount(run, above), np.bincount(run, below)
        if np.any(weight > MIN_SLOPE):
            out[column] = np.where(weight > MIN_SLOPE, by_run / np.maximum(weight, MIN_SLOPE), np.nan)
    return out


def with_new_runs(old: Recording, recording: Recording, known: frozenset[str]) -> tuple[Recording | None, np.ndarray]:
    """The champion's recording followed by the runs that it did not see, and which rows are the champion's."""
    keys = retraining.run_keys(recording)
    new = np.isin(recording.run_codes(), [c for c, key in enumerate(keys) if key not in known])
    both = _joined(old, recording.take(new))
    return both, np.arange(0 if both is None else len(both)) < len(old)


def _joined(old: Recording, new: Recording) -> Recording | None:
    """Two recordings as one, the runs of the first relabelled; None where they share no columns."""
    run = old.name("run")
    names = [n for n in old.frame.columns if n in new.frame.columns]
    if run is None or run not in names or len(new) == 0:
        return None
    frame = pd.concat([old.frame[names], new.frame[names]], ignore_index=True)
    label = [f"{label} (champion)" for label in old.frame[run]] + list(new.frame[run])
    kept = {name: column for name, column in old.manifest.columns.items() if name in names}
    manifest = old.manifest.model_copy(update={"columns": kept})
    return Recording(manifest, frame.assign(**{run: label}))
