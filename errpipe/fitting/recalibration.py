"""Recalibration from little: a few probe readings correct a compiled model on line, within bounds.

    deviation(t) = model(t) + offset + gain error x model(t) / scale + late share x late running state

A Kalman filter on these three numbers (fewer where a driver is missing): the offset wanders, the two shares are
constants of the day. Each reading costs about forty multiplications; between readings nothing happens but the
uncertainty growing. Everything is causal: a row is predicted before a reading taken at that row is used.
A controller needs the constants of `spec()` and the model's own drivers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from pydantic import Field

from errpipe.domain import driver as d
from errpipe.domain.recording import Frozen, Recording
from errpipe.drivers.evaluation import drive
from errpipe.errors import DataError


class RecalibrationOptions(Frozen):
    """What may be wrong with a model in a new condition, and by how much. um unless said otherwise."""

    noise: float = Field(1.5, gt=0, description="Standard deviation of one reading.", json_schema_extra={"unit": "um"})
    offset: float = Field(3.0, gt=0, description="Of the offset at the start.", json_schema_extra={"unit": "um"})
    wander: float = Field(
        4.0,
        ge=0,
        description="Of the offset after one hour without a reading, beyond its start.",
        json_schema_extra={"unit": "um"},
    )
    gain: float = Field(
        3.0, ge=0, description="Of the gain error, per `scale` of the model's value.", json_schema_extra={"unit": "um"}
    )
    late: float = Field(8.0, ge=0, description="Of the late running state's share.", json_schema_extra={"unit": "um"})
    scale: float = Field(10.0, gt=0, description="Model value that counts as one.", json_schema_extra={"unit": "um"})
    tau: float = Field(900.0, gt=0, description="Lag of the late running state.", json_schema_extra={"unit": "s"})
    bound: float = Field(30.0, gt=0, description="The correction never exceeds it.", json_schema_extra={"unit": "um"})


@dataclass
class Filter:
    """State and covariance of one run. Plain arithmetic, as a controller would do it."""

    spread: np.ndarray
    wander: np.ndarray
    noise: float
    bound: float
    state: np.ndarray = field(init=False)
    covariance: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.state = np.zeros(self.spread.size)
        self.covariance = np.diag(self.spread**2)

    def wait(self, hours: float) -> None:
        """Let time pass."""
        self.covariance = self.covariance + np.diag(self.wander**2 * max(hours, 0.0))

    def correction(self, basis: np.ndarray) -> float:
        """What is added to the model, um, within the bound. basis: (states,)."""
        return float(np.clip(basis @ self.state, -self.bound, self.bound))

    def read(self, basis: np.ndarray, innovation: float) -> None:
        """Take one reading: innovation = reading - model - correction, um; anything not finite is ignored."""
        if not np.isfinite(innovation) or not np.isfinite(basis).all():
            return
        seen = self.covariance @ basis
        gain = seen / (basis @ seen + self.noise**2)
        self.state = self.state + gain * innovation
        self.covariance = self.covariance - np.outer(gain, seen)


@dataclass(frozen=True)
class Recalibration:
    """Which states there are, for a model whose values are known row by row."""

    options: RecalibrationOptions
    running: d.Driver | None = None

    def names(self) -> tuple[str, ...]:
        """The states in order."""
        return ("offset", "gain", "late") if self.running is not None else ("offset", "gain")

    def basis(self, recording: Recording, model: np.ndarray) -> np.ndarray:
        """Factor of each state, shape (rows, states)."""
        columns = [np.ones(model.size), model / self.options.scale]
        if self.running is not None:
            tau = self.options.tau
            columns.append(drive(d.Lag(of=self.running, tau_up=tau, tau_down=tau, start="zero"), recording))
        return np.column_stack(columns)

    def start(self) -> Filter:
        """A filter at the start of a run."""
        o = self.options
        spread = np.array([o.offset, o.gain, o.late])[: len(self.names())]
        wander = np.array([o.wander, 0.0, 0.0])[: len(self.names())]
        return Filter(spread, wander, o.noise, o.bound)

    def spec(self) -> dict[str, Any]:
        """Constants and states as plain data: everything a controller needs beside the model's drivers."""
        start = self.start()
        return {
            "recalibration": 1,
            "states": [
                {"name": n, "start": 0.0, "spread_um": float(s), "wander_um_per_sqrt_h": float(w)}
                for n, s, w in zip(self.names(), start.spread, start.wander, strict=True)
            ],
            "noise_um": self.options.noise,
            "bound_um": self.options.bound,
            "scale_um": self.options.scale,
            "late_running": None if self.running is None else self.running.model_dump(mode="json"),
            "late_tau_s": self.options.tau,
        }


def apply(
    recording: Recording, model: np.ndarray, deviation: np.ndarray, readings: np.ndarray, how: Recalibration
) -> np.ndarray:
    """The model corrected by readings, um, shape (rows,); a row is predicted before its own reading is used.

    model, deviation: (rows,), um, from the same zero; readings: mask of rows at which the deviation was probed.
    Raises DataError where shapes differ.
    """
    if not (model.shape == deviation.shape == readings.shape == (len(recording),)):
        raise DataError("recalibration: model, deviation and readings must have one value per row")
    basis = how.basis(recording, model)
    run, t = recording.run_codes(), recording.time()
    out = np.array(model, dtype=float)
    for code in dict.fromkeys(run):
        rows = np.flatnonzero(run == code)
        state, before = how.start(), t[rows[0]]
        for row in rows:
            state.wait((t[row] - before) / 3600.0)
            before = t[row]
            out[row] = model[row] + state.correction(basis[row])
            if readings[row]:
                state.read(basis[row], deviation[row] - out[row])
    return out


def schedule(recording: Recording, every: float, first: float | None = None) -> np.ndarray:
    """Mask of the rows probed: one every `every` s of each run, the first after half of that (or `first` s)."""
    run, t = recording.run_codes(), recording.time()
    out = np.zeros(len(recording), dtype=bool)
    for code in dict.fromkeys(run):
        rows = np.flatnonzero(run == code)
        due = every / 2 if first is None else first
        for row in rows:
            if t[row] - t[rows[0]] >= due:
                out[row] = True
                due += every
    return out


def residual_by_readings(
    recording: Recording,
    model: np.ndarray,
    deviation: np.ndarray,
    how: Recalibration,
    intervals: Sequence[float] = (14400.0, 7200.0, 3600.0, 1800.0, 900.0),
    groups: np.ndarray | None = None,
) -> list[dict[str, Any]]:
    """rms per group against readings a run: with the model and, for comparison, with readings alone (model 0). um.

    groups: label per row (seasons); one group where not given. The first entry has no readings.
    """
    labels = np.full(len(recording), "all") if groups is None else np.asarray(groups)
    runs = len(recording.run_labels())
    out = []
    free = Recalibration(how.options.model_copy(update={"bound": 1e6}), how.running)
    for every in (None, *intervals):
        probed = np.zeros(len(recording), dtype=bool) if every is None else schedule(recording, every)
        told = apply(recording, model, deviation, probed, how)
        alone = apply(recording, np.zeros_like(model), deviation, probed, free)
        for label in dict.fromkeys(labels):
            mine = (labels == label) & np.isfinite(deviation - told)
            out.append(
                {
                    "group": str(label),
                    "every_s": every,
                    "readings_per_run": float(probed.sum() / runs),
                    "rms": _rms((deviation - told)[mine]),
                    "rms_readings_alone": _rms((deviation - alone)[mine]),
                }
            )
    return out


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
