"""Offset proportional to one temperature rise, at once."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Affine
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.terms._drivers import REFERENCE, rise_driver, sensors
from errpipe.terms._fields import Reference, Sensor
from errpipe.terms._slack import Slack, lagged


class ThermalDrift(Driven):
    """A part of the structure expands with its temperature and shifts the tool: an offset that follows a sensor.

    Equation   deviation(T) = gain * (T - T_ref)                    [um] = [um/K] * [K]
    Assumes    the sensor reads the temperature of the part, without delay (else `thermal_lag`)
    Typical    1..10 um/K
    Moves      positive gain: the warmer, the further in the positive direction
    Source     Ni 1997, thermal errors; ISO 230-3
    """

    term: Literal["thermal_drift"] = "thermal_drift"
    sensor: Sensor
    reference: Reference = REFERENCE
    family = "thermal"
    rowwise = True
    one_sensor = True
    gains = (Parameter("gain", "um/K", (1.0, 10.0), (-200.0, 200.0), "shift per kelvin"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ThermalDrift]:
        if is_deviation(component):
            for sensor in sensors(recording):
                yield cls(sensor=sensor)

    def _driver(self, *nonlinear: float) -> Affine:
        return rise_driver(self.sensor, self.reference)

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        rise = recording.array(self.sensor)
        yield lagged(recording, rise, 300.0, 0.05) - rise, 0.2
