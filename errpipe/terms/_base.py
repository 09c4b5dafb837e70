"""What a term is: one piece of physics, stated once, used for fitting, diagnosis, simulation, tables and docs.

A term's value is linear in some parameters and may have non-linear ones inside its basis:

    value(columns; linear, nonlinear) = basis(columns, *nonlinear) @ linear

so a solver eliminates the linear part (variable projection) and searches only the few non-linear
parameters. A term defines columns and units, and is independent of the solver.
"""

from __future__ import annotations

import math
from abc import ABC
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal, Protocol

import numpy as np

from errpipe.domain.error_model import FittedParameter, FittedTerm
from errpipe.domain.recording import FrozenModel, Recording
from errpipe.drivers.lowered import Lowered
from errpipe.drivers.motion import position_name
from errpipe.drivers.simulated import DelayDifference, Ringing
from errpipe.terms._place import as_positioning
from errpipe.yamlfile import quantity


class Search(Protocol):
    """How a non-linear parameter is searched; the kinds of search are in `_search.py`."""

    bounded: ClassVar[bool]

    def values(self, term: Any, name: str, recording: Recording, signals: Any) -> tuple[float, ...]:
        """Values to try before any fit."""

    def neighbours(self, value: float, term: Any, recording: Recording) -> np.ndarray:
        """Values near the best one."""

    def widened(self, low: float, high: float, term: Any, recording: Recording) -> tuple[float, float]:
        """Ends of the interval represented by neighbours from low to high."""

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """Smallest and largest value that the recording resolves."""

    def log_prior(self, value: float, parameter: Parameter) -> float:
        """Log prior density of a value relative to typical ones."""


@dataclass(frozen=True)
class Parameter:
    """One parameter of a term. typical: sizes seen on machines; bounds: what physics allows.

    search: how a non-linear parameter is searched; none: by its unit (see `_search.search_of`).
    at_largest: of the diagnosis' contribution the value at its largest row is reported, whatever shape it has.
    """

    name: str
    unit: str
    typical: tuple[float, float]
    bounds: tuple[float, float] = (-math.inf, math.inf)
    meaning: str = ""
    search: Search | None = None
    at_largest: bool = False


NEVER = -1e9  # log prior odds of what is excluded


@dataclass(frozen=True)
class Example:
    """A worked case for generic tests: a bound term, rows, and parameters it can be recovered from."""

    term: Term
    recording: Recording
    parameters: Mapping[str, float] = field(default_factory=dict)


class Term(FrozenModel, ABC):
    """Base of all terms. A subclass sets `term: Literal[id]`, binds columns by fields, and states its basis."""

    term: str
    fixed: dict[str, float] = quantity("of each", "Parameters not solved for: name -> value.", {})

    reports_as: ClassVar[str] = ""  # id of the effects vocabulary: the term's own; "" where it is of no family
    family: ClassVar[str] = ""  # of effects; "" where the term is not an effect
    compensable: ClassVar[bool] = True  # False: an artefact of measuring, never to be compensated
    artefact: ClassVar[str] = ""  # why it is no fault of the machine; "" where it is one
    nuisance: ClassVar[bool] = True  # may it be fitted with accepted terms as a nuisance?
    simulated_log_odds: ClassVar[float] = 0.0  # log prior odds that a simulation includes it, relative to other effects
    misread: ClassVar[bool] = False  # does the simulation read a sensor that lies? Then it holds what a sensor drives
    gain_sd: ClassVar[float | None] = None  # where the linear parameter is known to be 1: within this
    physical_constant: ClassVar[bool] = False  # are the linear parameters constants of physics, within their bounds?
    is_level: ClassVar[bool] = False  # the deviation where everything else is zero: never shrunk
    one_sensor: ClassVar[bool] = False  # a plain gain on the reading of one sensor
    in_part: ClassVar[Literal["anywhere", "runs", "never"]] = "anywhere"  # may it act on a part: of an axis, or in runs
    only_estimated: ClassVar[bool] = False  # a diagnosis tries no binding but those of `estimates`
    also_of_positioning: ClassVar[bool] = False  # a diagnosis of EYX tries it as of EXX: `as_positioning`
    on_both_axes: ClassVar[bool] = True  # does it act on both axes of a circular test alike?
    rowwise: ClassVar[bool] = False  # of a row's basis: that row's columns and what `drive` makes of them, nothing else
    # what of its slack is no departure: the first column (the value that a rise is counted from), the first two (and
    # the end that a length grows from), the first three (how a spike rises), the first ones (the state of a body at
    # the start of each session; one more is the end that a length grows from), or all; "any rate": one of each tool,
    # which says nothing of others
    form: ClassVar[
        Literal[
            "textbook",
            "any reference",
            "any reference and end",
            "any start",
            "any start and end",
            "any shape",
            "any rate",
            "any rise",
        ]
    ] = "textbook"
    friction_part: ClassVar[Literal["", "dry", "viscous", "falling"]] = ""  # its part in a law of friction
    gains: ClassVar[tuple[Parameter, ...]] = ()  # what `linear` gives, where no field changes it
    searched: ClassVar[tuple[Parameter, ...]] = ()  # what `nonlinear` gives, where no field changes it
    prior_log_odds: ClassVar[float] = 0.0  # what `log_prior_odds` gives, where no field changes it
    sample: ClassVar[Mapping[str, Any] | None] = None  # fields of the worked case, where no binding makes one

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        cls.reports_as = str(cls.model_fields["term"].default) if cls.family else ""

    def linear(self) -> tuple[Parameter, ...]:
        """Parameters the value is linear in, in the order of the basis' columns."""
        if not self.gains:
            raise TypeError(f"{type(self).__name__} does not state its parameters")
        return self.gains

    def nonlinear(self) -> tuple[Parameter, ...]:
        """Parameters inside the basis that are to be solved for (those in `fixed` are left out by `free`)."""
        return self.searched

    def free(self) -> tuple[Parameter, ...]:
        """The non-linear parameters that are not fixed."""
        return tuple(p for p in self.nonlinear() if p.name not in self.fixed)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        """Design columns, shape (rows, len(linear())), in response units per unit of each parameter.

        nonlinear: values of *all* non-linear parameters, in the order of `nonlinear()`. Rows where a
        column is missing hold NaN.
        """
        raise TypeError(f"{type(self).__name__} does not state its basis")

    def settled(self, recording: Recording) -> Term:
        """The term with what it reads off the rows once (span, runs) written down; a fit calls it first."""
        return self

    def splittable_in_batches(self, recording: Recording) -> bool:
        """Whether a recording may be cut into batches between any two rows.

        The basis of the batches is then that of the whole, given the states that `drive` carries over
        (`Recording.past`), and `settled` needs no more than the smallest and largest value of each column.
        """
        return self.rowwise

    def penalty(self) -> np.ndarray | None:
        """Square matrix over the linear parameters of the quadratic penalty, or None."""
        return None

    def starts(self, name: str) -> tuple[float, ...]:
        """Values of a non-linear parameter to start a search from; () for a spread over its typical range."""
        return ()

    def value(self, recording: Recording, parameters: Mapping[str, float]) -> np.ndarray:
        """Deviation in the response's unit, shape (rows,)."""
        return self.basis(recording, *self.nonlinear_values(parameters)) @ self.gain_values(parameters)

    def gain_values(self, parameters: Mapping[str, float]) -> np.ndarray:
        """Values of the linear parameters, in their order."""
        return np.array([parameters[p.name] for p in self.linear()])

    def nonlinear_values(self, parameters: Mapping[str, float]) -> list[float]:
        """Values of all non-linear parameters, fixed ones included."""
        return [self.fixed[p.name] if p.name in self.fixed else parameters[p.name] for p in self.nonlinear()]

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        """Names of the recording's columns that drive the term, the most specific one first.

        Unless stated its `column`, else its `sensor`, else the position of its `axis`.
        """
        own: Any = self
        name = getattr(own, "column", None) or getattr(own, "sensor", None) or position_name(recording, own.axis)
        return (name,)

    def lower(self, parameters: Mapping[str, float]) -> tuple[Lowered, ...] | None:
        """The compiled form, or None where a controller cannot or must not compensate this effect."""
        return None

    def equation(self, parameters: Mapping[str, float]) -> tuple[Lowered | Ringing | DelayDifference, ...] | None:
        """The value as a sum of what a simulation computes: also of what no controller may compensate.

        None where it cannot be written so.
        """
        return self.lower(parameters)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[Term]:
        """Every sensible binding of the term to the recording's columns for a response."""
        return iter(())

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[Term]:
        """Bindings that a diagnosis tries; raw: the recording as it was read, before gaps were filled."""
        if cls.only_estimated:
            return iter(())
        return cls.bind(recording, as_positioning(component) if cls.also_of_positioning else component)

    @classmethod
    def estimates(cls, recording: Recording, component: str, signals: Any) -> Iterator[tuple[Term, tuple[float, ...]]]:
        """Bindings whose non-linear values are read off the signals at once, where a grid of them would be too large.

        signals: see `_search.Signals`; the first one is the mismatch. Several orders of a wave, two time constants.
        """
        return iter(())

    def counts_from_any_reference(self) -> bool:
        """Whether the value that a rise is counted from is part of its form."""
        return self.form in ("any reference", "any reference and end")

    def log_prior_odds(self) -> float:
        """Log prior odds of this binding relative to other effects."""
        return self.prior_log_odds

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Iterator[tuple[np.ndarray, float]]:
        """Departures from the textbook form: columns (rows,), and their prior standard deviation relative to its size.

        base: the term's basis at these non-linear values, shape (rows, linear).
        """
        return iter(())

    def active_ranges(self, recording: Recording, *nonlinear: float) -> dict[str, tuple[float, float]]:
        """Ranges of columns outside of which it is zero; empty where it acts everywhere."""
        return {}

    @classmethod
    def example(cls) -> Example | None:
        """A worked case of its own; None: of its `sample`, else its first binding (see `terms.example_of`)."""
        return None

    def has_message(self, parameters: Mapping[str, float]) -> bool:
        """Whether the parameters tell a reader something that the table of curves does not."""
        return True

    def sentence(self, parameters: Mapping[str, float]) -> str:
        """One plain sentence for a person, with numbers and units."""
        parts = [f"{p.name} = {parameters[p.name]:.4g} {p.unit}" for p in (*self.linear(), *self.free())]
        return f"{self.term.replace('_', ' ')}: " + ", ".join(parts)


def fitted_term(term: Term, values: Iterable[float], unit: str, half_width95: float | None = None) -> FittedTerm:
    """A term with the values of its linear parameters, all in one unit. half_width95: of their intervals, if known."""
    half = half_width95
    parameters = tuple(
        FittedParameter(
            name=p.name,
            value=float(v),
            unit=unit,
            standard_error=None if half is None else half / 1.96,
            ci95=None if half is None else (float(v) - half, float(v) + half),
        )
        for p, v in zip(term.linear(), values, strict=True)
    )
    return FittedTerm(term=plain(term), parameters=parameters)


def plain(term: Term) -> dict[str, Any]:
    """The term as declared, without defaults: what an error model stores."""
    stated = term.model_dump(mode="json", exclude_defaults=True)
    full = term.model_dump(mode="json")  # nested objects are kept complete: a union needs its `kind` and `op`
    return {key: value for key, value in full.items() if key in stated or key == "term"}
