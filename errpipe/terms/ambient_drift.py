"""The machine follows the room temperature with a lag of hours."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Lag
from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter
from errpipe.terms._driven import Driven
from errpipe.terms._drivers import AIR_WORDS, REFERENCE, ROOM_WORDS, mentions, rise_driver, sensors
from errpipe.terms._fields import Reference, Sensor
from errpipe.terms._slack import Slack, difference_of_shape, start_states


class AmbientDrift(Driven):
    """The whole machine follows the room temperature with a lag of hours.

    Equation   tau dy/dt + y = T_room - T_ref;  deviation = gain * y       [um] = [um/K] * [K]
    Assumes    one time constant for the structure; in equilibrium with the room at the start
    Typical    1..6 um/K, tau 3000..40000 s
    Moves      a daily wave, delayed and attenuated
    Source     ISO 230-3 (environmental temperature variation error)
    """

    term: Literal["ambient_drift"] = "ambient_drift"
    sensor: Sensor
    reference: Reference = REFERENCE
    family = "thermal"
    form = "any start"
    rowwise = True
    gains = (Parameter("gain", "um/K", (1.0, 6.0), (-100.0, 100.0), "shift per kelvin of the room"),)
    searched = (Parameter("tau", "s", (3000.0, 40000.0), (1000.0, 200000.0), "time constant"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[AmbientDrift]:
        if is_deviation(component):
            room = [s for s in sensors(recording) if mentions(recording, s, ROOM_WORDS)]
            for sensor in room or [s for s in sensors(recording) if mentions(recording, s, AIR_WORDS)]:
                yield cls(sensor=sensor)

    def _driver(self, *nonlinear: float) -> Lag:
        (tau,) = nonlinear
        return Lag(of=rise_driver(self.sensor, self.reference), tau_up=tau, tau_down=tau)

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        yield from start_states(recording, nonlinear[0], 1.0, 1.0)
        for factor in (0.3, 3.0):  # thick walls have more than one time constant
            yield difference_of_shape(self.basis(recording, nonlinear[0] * factor)[:, 0], base[:, 0]), 0.2
