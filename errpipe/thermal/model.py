"""A fitted thermal model: one sum of drivers since the start of the run, with its interval, and its error model."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.domain import driver as d
from errpipe.domain.driver import inputs
from errpipe.domain.error_model import ComponentModel, ErrorModel, Validity
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.shared import drive_all
from errpipe.fitting.validity import distance
from errpipe.terms import fitted_term
from errpipe.terms.profile_driver import ProfileDriver
from errpipe.thermal.interval import Intervals
from errpipe.thermal.season_options import SeasonOptions

Part = tuple[str, float, d.Driver]  # a cause: its name, its gain in um/K, its driver in K


@dataclass(frozen=True)
class Prediction:
    """Per row, um: deviation since the start of the run, interval; outside is True outside of the fitted range."""

    predicted: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    outside: np.ndarray


@dataclass(frozen=True)
class ThermalModel:
    """A fitted model. `terms` is what a table compiles: their sum is the deviation since the start of the run.

    parts: the same, cause by cause and without fade and limit, for the report. factor: of the interval
    (`thermal.interval`). fade: K, see the options.
    datum: mean and standard deviation of the runs' zeros, um: uncertainty of the start of a new run.
    """

    component: str
    options: SeasonOptions
    parts: tuple[Part, ...]
    terms: tuple[tuple[float, d.Driver], ...]
    intervals: Intervals
    factor: d.Driver
    validity: Validity
    fade: float
    limit: tuple[float, float]
    datum: tuple[float, float]
    report: dict[str, Any] = field(default_factory=dict)

    def values(self, recording: Recording) -> np.ndarray:
        """Deviation since the start of the run, um, shape (rows,); causal, every run separately."""
        gains = np.array([gain for gain, _ in self.terms])
        return drive_all([node for _, node in self.terms], recording.each_run_alone()) @ gains

    def predict(self, recording: Recording) -> Prediction:
        """Deviation since the start of each run with its interval, um; row k uses rows up to k of its run."""
        recording = recording.each_run_alone()
        value = self.values(recording)
        away = distance(self.validity, recording)
        half = self.intervals.half_width(value, drive(self.factor, recording), away)
        return Prediction(value, value - half, value + half, away > 0.0)

    def component_model(self) -> ComponentModel:
        """As an error model's component: one term per driver, with the figures of the report."""
        unit = components.unit(self.component)  # of an angle at the tool urad: no axis turns by it
        terms = tuple(fitted_term(ProfileDriver(driver=(node,)), [gain], unit) for gain, node in self.terms)
        return ComponentModel(
            component=self.component,
            unit=unit,
            terms=terms,
            rows=self.report["rows"],
            rms_before=self.report["rms_before"],
            rms_after=self.report["rms_after"],
            half_width90=self.intervals.unknown,
            growth90=self.intervals.growth,
            factor90=self.factor.model_dump(mode="json"),
            widening90=self.intervals.widening,
            limit=max(abs(self.limit[0]), abs(self.limit[1])),
        )

    def error_model(self, recording: Recording) -> ErrorModel:
        """As an error model of one component; `recording` gives machine, title and the columns' entries."""
        read = (name for _, node in self.terms for name in inputs(node))  # a spindle's state reads its speed
        names, unit = dict.fromkeys([*self.validity.ranges, *sorted(read)]), components.unit(self.component)
        notes = (
            "counts from the start of each run: temperatures do not show where the probe was zeroed "
            f"(zeros seen: {self.datum[0]:.1f} {unit}, standard deviation {self.datum[1]:.1f} {unit})",
        )
        return ErrorModel.of(
            recording.manifest,
            names,
            components=(self.component_model(),),
            validity=self.validity,
            datum="run_start",
            notes=notes,
        )
