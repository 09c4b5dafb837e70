"""What is recorded comes some milliseconds late: a dead time."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import path_name
from errpipe.drivers.simulated import DelayDifference
from errpipe.terms._base import NEVER, Example, Parameter, Term
from errpipe.terms._example import rows, typical_example
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Delays, Estimates, Signals, resolved_times
from errpipe.terms._time_shift import shift_of

MAX_SAMPLE_INTERVAL = 0.1  # s; what comes late in slower logs has another clock: see `clock_offset`
MIN_STEPS, MAX_STEPS = 0.02, 60.0  # sampling steps


class DeadTime(Term):
    """Dead time of bus, amplifier or filter: a position or a force arrives later than simulated, otherwise unchanged.

    Equation   deviation(t) = f(t - delay) - f(t), f the axis' position or the simulated signal
    Assumes    one delay, in addition to the lag of a servo loop with gain Kv (see `following_error`)
    Typical    0.5..20 ms
    Moves      along the path: proportional to speed, without rounding of corners
    Source     dead time of sampled control loops (Franklin, Powell, Workman: half to two periods)
    """

    term: Literal["dead_time"] = "dead_time"
    column: str | None = Field(None, description="Column of the simulated signal that comes late.")
    axis: str | None = Field(None, description="Axis whose position comes late.")
    family = "servo"
    only_estimated = True
    compensable = False
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # the difference of the shifted signals enters with gain 1
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where the delay explains it in full"),)
    searched = (Parameter("delay", "s", (0.0005, 0.02), (-10.0, 10.0), "recorded late", search=Delays()),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (path_name(recording, self.axis),) if self.axis else (str(self.column),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[DeadTime]:
        step, _ = resolved_times(recording)
        if recording.name("time") is None or step > MAX_SAMPLE_INTERVAL or is_radial(component):
            return
        for column in recording.names("simulated", component=component):
            yield cls(column=column)
        for axis in axes_acting(recording, component):
            yield cls(axis=axis)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """The delay that reduces the mismatch most; an early signal has another clock."""
        step, _ = resolved_times(recording)
        for term in cls.bind(recording, component):
            if not signals.values or not np.isfinite(term._late(0.0).signal(recording)).all():
                continue
            trial = np.r_[-10.0:MAX_STEPS:0.5] * step
            delay = shift_of(term._late(0.0), recording, signals, trial, step)
            if abs(delay) > MIN_STEPS * step and (term.axis or delay > 0):
                yield term, (delay,)

    def _late(self, delay: float, gain: float = 1.0) -> DelayDifference:
        return DelayDifference(delay, self.column, self.axis, gain)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._late(*nonlinear).value(recording)[:, None]

    def equation(self, parameters: Mapping[str, float]) -> tuple[DelayDifference, ...] | None:
        (delay,) = self.nonlinear_values(parameters)
        return (self._late(delay, parameters["share"]),) if delay > 0 else None  # no simulation anticipates

    def log_prior_odds(self) -> float:
        """The price of its delay, estimated without a grid, is included; axes mostly lag in proportion to speed."""
        return -8.0 if self.axis else -4.0

    @classmethod
    def example(cls) -> Example:
        return typical_example(cls(axis="X"), rows(0.01))
