"""Periodic in axis position with the screw lead, or in angle with a worm or gear."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, response_share
from errpipe.terms import _orders as waves
from errpipe.terms._base import Parameter, Term
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import as_positioning, axes_acting, drive_periods, is_radial
from errpipe.terms._search import Estimates, Signals, Waves, of_encoder
from errpipe.terms._slack import Slack


class PitchCyclic(Term):
    """Periodic error of the screw ("drunken thread") or drive: period of the lead, of a tooth or of a turn.

    Equation   deviation(x) = sum over orders k of sine_k sin(k a) + cosine_k cos(k a),  a = 2 pi x / (k_1 period)
    Assumes    sampling finer than a quarter of the period, not synchronous with it; constant amplitude on the axis
    Typical    0.5..5 um; period 5..20 mm (the lead), of belts tooth and pulley, for rotary axes 360 deg / teeth
    Moves      positive sine: too far on the first half of each turn
    Source     ISO 230-2 (periodic positional error); Ni 1997, geometric errors
    """

    term: Literal["pitch_cyclic"] = "pitch_cyclic"
    axis: Axis
    radial: Radial = False
    orders: waves.Orders = (1.0,)
    also_of_positioning = True
    family = "geometric"
    rowwise = True
    on_both_axes = False
    searched = (Parameter("period", "mm", (2.5, 20.0), (0.5, 400.0), "length of the wave", search=Waves()),)

    def linear(self) -> tuple[Parameter, ...]:
        return waves.named(self.orders, "um", (0.5, 5.0), 100.0)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[PitchCyclic]:
        """One binding for each period that the manifest states, half the lead, a turn and its half, and one free."""
        for axis in axes_acting(recording, component):
            known, radial = recording.manifest.axis(axis), is_radial(component)
            stated = drive_periods(known)
            half = (known.screw_lead / 2,) if known is not None and known.screw_lead else ()
            turn = [p / k for p in waves.full_turn(recording, axis) for k in (1, 2)]  # a disc off centre, or oval
            for period in dict.fromkeys((*stated, *half, *turn)):
                yield cls(axis=axis, radial=radial, fixed={"period": period})
            yield cls(axis=axis, radial=radial)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """Several orders of one wave, as the mismatch shows them."""
        for axis in () if is_radial(component) else axes_acting(recording, as_positioning(component)):
            stated = drive_periods(recording.manifest.axis(axis))
            for period in waves.full_turn(recording, axis):  # a disc off centre and oval
                yield cls(axis=axis, orders=(1.0, 2.0), fixed={"period": period}), (period,)
            for period, orders, known in waves.visible_orders(recording, axis, signals, stated):
                if not of_encoder(recording, axis, period):
                    yield cls(axis=axis, orders=orders, fixed={"period": period} if known else {}), (period,)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        (period,) = nonlinear
        own = waves.columns(position(recording, self.axis), period, self.orders)
        return own * response_share(recording, self.axis, self.radial)[:, None]

    def log_prior_odds(self) -> float:
        return waves.log_prior_odds(self.orders, bool(self.fixed))

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        if not self.radial:
            alone = len(self.orders) == 1
            yield from waves.slack(base, position(recording, self.axis), nonlinear[0], alone)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (period,) = self.nonlinear_values(parameters)
        return (waves.lowered(self.axis, period, self.orders, parameters),)
