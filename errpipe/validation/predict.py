"""What a controller would predict, row by row, with an interval and whether the model may speak there at all.

Causal: row k uses rows up to k of its own run only, so every run is evaluated by itself. A sensor that drops out
keeps its last value, as it does on a controller; before its first value nothing is predicted (deviation 0).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd
from pydantic import TypeAdapter

from errpipe.domain.driver import Driver
from errpipe.domain.error_model import ErrorModel, Validity
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate
from errpipe.fitting.validity import distance

_DRIVER: TypeAdapter[Driver] = TypeAdapter(Driver)
Evaluate = Callable[[Recording], Mapping[str, np.ndarray]]
INPUTS = (
    "position",
    "command",
    "velocity",
    "acceleration",
    "feed",
    "spindle_speed",
    "temperature",
    "pressure",
    "humidity",
    "force",
    "load",
    "depth_of_cut",
    "overhang",
    "cut_length",
    "coolant",
    "direction",
)


@dataclass(frozen=True)
class Predictor:
    """Anything that gives deviations for the rows of one run: a fitted model, a compiled table.

    evaluate: recording of one run -> component -> deviation, (rows,). half_width90: component -> half width of the
    90 % interval inside the box; widening90: added per range's width outside of it; growth90: its share more per unit
    predicted; factor90: its multiple from the inputs.
    """

    evaluate: Evaluate
    components: tuple[str, ...]
    validity: Validity = field(default_factory=Validity)
    half_width90: Mapping[str, float] = field(default_factory=dict)
    widening90: Mapping[str, float] = field(default_factory=dict)
    growth90: Mapping[str, float] = field(default_factory=dict)
    factor90: Mapping[str, Driver] = field(default_factory=dict)

    def half_width(self, component: str, alone: Recording, value: np.ndarray, far: np.ndarray) -> np.ndarray:
        """Half width of the 90 % interval per row of one run; NaN where none is known."""
        half = self.half_width90.get(component, np.nan) * (1.0 + self.growth90.get(component, 0.0) * np.abs(value))
        if component in self.factor90:
            factor = drive(self.factor90[component], alone)
            half = half * np.where(np.isfinite(factor), factor, 1.0)
        return half + self.widening90.get(component, 0.0) * far


def of_model(model: ErrorModel) -> Predictor:
    """The predictor of a fitted model."""
    return of_evaluator(lambda recording: evaluate(model, recording), model)


def of_evaluator(evaluator: Evaluate, model: ErrorModel) -> Predictor:
    """Another evaluator (of the compiled table) with the intervals and the validity box of the model behind it."""
    return Predictor(
        evaluator,
        tuple(c.component for c in model.components),
        model.validity,
        {c.component: c.half_width90 for c in model.components if c.half_width90 is not None},
        {c.component: c.widening90 for c in model.components},
        {c.component: c.growth90 for c in model.components},
        {c.component: _DRIVER.validate_python(c.factor90) for c in model.components if c.factor90 is not None},
    )


def predict(model: ErrorModel | Predictor, recording: Recording) -> pd.DataFrame:
    """One row per row of the recording, in order: run, time, and four columns per response.

    NAME_predicted, NAME_lower, NAME_upper (90 %), in the response's unit, and NAME_outside (1 outside the validity
    box). NAME is the response's column, or the component where the recording has no such response. Raises DataError
    where the recording lacks a column that the model reads.
    """
    source = of_model(model) if isinstance(model, ErrorModel) else model
    _all_there(source, recording)
    values = {c: np.zeros(len(recording)) for c in source.components}
    half = {c: np.full(len(recording), np.nan) for c in source.components}
    far = np.zeros(len(recording))
    run = recording.run_codes()
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        alone = recording.take(rows)
        far[rows] = distance(source.validity, alone)
        kept = held(alone)
        for component, found in source.evaluate(kept).items():
            values[component][rows] = found
            told = np.where(np.isfinite(found), found, 0.0)
            half[component][rows] = source.half_width(component, kept, told, far[rows])
    return _frame(source, recording, values, half, far)


def held(recording: Recording) -> Recording:
    """One run with every input's last value held over gaps, and time that never goes back."""
    changes = {}
    for role in INPUTS:
        for name in recording.names(role):
            column = recording.frame[name]
            if column.isna().any():
                changes[name] = column.ffill()
    time = recording.name("time")
    if time is not None:
        t = recording.frame[time].ffill().bfill().to_numpy(dtype=float)
        changes[time] = np.maximum.accumulate(t)
    return Recording(recording.manifest, recording.frame.assign(**changes)) if changes else recording


def _all_there(source: Predictor, recording: Recording) -> None:
    missing = sorted(set(source.validity.ranges) - set(recording.frame.columns))
    if missing:
        listed = ", ".join(missing)
        raise DataError(f"predict: the recording has no column {listed}, which the model reads")


def _frame(
    source: Predictor,
    recording: Recording,
    values: Mapping[str, np.ndarray],
    half: Mapping[str, np.ndarray],
    far: np.ndarray,
) -> pd.DataFrame:
    labels = np.asarray(recording.run_labels(), dtype=object)[recording.run_codes()]
    out: dict[str, np.ndarray] = {"run": labels, "time": recording.time()}
    for component in source.components:
        name = recording.name("error", component=component) or component
        told = np.where(np.isfinite(values[component]), values[component], 0.0)
        silent = ~np.isfinite(values[component])
        out[f"{name}_predicted"] = told
        out[f"{name}_lower"] = told - half[component]
        out[f"{name}_upper"] = told + half[component]
        out[f"{name}_outside"] = ((far > 0) | silent).astype(int)
    return pd.DataFrame(out)
