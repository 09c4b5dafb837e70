"""Deviation proportional to position times the change of air temperature or pressure."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import AIR_WORDS, mentions, sensors
from errpipe.terms._fields import Axis
from errpipe.terms._place import is_radial, linear_axes_acting
from errpipe.terms._slack import Slack


class AirRefraction(Term):
    """The laser wavelength was not corrected for the refractive index of air: every length reads wrong in proportion.

    Equation   deviation = x * (per_kelvin (T - 20) + per_hpa (p - 1013.25))   [um] = [m] * [um/m]
    Assumes    the air along the beam is as warm as its sensor
    Typical    0.93 um/m/K and -0.27 um/m/hPa, with either sign, depending on the measuring set-up
    Moves      all axes alike, with the weather
    Source     Edlen 1966; ISO 230-1 annex on laser interferometers
    """

    term: Literal["air_refraction"] = "air_refraction"
    axis: Axis
    sensor: str | None = Field(None, description="Column of the air's temperature.")
    pressure: str | None = Field(None, description="Column of the air's pressure.")
    family = "measurement"
    form = "any reference and end"
    rowwise = True
    compensable = False
    physical_constant = True
    artefact = "it is the air in the beam of the measuring laser, not the machine: correct the reading"
    simulated_log_odds = -12.0
    prior_log_odds = -4.0  # two sensors and a datum can fit most slopes

    def linear(self) -> tuple[Parameter, ...]:
        kelvin = Parameter("per_kelvin", "um/m/K", (0.5, 1.0), (-5.0, 5.0), "slope per kelvin of the air")
        hpa = Parameter("per_hpa", "um/m/hPa", (0.1, 0.3), (-2.0, 2.0), "slope per hectopascal")
        return tuple(p for p, on in ((kelvin, self.sensor), (hpa, self.pressure)) if on)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return tuple(n for n in (position_name(recording, self.axis), self.pressure, self.sensor) if n)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[AirRefraction]:
        airs: list[str | None] = [s for s in sensors(recording) if mentions(recording, s, AIR_WORDS)]
        columns = recording.manifest.columns
        pressures: list[str | None] = [n for n in recording.names("pressure") if not columns[n].location]
        for axis in () if is_radial(component) else linear_axes_acting(recording, component):
            for sensor in airs or [None]:
                for pressure in pressures or [None]:
                    if sensor or pressure:
                        yield cls(axis=axis, sensor=sensor, pressure=pressure)

    def _rises(self, recording: Recording) -> list[np.ndarray]:
        """Air temperature and pressure, less those that a laser is set to."""
        known = ((self.sensor, 20.0), (self.pressure, 1013.25))
        return [recording.array(column) - usual for column, usual in known if column]

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        length = position(recording, self.axis) * 1e-3
        return np.column_stack([length * rise for rise in self._rises(recording)])

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        x = position(recording, self.axis)
        yield x, 0.3  # unknown air state at which the laser was compensated
        for rise in self._rises(recording):  # the beam is as long as the way from where the laser was zeroed
            yield rise * 1e-3 * (np.nanmax(x) - np.nanmin(x)), 0.3
