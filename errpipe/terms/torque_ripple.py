"""Drive force periodic in position."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position
from errpipe.terms import _orders as waves
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis
from errpipe.terms._place import drive_periods, driven_axes, pole_periods
from errpipe.terms._search import Estimates, Signals, Waves
from errpipe.terms._slack import Slack


class TorqueRipple(Term):
    """Force ripple of the motor (cogging, commutation): a force that is periodic in position.

    Equation   force = sum over orders k of sine_k sin(k a) + cosine_k cos(k a),  a = 2 pi x / (k_1 period)   [N]
    Assumes    the same ripple at every speed
    Typical    2..50 N; the period is that of a pole pair, orders 2, 6 and 12 for slots, often not the screw's lead
    Moves      with position alone, not with time
    Source     cogging torque of permanent-magnet motors
    """

    term: Literal["torque_ripple"] = "torque_ripple"
    axis: Axis
    orders: waves.Orders = (1.0,)
    family = "friction"
    compensable = False
    searched = (Parameter("period", "mm", (1.0, 60.0), (0.2, 200.0), "length of the wave", search=Waves()),)

    def linear(self) -> tuple[Parameter, ...]:
        return waves.named(self.orders, "N", (2.0, 50.0), 1000.0)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[TorqueRipple]:
        """One binding for each period that the manifest states, and one with the period free."""
        for axis in driven_axes(recording, component):
            for period in stated(recording, axis):
                yield cls(axis=axis, fixed={"period": period})
            yield cls(axis=axis)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """Several orders of one wave, as the mismatch shows them."""
        for axis in driven_axes(recording, component):
            for period, orders, known in waves.visible_orders(recording, axis, signals, stated(recording, axis)):
                yield cls(axis=axis, orders=orders, fixed={"period": period} if known else {}), (period,)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return waves.columns(position(recording, self.axis), nonlinear[0], self.orders)

    def log_prior_odds(self) -> float:
        return waves.log_prior_odds(self.orders, bool(self.fixed))

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        alone = not self.fixed and len(self.orders) == 1
        return waves.slack(base, position(recording, self.axis), nonlinear[0], alone)

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (period,) = self.nonlinear_values(parameters)
        return (waves.lowered(self.axis, period, self.orders, parameters),)


def stated(recording: Recording, axis: str) -> tuple[float, ...]:
    """Periods of the axis' drive and motor that the manifest states, and one turn of a rotary axis."""
    known = recording.manifest.axis(axis)
    return tuple(dict.fromkeys((*pole_periods(known), *drive_periods(known), *waves.full_turn(recording, axis))))
