"""A short transient after each velocity reversal, larger at higher feed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Affine, Direction, Driver, Input, Lag, Power, Product
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import direction, direction_column, position, response_share
from errpipe.drivers.sessions import sessions
from errpipe.kernels.events import since_turn
from errpipe.terms._base import Example, Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._example import first_binding, rows
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, driven_axes, is_radial
from errpipe.terms._search import Listed, Times
from errpipe.terms._slack import Slack

MAX_SHARE_OF_TURN = 1 / 3  # of the time between turns: a longer one is a step between directions
AT_REST = 0.1  # of the highest speed of a run: slower, it begins where the axis turns
# Travels over which bristles bend and the spike rises, in those within its time constant (chosen on a two-mass drive
# with LuGre friction and trials/first 71101)
RISES = (0.05, 0.3)
NEAR = 0.3  # of the time constant: rows from which that travel is taken


@dataclass(frozen=True)
class DecayBeforeNextReversal(Times):
    """A time constant, from the sampling step to a third of the time between two turns of the axis within a run."""

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """Smallest and largest value that the recording resolves."""
        low, high = super().limits(term, recording)
        t, run = recording.time(), recording.run_codes()
        turns = np.r_[True, (np.diff(direction(recording, term.axis)) != 0) | (np.diff(run) != 0)]
        first = np.flatnonzero(turns)
        between = (t[np.r_[first[1:], t.size] - 1] - t[first])[np.cumsum(turns) - 1]
        # of the median row: at rest the sign may alternate, and what passes between runs is no travel
        return low, max(low, min(high, MAX_SHARE_OF_TURN * float(np.median(between))))


class ReversalSpike(Term):
    """At a reversal the drive sticks for an instant: a short spike of the deviation or the force.

    Equation   deviation = -height * d * (F / 1000 mm/min)^power * exp(-s / tau), s = time since the reversal
    Assumes    static friction at each reversal; the position loop removes the spike
    Typical    2..15 um, tau 5..50 ms
    Moves      positive height: the axis lags behind its command after the reversal
    Source     quadrant glitches of circular tests, ISO 230-4
    """

    term: Literal["reversal_spike"] = "reversal_spike"
    axis: Axis
    feed: str | None = Field(None, description="Column of the feed that the spike's size follows.")
    radial: Radial = False
    from_start: bool = Field(False, description="Do runs that begin where the axis turns begin with a spike?")
    family = "reversal"
    in_part = "runs"
    form = "any rise"
    gains = (Parameter("height", "um", (2.0, 15.0), (-200.0, 200.0), "height of the spike (at 1000 mm/min)"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        tau = Parameter(
            "tau", "s", (0.005, 0.05), (0.001, 1.0), "time in which it dies away", DecayBeforeNextReversal()
        )
        power = Parameter("power", "1", (0.0, 1.0), (0.0, 2.0), "growth with feed", Listed((0.0, 0.5, 1.0)))
        return (tau, power) if self.feed else (tau,)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        names = (direction_column(recording, self.axis), recording.name("velocity", axis=self.axis), self.feed)
        return tuple(dict.fromkeys(n for n in names if n))

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ReversalSpike]:
        for axis in axes_acting(recording, component) or driven_axes(recording, component):
            if recording.names("velocity", axis=axis):
                feed = recording.name("feed")
                varies = feed is not None and recording.frame[feed].nunique() > 1
                term = cls(axis=axis, feed=feed if varies else None, radial=is_radial(component))
                yield term
                if term.radial and term._runs_starting_at_reversal(recording):
                    yield term.model_copy(update={"from_start": True})

    @classmethod
    def example(cls) -> Example:
        return first_binding(cls, rows(step=0.002))  # gone within 0.1 s

    def since_turn(self, recording: Recording) -> np.ndarray:
        """Time since the last reversal in s, shape (rows,), infinite before the first."""
        t = recording.time()
        since = since_turn(sessions(recording), t, direction(recording, self.axis))
        for these in self._runs_starting_at_reversal(recording) if self.from_start else ():
            since[these] = np.minimum(since[these], t[these] - t[these[0]])
        return since

    def _runs_starting_at_reversal(self, recording: Recording) -> list[np.ndarray]:
        """Rows of each run that begins where this axis turns."""
        run = recording.run_codes()
        speed = np.abs(recording.array(str(recording.name("velocity", axis=self.axis))))
        every = [np.flatnonzero(run == code) for code in np.unique(run)]
        return [these for these in every if speed[these[0]] < AT_REST * np.nanmax(speed[these])]

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        size = direction(recording, self.axis) * np.exp(-self.since_turn(recording) / nonlinear[0])
        if self.feed:
            size = size * (recording.array(self.feed) / 1000.0) ** nonlinear[1]
        return (-size * response_share(recording, self.axis, self.radial))[:, None]

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        tau, since = nonlinear[0], self.since_turn(recording)
        if recording.name("position", axis=self.axis) or recording.name("command", axis=self.axis):
            travel = self._since_turn_travelled(recording, since)
            near = travel[np.abs(since - tau) < NEAR * tau]
            for share_of_travel in RISES if near.size and np.median(near) > 0 else ():
                yield base[:, 0] * np.exp(-travel / (share_of_travel * np.median(near))), 1.0
        yield base[:, 0] * np.minimum(since / tau, 1e3), 0.4  # delayed response of the loop: a Laguerre function

    def _since_turn_travelled(self, recording: Recording, since: np.ndarray) -> np.ndarray:
        """Travel since the last reversal in mm (deg), shape (rows,); since: time, infinite before the first."""
        way = np.cumsum(np.abs(np.nan_to_num(np.diff(position(recording, self.axis), prepend=np.nan))))
        began = np.isfinite(since) & ~(since > np.r_[np.inf, since[:-1]])
        return np.where(np.isfinite(since), way - np.maximum.accumulate(np.where(began, way, 0.0)), 1e9)

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        if self.radial or self.from_start:
            return None  # the share of an axis in a radius is no operation of a driver
        tau, *power = self.nonlinear_values(parameters)
        side = Direction(axis=self.axis)
        # a lag of the side differs by twice the spike, once the previous spike has decayed
        spike: Driver = Affine(weights=(1.0, -1.0), of=(side, Lag(tau_up=tau, tau_down=tau, of=side)))
        if self.feed and power[0] > 0:
            spike = Product(of=(spike, Power(exponent=power[0], of=scaled(Input(name=self.feed), 1e-3))))
        return (Lowered(scaled(spike, -0.5 * parameters["height"])),)
