"""Follows a measured temperature through a first-order lag."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Lag
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position, position_name
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import REFERENCE, ROOM_WORDS, mentions, rise_driver, scaled, sensors
from errpipe.terms._fields import Reference, Sensor
from errpipe.terms._place import is_radial, linear_axes_acting
from errpipe.terms._search import Estimates, Signals, Times, geometric
from errpipe.terms._slack import Slack, start_states

TRIAL_RATIO, MIN_RATIO = 1.5, 3.0  # between trial time constants; factor between the two of one sensor
MAX_RESIDUAL_SHARE = 0.9  # share of the sum of squares of one time constant, below which two of them are offered
MIN_AMBIENT_LAG = 3000.0  # s, from which a lag of the room is typical of `ambient_drift`
AMBIENT_LOG_ODDS = -6.0  # log odds of such a lag under this name, by judgement


class RoomLags(Times):
    """Time constants of the room: by definition (ISO 230-3, environmental variation) long ones have another name."""

    def log_prior(self, value: float, parameter: Parameter) -> float:
        return super().log_prior(value, parameter) + (AMBIENT_LOG_ODDS if value > MIN_AMBIENT_LAG else 0.0)


class ThermalLag(Term):
    """The part that expands is slower than its sensor: hysteresis loops of deviation against temperature.

    Equation   tau dy/dt + y = T - T_ref;  deviation = gain * y          [um] = [um/K] * [K]
               with `along` the deviation is gain * y * x                [um] = [um/m/K] * [m] * [K]
               with `two_stages` gain_slow * y_slow of a second lag is added
    Assumes    one time constant (or two), equal for warming and cooling; in equilibrium with the sensor at the start
    Typical    time constant 600..15000 s, gain 1..10 um/K
    Moves      positive gain: the warmer, the further, late by about tau
    Source     lumped heat balance; Mares, Horejs, Havlik 2020 (transfer functions in the control)
    """

    term: Literal["thermal_lag"] = "thermal_lag"
    sensor: Sensor
    reference: Reference = REFERENCE
    along: str | None = Field(None, description="Axis along which the lagged temperature stretches; none: it shifts.")
    two_stages: bool = Field(False, description="A second, slower part follows the same sensor.")
    of_room: bool = Field(False, description="The sensor reads the room: a lag of hours is an `ambient_drift`.")
    family = "thermal"
    form = "any start"
    rowwise = True
    simulated_log_odds = -4.0

    def linear(self) -> tuple[Parameter, ...]:
        if self.along:
            return (Parameter("gain", "um/m/K", (5.0, 20.0), (-200.0, 200.0), "slope per kelvin"),)
        fast = Parameter("gain", "um/K", (1.0, 10.0), (-200.0, 200.0), "shift per kelvin")
        if not self.two_stages:
            return (fast,)
        return (fast, Parameter("gain_slow", "um/K", (1.0, 10.0), (-200.0, 200.0), "shift of the slower part"))

    def nonlinear(self) -> tuple[Parameter, ...]:
        typical, search = ((600.0, MIN_AMBIENT_LAG), RoomLags()) if self.of_room else ((600.0, 15000.0), None)
        fast = Parameter("tau", "s", typical, (60.0, 100000.0), "time constant", search=search)
        if not self.two_stages:
            return (fast,)
        return (fast, Parameter("tau_slow", "s", (1800.0, 40000.0), (60.0, 200000.0), "of the slower part"))

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.sensor, position_name(recording, self.along)) if self.along else (self.sensor,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[ThermalLag]:
        if not is_deviation(component):
            return
        for sensor in sensors(recording):
            yield cls(sensor=sensor)
            for axis in () if is_radial(component) else linear_axes_acting(recording, component):
                yield cls(sensor=sensor, along=axis)

    def _driver(self, tau: float) -> Lag:
        return Lag(of=rise_driver(self.sensor, self.reference), tau_up=tau, tau_down=tau)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        slow = np.column_stack([drive(self._driver(tau), recording) for tau in nonlinear])
        return slow * position(recording, self.along)[:, None] * 1e-3 if self.along else slow

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        for tau in nonlinear:
            yield from start_states(recording, tau, 0.4, 0.6)

    def log_prior_odds(self) -> float:
        """A second time constant is one of about ten."""
        return -3.0 if self.two_stages else 0.0

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Signals) -> Estimates:
        """For each sensor the time constant, and the two a factor of three or more apart, that explain most."""
        low, high = Times().limits(cls, recording)
        if not (is_deviation(component) and signals.values and recording.name("time") and high > 9 * low):
            return
        taus = geometric(low, high, TRIAL_RATIO)
        for sensor in sensors(recording):
            of_room = mentions(recording, sensor, ROOM_WORDS)
            term = cls(sensor=sensor, two_stages=True, of_room=of_room)
            states = np.column_stack([drive(term._driver(tau), recording)[signals.rows] for tau in taus])
            if np.isfinite(states).all():
                single = term._one(recording, signals, taus)
                yield cls(sensor=sensor, of_room=of_room), (single,)
                one = drive(term._driver(single), recording)[signals.rows]
                gap = int(np.ceil(np.log(MIN_RATIO) / np.log(taus[1] / taus[0])))
                best = best_pair(states, one, signals.values, gap)
                if best is not None:
                    yield term, (taus[best[0]], taus[best[1]])

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[ThermalLag]:
        """Shifts only: a scale that follows its sensor late is within what an expansion of the scale may depart."""
        for term in cls.bind(recording, component):
            if not term.along:
                yield term.model_copy(update={"of_room": mentions(recording, term.sensor, ROOM_WORDS)})

    def _one(self, recording: Recording, signals: Signals, taus: tuple[float, ...]) -> float:
        """The time constant that best explains the mismatch, with a datum and gains of the other signals."""
        from scipy.optimize import minimize_scalar

        known = np.linalg.qr(np.column_stack([np.ones(signals.rows.size), *signals.values[1:]]))[0]
        y = signals.values[0] - known @ (known.T @ signals.values[0])

        def loss(logarithm: float) -> float:
            state = drive(self._driver(float(np.exp(logarithm))), recording)[signals.rows]
            own = state - known @ (known.T @ state)
            return -float((own @ y) ** 2 / max(float(own @ own), 1e-300))

        rough = min(np.log(taus), key=loss)
        reach = np.log(taus[1] / taus[0])
        near = minimize_scalar(loss, bounds=(rough - reach, rough + reach), method="bounded", options={"xatol": 1e-3})
        return float(np.exp(near.x))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        taus, gains = self.nonlinear_values(parameters), [parameters[p.name] for p in self.linear()]
        if self.along:
            return (Lowered(self._driver(taus[0]), self.along, lambda x: gains[0] * 1e-3 * np.asarray(x, dtype=float)),)
        return tuple(Lowered(scaled(self._driver(tau), gain)) for tau, gain in zip(taus, gains, strict=True))


def best_pair(states: np.ndarray, one: np.ndarray, signals: tuple[np.ndarray, ...], gap: int) -> tuple[int, int] | None:
    """The two columns, at least `gap` from each other, that best explain the first signal with gains of one sign.

    A datum and gains of the other signals are free. None where the best single column, `one`, is hardly worse.
    """
    known = np.column_stack([np.ones(len(states)), *signals[1:]])
    block = np.column_stack([states, one, signals[0]])
    block = block - known @ np.linalg.lstsq(known, block, rcond=None)[0]
    products = block.T @ block
    single = float(products[-2, -1] ** 2 / max(products[-2, -2], 1e-300))
    threshold, best = products[-1, -1] - (products[-1, -1] - single) * MAX_RESIDUAL_SHARE, None
    for i in range(states.shape[1]):
        for j in range(i + gap, states.shape[1]):
            b = np.linalg.lstsq(products[np.ix_([i, j], [i, j])], products[[i, j], -1], rcond=1e-12)[0]
            explained = float(b @ products[[i, j], -1])
            if b[0] * b[1] > 0 and explained > threshold:
                threshold, best = explained, (i, j)
    return best
