"""Recalibration by a few readings of the deviation itself: a probe on a datum, the first hole of a part.

    deviation(t) = model(t) + share x (last reading - model when it was taken)

The term with `share` is held until the next reading. `share` is the slope of the present residual on the residual
at the last reading (lag regression through zero), within 0..1: 0 if a reading does not predict later rows, 1
if the residual does not change. It depends on how often readings come, and is estimated from held-out rows, never
from fitted rows. A Kalman filter of offset, gain error and late heat, with eight constants, was little
better on held-out seasons of a turning centre; at 1, 2, 4, 8, 16 readings in 8 h: winter 6.8, 3.5, 2.7, 2.2, 1.9 um
(this: 6.3, 3.5, 3.1, 2.5, 2.1), spring 3.3, 2.7, 2.6, 2.0, 1.7 um (this: 3.4, 2.7, 2.7, 1.9, 1.7).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain.error_model import DatumReadings, ErrorModel
from errpipe.domain.recording import Recording
from errpipe.errors import GateError
from errpipe.fitting.statistics import rms

SHIFT = 28800.0  # s: eight hours
PER_SHIFT = (1, 2, 4, 8, 16)  # readings per shift compared in the report
MISSED = 2.0  # intervals: a reading is held if the next one is missed, then expires (by judgement)
MIN_IMPROVEMENT = 0.01  # share of the held-out error that readings must remove (by judgement)
PLAUSIBLE = 2.0  # of the largest error on held-out rows: readings further from the model are rejected (by judgement)


def is_thermal(recording: Recording) -> bool:
    """Whether a recording is a run over time: temperatures and a clock, and no moving axis."""
    places = recording.names("position") + recording.names("command")
    moving = [n for n in places if np.nanmax(recording.array(n)) > np.nanmin(recording.array(n))]
    return bool(recording.names("time") and recording.names("temperature") and not moving)


def schedule(recording: Recording, every: float) -> np.ndarray:
    """Mask of the rows probed, shape (rows,): one every `every` s of each run, the first after half of that."""
    run, t = recording.run_codes(), recording.time()
    out = np.zeros(len(recording), dtype=bool)
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        due = every / 2
        for row in rows:
            if t[row] - t[rows[0]] >= due:
                out[row] = True
                due = t[row] - t[rows[0]] + every
    return out


def last_reading(run: np.ndarray, values: np.ndarray, probed: np.ndarray) -> np.ndarray:
    """The last probed finite value of the same run before each row; 0 before the first. Shape (rows,).

    run: code per row; values: the readings, NaN if missing; probed: mask. A reading is not
    used for its own row.
    """
    out = np.zeros(values.size)
    for code in np.unique(run):
        rows = np.flatnonzero(run == code)
        taken = np.where(probed[rows] & np.isfinite(values[rows]), np.arange(rows.size), -1)
        before = np.r_[-1, np.maximum.accumulate(taken)[:-1]]
        out[rows] = np.where(before >= 0, values[rows][np.maximum(before, 0)], 0.0)
    return out


def share_of(left: Sequence[np.ndarray], last: Sequence[np.ndarray]) -> float:
    """Slope through zero of the residual on the residual at the last reading, 0..1; 0 without any reading.

    left, last: per group, shape (rows of the group,), um.
    """
    squares = sum(float(np.sum(b**2)) for b in last)
    products = sum(float(a @ b) for a, b in zip(left, last, strict=True))
    return float(np.clip(products / squares, 0.0, 1.0)) if squares else 0.0


def by_readings(
    recording: Recording,
    rows: Sequence[np.ndarray],
    labels: Sequence[str],
    before: Sequence[np.ndarray],
    left: Sequence[np.ndarray],
) -> dict[str, Any]:
    """rms on held-out groups against readings per shift, with the model and, for comparison, with readings alone.

    rows, before, left: per group its row numbers, the deviation, and the residual of the model, um. The rows that are
    probed are rows of the recording, with its noise. A group is validated with the share of the other groups;
    `share` is that of all. Schedules that would probe more than half of the rows are omitted.
    """
    run, levels = recording.run_codes(), []
    for number in (0, *PER_SHIFT):
        probed = schedule(recording, SHIFT / number) if number else np.zeros(len(recording), dtype=bool)
        if number and np.mean(probed) > 0.5:
            break
        runs, at_reading = [run[r] for r in rows], [probed[r] for r in rows]
        share, after = _after_readings(runs, left, at_reading)
        residuals = {"rms": after, "rms_readings_alone": _after_readings(runs, before, at_reading)[1]}
        levels.append(
            {"per_shift": number, "share": share}
            | {name: rms(np.concatenate(after)) for name, after in residuals.items()}
            | {"groups": [{"label": g} | {n: rms(a[k]) for n, a in residuals.items()} for k, g in enumerate(labels)]}
        )
    bound = PLAUSIBLE * max(float(np.abs(v).max()) for v in left)
    return {"shift_h": SHIFT / 3600.0, "bound": bound, "levels": levels}


def _after_readings(
    runs: Sequence[np.ndarray], values: Sequence[np.ndarray], probed: Sequence[np.ndarray]
) -> tuple[float, list[np.ndarray]]:
    """The share of a reading over all groups, and the residual of each group with the share of the others, um.

    runs, values, probed: per group, shape (rows of the group,): run, value in um, whether the row is probed.
    """
    last = [last_reading(*group) for group in zip(runs, values, probed, strict=True)]

    def left_with_others(k: int) -> np.ndarray:
        others = [j for j in range(len(values)) if j != k]
        return values[k] - share_of([values[j] for j in others], [last[j] for j in others]) * last[k]

    return share_of(values, last), [left_with_others(k) for k in range(len(values))]


def with_readings(model: ErrorModel, validations: Sequence[Mapping[str, Any]], per_shift: int) -> ErrorModel:
    """The model with a share for readings in each component that they improve on held-out groups.

    validations: documents of `validation.json`; the smallest share among them is used. Raises GateError if no
    validation includes readings, or if they improve no component.
    """
    out, why = [], []
    for component in model.components:
        figures = [c for v in validations for c in v["components"] if c["component"] == component.component]
        judged = [c["readings"] for c in figures if c.get("readings")]
        levels = [(j, level) for j in judged for level in j["levels"] if level["per_shift"] == per_shift]
        if not levels:
            why.append(f"{component.component}: no validation includes {per_shift} readings per shift")
        elif any(level["rms"] > j["levels"][0]["rms"] * (1.0 - MIN_IMPROVEMENT) for j, level in levels):
            why.append(f"{component.component}: held-out rows were not better with {per_shift} readings per shift")
        else:
            share, bound = min(level["share"] for _, level in levels), min(j["bound"] for j, _ in levels)
            readings = DatumReadings(share=share, hold_s=MISSED * SHIFT / per_shift, bound=bound)
            component = component.model_copy(update={"readings": readings})
        out.append(component)
    if all(c.readings is None for c in out):
        raise GateError(f"export: readings_per_shift: {'; '.join(why)}")
    return model.model_copy(update={"components": tuple(out)})
