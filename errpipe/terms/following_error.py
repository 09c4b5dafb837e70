"""Proportional to velocity, with its sign."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.driver import Driver, Input, Lag
from errpipe.domain.recording import Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import response_share
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._fields import Axis, Radial
from errpipe.terms._place import axes_acting, is_radial
from errpipe.terms._search import Estimates, Signals, resolved_times

MAX_SAMPLE_INTERVAL = 0.1  # s; of slower logs rows show a loop that has settled


class FollowingError(Term):
    """Following error: at speed v the axis is lag * v behind its command.

    Equation   deviation = -lag * v                                 [um] = [ms] * [mm/s]
               with `settles` v passes a first-order lag: the loop takes `settling` to reach its speed
    Assumes    constant loop gain Kv = 1 / lag, no residual feed-forward; a delayed clock looks the same
    Typical    v / Kv; 0.01..60 ms
    Moves      positive lag: behind the command in either direction
    Source     position loop with gain Kv; ISO 230-4, Weck
    """

    term: Literal["following_error"] = "following_error"
    axis: Axis
    column: str = Field(description="Column of the velocity.")
    radial: Radial = False
    settles: bool = Field(False, description="The log is fast enough to see the loop settle.")
    family = "servo"
    gains = (Parameter("lag", "ms", (0.01, 60.0), (-1000.0, 1000.0), "time by which the axis is late"),)

    def nonlinear(self) -> tuple[Parameter, ...]:
        if not self.settles:
            return ()
        return (Parameter("settling", "s", (0.001, 0.1), (1e-6, 10.0), "time constant of the loop"),)

    def log_prior_odds(self) -> float:
        return -4.0 if self.settles else 0.0  # its time constant is estimated, which the grid does not pay for

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[FollowingError]:
        for axis in () if is_radial(component) else axes_acting(recording, component):
            for column in recording.names("velocity", axis=axis):
                yield cls(axis=axis, column=column)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """In fast logs the loop's time constant that best explains the mismatch, together with a datum."""
        from scipy.optimize import minimize_scalar

        step, _ = resolved_times(recording)
        if recording.name("time") is None or step > MAX_SAMPLE_INTERVAL or not signals.values:
            return
        y = signals.whole() - signals.whole().mean()
        for plain in cls.bind(recording, component):
            if not np.isfinite(recording.array(plain.column)).all():
                continue
            term = plain.model_copy(update={"settles": True})

            def loss(logarithm: float, term: FollowingError = term) -> float:
                own = term.basis(recording, float(np.exp(logarithm)))[signals.rows, 0]
                own = own - own.mean()
                return -float((own @ y) ** 2 / max(float(own @ own), 1e-300))

            bounds = (np.log(0.3 * step), np.log(100 * step))
            near = minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-4})
            yield term, (float(np.exp(near.x)),)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        v = recording.array(self.column)
        if self.settles:
            (tau,) = nonlinear
            v = responses.lag_straight(sessions(recording), recording.time(), v, tau, tau, True)
        return (-v * response_share(recording, self.axis, self.radial))[:, None]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (*tau,) = self.nonlinear_values(parameters)
        late: Driver = Input(name=self.column)
        if tau:
            late = Lag(of=late, tau_up=tau[0], tau_down=tau[0])
        return (Lowered(scaled(late, -parameters["lag"])),)
