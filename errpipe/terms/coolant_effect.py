"""Follows coolant flow or coolant temperature while it flows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation
from errpipe.domain.driver import Affine, Driver, Input, Lag, Product
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses
from errpipe.terms._base import Parameter, Term
from errpipe.terms._drivers import COOLANT_WORDS, mentions, scaled, sensors
from errpipe.terms._fields import TEMPERATURE
from errpipe.terms._slack import Slack, start_states


class CoolantEffect(Term):
    """Coolant runs over table, work and spindle nose and brings them to its own temperature while it flows.

    Equation   tau dy/dt + y = flow * (T_coolant - T_other);  deviation = gain * y   [um] = [um/K] * [K]
               without T_other, which is not measured: tau dy/dt + y = flow * (gain * (T_coolant - 20) + shift), y in um
               without temperatures: tau dy/dt + y = flow;    deviation = shift * y  [um]
               with `at_once` y is the right-hand side itself
    Assumes    one time constant
    Typical    2..20 um, tau 60..900 s
    Moves      with the coolant switch, soon after it
    Source     lumped heat balance
    """

    term: Literal["coolant_effect"] = "coolant_effect"
    flow: str = Field(description="Column that is 1 while coolant flows.")
    sensor: str | None = Field(None, description="Column of the coolant's temperature.")
    other: Annotated[str | None, TEMPERATURE] = Field(
        None, description="Column of the temperature it is compared with."
    )
    at_once: bool = Field(False, description="Without a time constant, which is shorter than rows are apart.")
    family = "thermal"
    form = "any start"
    simulated_log_odds = -2.0

    def linear(self) -> tuple[Parameter, ...]:
        gain = Parameter("gain", "um/K", (0.5, 10.0), (-100.0, 100.0), "shift per kelvin while it flows")
        shift = Parameter("shift", "um", (2.0, 20.0), (-200.0, 200.0), "shift while it flows")
        return (gain,) if self.other else (gain, shift) if self.sensor else (shift,)

    def nonlinear(self) -> tuple[Parameter, ...]:
        return () if self.at_once else (Parameter("tau", "s", (60.0, 900.0), (1.0, 10000.0), "time constant"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return tuple(n for n in (self.flow, self.sensor, self.other) if n)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[CoolantEffect]:
        if not is_deviation(component):
            return
        candidates = sensors(recording)
        for flow in recording.names("coolant"):
            if recording.frame[flow].nunique() < 2:
                continue
            yield cls(flow=flow)
            for sensor in (s for s in candidates if mentions(recording, s, COOLANT_WORDS)):
                yield cls(flow=flow, sensor=sensor)
                for other in candidates:
                    if other != sensor:
                        yield cls(flow=flow, sensor=sensor, other=other)

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[CoolantEffect]:
        for term in cls.bind(recording, component):
            yield term
            yield term.model_copy(update={"at_once": True})

    def _sources(self) -> tuple[Driver, ...]:
        """One for each linear parameter."""
        flow: Driver = Input(name=self.flow)
        if self.sensor and self.other:
            cold = Affine(weights=(1.0, -1.0), of=(Input(name=self.sensor), Input(name=self.other)))
            return (Product(of=(flow, cold)),)
        if self.sensor:
            return Product(of=(flow, Affine(offset=-20.0, weights=(1.0,), of=(Input(name=self.sensor),)))), flow
        return (flow,)

    def _drivers(self, *tau: float) -> tuple[Driver, ...]:
        sources = self._sources()
        return tuple(Lag(of=s, tau_up=tau[0], tau_down=tau[0], start="zero") for s in sources) if tau else sources

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return np.column_stack([drive(d, recording) for d in self._drivers(*nonlinear)])

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        for tau in nonlinear:
            yield from start_states(recording, tau, 0.2, 0.2)
            for factor in (0.3, 3.0):
                yield from ((column, 0.25) for column in self.basis(recording, tau * factor).T)
        if self.other:
            yield self.model_copy(update={"sensor": None, "other": None}).basis(recording, *nonlinear)[:, 0], 0.25
        yield from ((column, 0.25) for column in self._cooled_growth(recording, *nonlinear))

    def _cooled_growth(self, recording: Recording, *tau: float) -> Iterator[np.ndarray]:
        """Cooling of a warm spindle, in proportion to its temperature rise."""
        on = recording.array(self.flow)
        for name in recording.names("spindle_speed"):
            speed = recording.array(name)
            warming = drive(Lag(of=Input(name=name), tau_up=1500.0, tau_down=1500.0, start="zero"), recording)
            if speed.max() > 0:
                cooled = on * warming / speed.max()
                t = recording.time()
                yield responses.lag(sessions(recording), t, cooled, tau[0], tau[0], False) if tau else cooled

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        drivers = self._drivers(*self.nonlinear_values(parameters))
        return tuple(Lowered(scaled(d, parameters[p.name])) for p, d in zip(self.linear(), drivers, strict=True))
