"""What a term is: one piece of physics, stated once, used for fitting, diagnosis, simulation, tables and docs.

A term's value is linear in some parameters and may have non-linear ones inside its basis:

    value(columns; linear, nonlinear) = basis(columns, *nonlinear) @ linear

so a solver eliminates the linear part (variable projection) and searches only the few non-linear
parameters. A term knows columns and units; it never knows how it will be solved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from errpipe.domain import driver as d
from errpipe.domain.recording import Frozen, Recording
from errpipe.kernels import responses


@dataclass(frozen=True)
class Parameter:
    """One parameter of a term. typical: sizes seen on machines; bounds: what physics allows."""

    name: str
    unit: str
    typical: tuple[float, float]
    bounds: tuple[float, float] = (-np.inf, np.inf)
    meaning: str = ""


@dataclass(frozen=True)
class Lowered:
    """One compiled pair: profile(position of `axis`) * driver(state), in the response's unit.

    profile: vectorised function of positions in mm (deg), or None for the constant 1.
    period: repeat length of the profile, where it has one.
    """

    driver: d.Driver
    axis: str | None = None
    profile: Callable[[np.ndarray], np.ndarray] | None = None
    period: float | None = None


@dataclass(frozen=True)
class Example:
    """A worked case for generic tests: a bound term, rows, and parameters it can be recovered from."""

    term: Term
    recording: Recording
    parameters: Mapping[str, float] = field(default_factory=dict)


class Term(Frozen):
    """Base of all terms. A subclass sets `term: Literal[id]`, binds columns by fields, and states its basis."""

    term: str
    fixed: dict[str, float] = Field(
        {}, description="Parameters not solved for: name -> value.", json_schema_extra={"unit": "of each"}
    )

    reports_as: ClassVar[str] = ""  # id of the effects vocabulary; "" where the term is not an effect
    family: ClassVar[str] = ""
    compensable: ClassVar[bool] = True  # False: an artefact of measuring, never to be compensated

    def linear(self) -> tuple[Parameter, ...]:
        """Parameters the value is linear in, in the order of the basis' columns."""
        raise TypeError(f"{type(self).__name__} does not state its linear parameters")

    def nonlinear(self) -> tuple[Parameter, ...]:
        """Parameters inside the basis that are to be solved for (those in `fixed` are left out by `free`)."""
        return ()

    def free(self) -> tuple[Parameter, ...]:
        """The non-linear parameters that are not fixed."""
        return tuple(p for p in self.nonlinear() if p.name not in self.fixed)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        """Design columns, shape (rows, len(linear())), in response units per unit of each parameter.

        nonlinear: values of *all* non-linear parameters, in the order of `nonlinear()`. Rows where a
        column is missing hold NaN.
        """
        raise TypeError(f"{type(self).__name__} does not state its basis")

    def basis_derivative(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        """d(basis)/d(nonlinear), shape (rows, linear, nonlinear); central differences unless overridden."""
        out = np.empty((len(recording), len(self.linear()), len(nonlinear)))
        for j, value in enumerate(nonlinear):
            step = 1e-7 * max(abs(value), 1e-6)  # a wave of 0.02 mm over 0.4 m makes 1.3 turns within 1e-5
            up = [*nonlinear[:j], value + step, *nonlinear[j + 1 :]]
            down = [*nonlinear[:j], value - step, *nonlinear[j + 1 :]]
            out[:, :, j] = (self.basis(recording, *up) - self.basis(recording, *down)) / (2 * step)
        return out

    def settled(self, recording: Recording) -> Term:
        """The term with what it reads off the rows once (span, runs) written down; a fit calls it first."""
        return self

    def penalty(self) -> np.ndarray | None:
        """Square matrix over the linear parameters whose quadratic form is held small, or None."""
        return None

    def starts(self, name: str) -> tuple[float, ...]:
        """Values of a non-linear parameter to start a search from; () for a spread over its typical range."""
        return ()

    def value(self, recording: Recording, parameters: Mapping[str, float]) -> np.ndarray:
        """Deviation in the response's unit, shape (rows,)."""
        gains = np.array([parameters[p.name] for p in self.linear()])
        return self.basis(recording, *self.nonlinear_values(parameters)) @ gains

    def nonlinear_values(self, parameters: Mapping[str, float]) -> list[float]:
        """Values of all non-linear parameters, fixed ones included."""
        return [self.fixed[p.name] if p.name in self.fixed else parameters[p.name] for p in self.nonlinear()]

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        """Names of the recording's columns that drive the term, the telling one first."""
        raise TypeError(f"{type(self).__name__} does not state its columns")

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        """The compiled form, or None where a controller cannot or must not compensate this effect."""
        return None

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Term]:
        """Every sensible binding of the term to the recording's columns for a response."""
        return iter(())

    @classmethod
    def example(cls) -> Example:
        """A worked case; generic tests derive the rest from it. Unless overridden, the first of its bindings."""
        from errpipe.terms._example import first_binding

        return first_binding(cls)

    def says(self, parameters: Mapping[str, float]) -> str:
        """One plain sentence for a person, with numbers and units."""
        parts = [f"{p.name} = {parameters[p.name]:.4g} {p.unit}" for p in (*self.linear(), *self.free())]
        return f"{self.term.replace('_', ' ')}: " + ", ".join(parts)


LONGEST_PAUSE = 7200.0  # s; runs further apart than this count as started anew (from taste: a machine at rest forgets)


def sessions(recording: Recording) -> np.ndarray:
    """Integer per row, shape (rows,): runs that follow in time share one, for heat does not stop between them.

    A new session starts where the run changes and time goes back, is missing, or jumps by more than
    `LONGEST_PAUSE`; without a time column every run is its own.
    """
    run = recording.run_codes()
    if len(run) == 0 or recording.name("time") is None:
        return run
    step = np.diff(recording.time())
    goes_on = (step >= 0) & (step <= LONGEST_PAUSE)
    return np.r_[0, np.cumsum((run[1:] != run[:-1]) & ~goes_on)].astype(np.int64)


def drive(driver: d.Driver, recording: Recording) -> np.ndarray:
    """Evaluate a driver causally over a recording, shape (rows,). Missing inputs give NaN.

    States (first value, lag, switch, direction, approach) live as long as a session: see `sessions`.
    """
    match driver:
        case d.Constant():
            return np.full(len(recording), driver.value)
        case d.Input():
            return recording.array(driver.name)
        case d.Affine():
            total = np.full(len(recording), driver.offset)
            for weight, of in zip(driver.weights, driver.of, strict=True):
                total = total + weight * drive(of, recording)
            return total
        case d.First():
            return responses.first_value(sessions(recording), drive(driver.of, recording))
        case d.Lag():
            source = drive(driver.of, recording)
            return _late(driver, source, recording)
        case d.Product():
            return np.prod([drive(of, recording) for of in driver.of], axis=0)
        case d.Power():
            source = drive(driver.of, recording)
            return np.sign(source) * np.abs(source) ** driver.exponent
        case d.Clip():
            return np.clip(drive(driver.of, recording), driver.low, driver.high)
        case d.Switch():
            return responses.switch(sessions(recording), drive(driver.of, recording), driver.on, driver.off)
        case d.Direction():
            return direction(recording, driver.axis, driver.threshold, driver.start)
        case d.Approach():
            side = direction(recording, driver.axis, driver.threshold, driver.start)
            return responses.approach(sessions(recording), position(recording, driver.axis), side, driver.length)
        case d.Lookup():
            values = np.asarray(driver.values)
            return responses.lookup(drive(driver.of, recording), driver.start, driver.step, values)
    raise TypeError(f"unknown driver {driver!r}")


PAUSE = 4.0  # times the usual step between rows, from which a series of parts has paused


def _late(driver: d.Lag, source: np.ndarray, recording: Recording) -> np.ndarray:
    """A lag's answer, by what the recording says of the time between its rows."""
    session, t, at_input = sessions(recording), recording.time(), driver.start == "input"
    taus = (driver.tau_up, driver.tau_down)
    if recording.between == "inferred" and _runs_on(driver.of, recording):
        return responses.lag_straight(session, t, source, *taus, at_input)
    if recording.between == "inferred" and recording.name("cut_length") is not None and len(recording) > 1:
        usual = float(np.median(np.diff(t)))
        return responses.lag_paused(session, t, source, *taus, at_input, PAUSE * usual, usual)
    return responses.lag(session, t, source, *taus, at_input)


def _runs_on(driver: d.Driver, recording: Recording) -> bool:
    """Does a driver depend on nothing but temperatures and pressures, which do not jump between rows?"""
    names = d.inputs(driver)
    roles = {recording.manifest.columns[n].role for n in names}
    return bool(names) and roles <= {"temperature", "pressure"}


def direction_column(recording: Recording, axis: str) -> str:
    """Name of the column that tells an axis' direction: its direction, else velocity, else position column."""
    for role in ("direction", "velocity", "position", "command"):
        name = recording.name(role, axis=axis)
        if name is not None:
            return name
    raise KeyError(f"nothing in the recording tells the direction of axis {axis}")


def position(recording: Recording, axis: str) -> np.ndarray:
    """Position of an axis in mm or deg, shape (rows,); the command where no position is recorded."""
    name = recording.name("position", axis=axis) or recording.name("command", axis=axis)
    if name is None:
        raise KeyError(f"the recording has no position of axis {axis}")
    return recording.array(name)


def direction(recording: Recording, axis: str, threshold: float = 0.001, start: int = 1) -> np.ndarray:
    """Side an axis was last moved from, +1 or -1: its direction column, else its velocity's sign, else its travel."""
    name = recording.name("direction", axis=axis)
    if name is not None:
        return recording.array(name)
    name = recording.name("velocity", axis=axis)
    if name is not None:
        moving = np.sign(recording.array(name))
        moving[moving == 0] = np.nan
        held = hold(recording.run_codes(), moving)
        return np.where(np.isnan(held), float(start), held)
    return responses.direction_of_travel(sessions(recording), position(recording, axis), threshold, start)


def hold(run: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Last finite value of each run, shape (rows,); NaN before the first."""
    index = np.where(np.isnan(values), -1, np.arange(values.size))
    starts = np.r_[True, run[1:] != run[:-1]]
    first = np.maximum.accumulate(np.where(starts, np.arange(values.size), 0))
    last = np.maximum.accumulate(index)
    return np.where(last >= first, values[np.maximum(last, 0)], np.nan)


def plain(term: Term) -> dict[str, Any]:
    """The term as declared, without defaults: what an error model stores."""
    told = term.model_dump(mode="json", exclude_defaults=True)
    full = term.model_dump(mode="json")  # what is nested stays whole: a union needs its `kind` and `op`
    return {key: value for key, value in full.items() if key in told or key == "term"}
