"""A driver: how an error's size follows the state of the machine, as a tree of few operations.

Everything here is causal and cheap: a controller evaluates the same tree once per cycle. `domain/operations.py`
defines the operations and their parameters; this file adds their operands.
It is in `domain/`, not with its evaluation in `drivers/`, because error models and their schema contain drivers.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from errpipe.domain import operations
from errpipe.domain.recording import FrozenModel


class Constant(operations.Constant):
    """The same at all times."""


class Input(FrozenModel):
    op: Literal["input"] = "input"
    name: str = Field(description="Column of the recording, channel of the controller.")


class OfOne(FrozenModel):
    """An operation on one driver."""

    of: Driver = Field(description="Operand.")


class OfSeveral(FrozenModel):
    """An operation on several drivers."""

    of: tuple[Driver, ...] = Field(description="Operands.")


class OfAxis(FrozenModel):
    """An operation on the motion of an axis."""

    axis: str = Field(description="Letter of the axis, such as X.")


class Affine(operations.Affine, OfSeveral):
    """Weighted sum."""


class First(operations.First, OfOne):
    """Value at the start of the session."""


class Lag(operations.Lag, OfOne):
    """First-order lag."""


class Product(operations.Product, OfSeveral):
    """Product."""


class Power(operations.Power, OfOne):
    """Power with the sign of the operand."""


class Clip(operations.Clip, OfOne):
    """Limited to a range."""


class Switch(operations.Switch, OfOne):
    """1 or 0, with hysteresis."""


class Direction(operations.Direction, OfAxis):
    """Side an axis was last moved from."""


class Approach(operations.Approach, operations.Turning, OfAxis):
    """What builds up over the travel after a reversal."""


class Lookup(operations.Lookup, OfOne):
    """A small table."""


Driver = Annotated[
    Constant | Input | Affine | First | Lag | Product | Power | Clip | Switch | Direction | Approach | Lookup,
    Field(discriminator="op"),
]

ONE = Constant(value=1.0)


def at_start(name: str) -> First:
    """The value of an input at the start of the run."""
    return First(of=Input(name=name))


def rise(name: str) -> Affine:
    """Temperature rise of an input over its value at the start of the run, K."""
    return Affine(weights=(1.0, -1.0), of=(Input(name=name), at_start(name)))


def above(name: str, reference: float) -> Affine:
    """Temperature rise of an input over a fixed reference, K."""
    return Affine(offset=-reference, weights=(1.0,), of=(Input(name=name),))


def lag(of: Driver, tau: float) -> Lag:
    """First-order lag of one time constant, s, that is zero at the start of a session."""
    return Lag(of=of, tau_up=tau, tau_down=tau, start="zero")


def inputs(driver: Driver) -> tuple[str, ...]:
    """Names of the inputs a driver reads, in order of first use."""
    if isinstance(driver, Input):
        return (driver.name,)
    return tuple(dict.fromkeys(name for child in _below(driver) for name in inputs(child)))


def axes(driver: Driver) -> set[str]:
    """Letters of the axes whose motion a driver follows."""
    own = {driver.axis} if isinstance(driver, Direction | Approach) else set()
    return own.union(*map(axes, _below(driver)))


def has_memory(driver: Driver) -> bool:
    """Whether a driver's value depends on rows before the row."""
    return isinstance(driver, First | Lag | Switch | Direction | Approach) or any(map(has_memory, _below(driver)))


def _below(driver: Driver) -> tuple[Driver, ...]:
    of = getattr(driver, "of", ())
    return of if isinstance(of, tuple) else (of,)
