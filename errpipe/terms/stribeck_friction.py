"""Drive force that falls with speed near standstill."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.domain.driver import Product
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, moving
from errpipe.terms._base import Parameter
from errpipe.terms._driven import OfVelocity
from errpipe.terms._drivers import curve, scaled, sign
from errpipe.terms._search import Speeds
from errpipe.terms._slack import AT_STANDSTILL, Slack, difference_of_shape, gradual_reversal

FADES = Speeds(fades=True)


class StribeckFriction(OfVelocity):
    """Stribeck friction: boundary friction at creep speed, which falls as an oil film builds up with speed.

    Equation   force = extra * sign(v) * exp(-(|v| / v_s)^2)         [N]
    Assumes    no time constant (steady sliding)
    Typical    5..150 N, v_s 0.5..20 mm/s
    Moves      positive extra: more force at creep than at speed
    Source     Stribeck 1902; Armstrong-Helouvry 1994
    """

    term: Literal["stribeck_friction"] = "stribeck_friction"
    friction_part = "falling"
    gains = (Parameter("extra", "N", (5.0, 150.0), (-5000.0, 5000.0), "excess force at creep", at_largest=True),)
    searched = (Parameter("v_s", "mm/s", (0.5, 20.0), (0.1, 100.0), "speed at which the dry part has gone", FADES),)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        v = recording.array(self.column)
        return (moving(recording, self.column) * np.exp(-((v / nonlinear[0]) ** 2)))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        v = recording.array(self.column)
        # as Tustin's and Armstrong-Helouvry's: it falls more steeply at first, then more slowly
        for power in (1.0, 0.5):
            slower = moving(recording, self.column) * np.exp(-(np.abs(v / nonlinear[0]) ** power))
            yield difference_of_shape(slower, base[:, 0]), 0.5
        side = direction(recording, self.axis)
        yield side * np.exp(-((v / nonlinear[0]) ** 2)) - base[:, 0], AT_STANDSTILL
        if recording.name("position", axis=self.axis) is not None:
            yield from gradual_reversal(base[:, 0], recording, self.axis)  # bristles bend before they slide

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (v_s,) = self.nonlinear_values(parameters)
        falling = curve(self.column, lambda v: np.exp(-((v / v_s) ** 2)), 6 * v_s)
        return (Lowered(scaled(Product(of=(sign(self.column), falling)), parameters["extra"])),)
