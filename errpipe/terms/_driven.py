"""Bases of terms: one parameter times a driver (most of what is thermal), a curve of one axis, a simulated force."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, Self

import numpy as np
from pydantic import Field

from errpipe.domain.components import is_deviation, is_force
from errpipe.domain.driver import ONE, Driver, Input, Power
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position
from errpipe.terms import _profiles as shapes
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._drivers import scaled
from errpipe.terms._fields import Axis
from errpipe.terms._place import velocities
from errpipe.yamlfile import quantity


class Driven(Term):
    """deviation = parameter * driver. A subclass states its one linear parameter and the driver."""

    @abstractmethod
    def _driver(self, *nonlinear: float) -> Driver:
        """The driver at values of all non-linear parameters."""

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return drive(self._driver(*nonlinear), recording)[:, None]

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        (gain,) = self.linear()
        return (Lowered(scaled(self._driver(*self.nonlinear_values(parameters)), parameters[gain.name])),)


class OfSpindleSpeed(Driven):
    """An effect of spindle speed, stated at the highest speed of the recording."""

    column: str = Field(description="Column of the spindle speed.")
    full_speed: float = quantity("rpm", "Speed at which the parameter is stated.")

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Self]:
        own: Any = cls  # a subclass has its `term`
        for column in recording.names("spindle_speed") if is_deviation(component) else ():
            values = recording.array(column)
            if np.nanmax(values) > max(np.nanmin(values), 0.0):
                yield own(column=column, full_speed=float(np.nanmax(values)))

    def _power(self, exponent: float) -> Power:
        """A power of the speed as a share of the full one."""
        return Power(of=scaled(Input(name=self.column), 1.0 / self.full_speed), exponent=exponent)


class CurveOverAxis(Term):
    """deviation = a profile with a span over one axis, the same at every temperature."""

    axis: Axis
    sample = {"axis": "X"}

    @abstractmethod
    def _profile(self) -> shapes.Polynomial | shapes.Curve:
        """The profile; its span is the field `span`."""

    def settled(self, recording: Recording) -> Self:
        """The term with its span written down."""
        profile = self._profile().settled(position(recording, self.axis))
        return self.model_copy(update={"span": profile.span})

    def linear(self) -> tuple[Parameter, ...]:
        return shapes.parameters(self._profile(), rotary=False)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        return self._profile().basis(position(recording, self.axis))

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...]:
        gains = self.gain_values(parameters)
        return (Lowered(ONE, self.axis, shapes.curve(self._profile(), gains, rotary=False)),)


class PerRun(Term):
    """Set-up that is repeated for each run. A nuisance: never compensated."""

    runs: tuple[str, ...] = Field((), description="Labels of the runs; none: all of them.")
    compensable = False
    sample = {}

    def settled(self, recording: Recording) -> Self:
        """The term with the runs' labels written down."""
        return self if self.runs else self.model_copy(update={"runs": recording.run_labels()})

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return recording.names("run")

    def in_run(self, recording: Recording) -> np.ndarray:
        """Whether each row is of each run, shape (rows, runs)."""
        names = np.asarray(recording.run_labels(), dtype=object)[recording.run_codes()]
        return np.column_stack([names == run for run in self.runs])


class OfVelocity(Term):
    """A friction force of one axis, by the column of its velocity."""

    axis: Axis
    column: str = Field(description="Column of the velocity.")
    family = "friction"
    compensable = False
    form = "any shape"

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Self]:
        own: Any = cls  # a subclass has its `term`
        for axis, column in velocities(recording, component):
            yield own(axis=axis, column=column)


class OfSimulatedForce(Term):
    """What a drive makes of the simulated force, by a limit that it searches: with gain 1."""

    column: str = Field(description="Column of the simulated force.")
    family = "friction"
    compensable = False
    simulated_log_odds = NEVER
    nuisance = False
    gain_sd = 0.15  # it has no size parameter apart from its limit
    in_part = "never"
    gains = (Parameter("share", "1", (0.8, 1.2), (0.0, 2.0), "1 where it explains the mismatch in full"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Self]:
        own: Any = cls  # a subclass has its `term`
        for column in recording.names("simulated", component=component) if is_force(component) else ():
            yield own(column=column)
