"""Follows a measured temperature through a first-order lag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Lag
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Reference, Sensor
from errpipe.terms._place import is_radial, linear_axes_acting
from errpipe.terms._slack import Slack, start_states
from errpipe.terms._warm import REFERENCE, rise_driver, scaled, sensors


class ThermalLag(Term):
    """The part that moves is slower than its sensor: loops in the plane of deviation and temperature.

    Equation   tau dy/dt + y = T - T_ref;  deviation = gain * y          [um] = [um/K] * [K]
               with `along` the deviation is gain * y * x                [um] = [um/m/K] * [m] * [K]
    Assumes    one time constant, the same warming and cooling; in step with the sensor at the start
    Typical    time constant 600..15000 s, gain 1..10 um/K
    Moves      positive gain: the warmer, the further, late by about tau
    Source     lumped heat balance; Mares, Horejs, Havlik 2020 (transfer functions in the control)
    """

    term: Literal["thermal_lag"] = "thermal_lag"
    sensor: Sensor
    reference: Reference = REFERENCE
    along: str | None = Field(None, description="Axis along which the lagged temperature stretches; none: it shifts.")
    reports_as = "thermal_lag"
    family = "thermal"
    rowwise = True
    simulated_log_odds = -4.0

    def linear(self) -> tuple[Parameter, ...]:
        if self.along:
            return (Parameter("gain", "um/m/K", (5.0, 20.0), (-200.0, 200.0), "slope per kelvin"),)
        return (Parameter("gain", "um/K", (1.0, 10.0), (-200.0, 200.0), "shift per kelvin"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        return (Parameter("tau", "s", (600.0, 15000.0), (60.0, 100000.0), "time constant"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.sensor, position_name(recording, self.along)) if self.along else (self.sensor,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ThermalLag]:
        if not component.startswith("E"):
            return
        for sensor in sensors(recording):
            yield cls(sensor=sensor)
            for axis in () if is_radial(component) else linear_axes_acting(recording, component):
                yield cls(sensor=sensor, along=axis)

    def _driver(self, tau: float) -> Lag:
        return Lag(of=rise_driver(self.sensor, self.reference), tau_up=tau, tau_down=tau)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        slow = drive(self._driver(nonlinear[0]), recording)
        return (slow * position(recording, self.along) * 1e-3 if self.along else slow)[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield from start_states(recording, nonlinear[0], 0.4, 0.6)

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[ThermalLag]:
        """Shifts only: a scale that follows its sensor late is within what an expansion of the scale may depart."""
        return (term for term in cls.bind(recording, component) if not term.along)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (tau,) = self.nonlinear_values(parameters)
        gain = parameters["gain"]
        if self.along:
            return (Lowered(self._driver(tau), self.along, lambda x: gain * 1e-3 * np.asarray(x, dtype=float)),)
        return (Lowered(scaled(self._driver(tau), gain)),)
