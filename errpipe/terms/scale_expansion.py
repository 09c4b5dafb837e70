"""Slope along the axis proportional to a temperature rise."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name, response_share
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import REFERENCE, rise_driver, sensors
from errpipe.terms._fields import Axis, Radial, Reference, Sensor
from errpipe.terms._place import is_radial, linear_axes_acting
from errpipe.terms._slack import Slack, bent, lagged


class ScaleExpansion(Term):
    """Deviation proportional to position and to a temperature rise: the scale or screw gets longer.

    Equation   deviation(x, T) = coefficient * x * (T - T_ref)      [um] = [um/m/K] * [m] * [K]
    Assumes    one temperature for the whole scale, fixed at x = 0; no delay (else `thermal_lag`)
    Typical    5..20 um/m/K; steel near 11.5, glass near 8
    Moves      positive coefficient: on a warm scale the marks lie further apart, the axis travels past its target
    Source     ISO 230-3; Ni 1997, equation of the position-dependent thermal error
    """

    term: Literal["scale_expansion"] = "scale_expansion"
    axis: Axis
    sensor: Sensor
    reference: Reference = REFERENCE
    radial: Radial = False
    family = "thermal"
    form = "any reference and end"
    rowwise = True
    gains = (Parameter("coefficient", "um/m/K", (5.0, 20.0), (-100.0, 100.0), "growth per metre and kelvin"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (position_name(recording, self.axis), self.sensor)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ScaleExpansion]:
        for axis in linear_axes_acting(recording, component):
            for sensor in sensors(recording):
                yield cls(axis=axis, sensor=sensor, radial=is_radial(component))

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        rise = drive(rise_driver(self.sensor, self.reference), recording)
        column = position(recording, self.axis) * (1e-3 * response_share(recording, self.axis, self.radial))
        column *= rise  # in place: new memory for each product costs as much as the product
        return column[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if self.radial:
            return
        x = position(recording, self.axis)
        yield x, 0.7
        # the growth is counted from the fixed end, wherever that is
        yield drive(rise_driver(self.sensor, self.reference), recording) * 1e-3 * (np.nanmax(x) - np.nanmin(x)), 0.3
        yield from bent(base[:, 0], x)
        rise = recording.array(self.sensor)
        for tau, most in ((400.0, 0.05), (1500.0, 0.2)):
            yield (lagged(recording, rise, tau, most) - rise) * x, 0.3

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        slope = parameters["coefficient"] * 1e-3
        driver = rise_driver(self.sensor, self.reference)
        return (Lowered(driver, self.axis, lambda x: slope * np.asarray(x, dtype=float)),)
