"""A driver: how an error's size follows the state of the machine, as a tree of few operations.

Everything here is causal and cheap: a controller evaluates the same tree once per cycle. Semantics of
each operation at step k (dt = time since the step before). States start at the first step of a session: a
controller's power-on; in a recording, a run, and with it the runs that follow it in time, because heat does
not stop between runs (a prediction takes every run by itself):

    constant   value
    input      the named input (a column of a recording, a channel of a controller)
    affine     offset + sum(weight * operand)
    first      the operand's value at the first step of the run (a reference such as the cold temperature)
    lag        y[k] = u[k-1] + (y[k-1] - u[k-1]) * exp(-dt / tau), tau = tau_up where u[k-1] >= y[k-1] else
               tau_down; exact for inputs held between steps; y[0] = u[0] (start "input") or 0 (start "zero")
    product    product of the operands
    power      sign(u) * |u| ** exponent
    clip       min(max(u, low), high)
    switch     1 once u >= on, 0 once u <= off, else the value before; 0 at the start unless u >= on
    direction  +1 or -1: the side an axis was last moved from; turns after a travel of `threshold` mm against
               it. On a recording the axis' direction column wins, then its velocity's sign, then positions.
    approach   z[k] = d - (d - z[k-1]) * exp(-|x[k] - x[k-1]| / length), d the direction; z[0] = d[0]:
               what builds up over the first travel after a reversal, then saturates
    lookup     linear interpolation in a small uniform table, held at its ends
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from errpipe.domain.recording import Frozen


class Constant(Frozen):
    op: Literal["constant"] = "constant"
    value: float = Field(description="The value.", json_schema_extra={"unit": "of the result"})


class Input(Frozen):
    op: Literal["input"] = "input"
    name: str = Field(description="Column of the recording, channel of the controller.")


class Affine(Frozen):
    op: Literal["affine"] = "affine"
    offset: float = Field(0.0, description="What is added to the sum.", json_schema_extra={"unit": "of the result"})
    weights: tuple[float, ...] = Field(
        description="What each operand is multiplied by.", json_schema_extra={"unit": "of the result per operand"}
    )
    of: tuple[Driver, ...] = Field(description="Operands.")


class First(Frozen):
    op: Literal["first"] = "first"
    of: Driver = Field(description="Operand.")


class Lag(Frozen):
    op: Literal["lag"] = "lag"
    of: Driver = Field(description="Operand.")
    tau_up: float = Field(
        gt=0, description="Time constant while the operand is above.", json_schema_extra={"unit": "s"}
    )
    tau_down: float = Field(
        gt=0, description="Time constant while the operand is below.", json_schema_extra={"unit": "s"}
    )
    start: Literal["input", "zero"] = Field("input", description="Value at the start: the operand's, or zero.")


class Product(Frozen):
    op: Literal["product"] = "product"
    of: tuple[Driver, ...] = Field(description="Factors.")


class Power(Frozen):
    op: Literal["power"] = "power"
    of: Driver = Field(description="Operand u.")
    exponent: float = Field(gt=0, description="sign(u) |u|^exponent.", json_schema_extra={"unit": "1"})


class Clip(Frozen):
    op: Literal["clip"] = "clip"
    of: Driver = Field(description="Operand.")
    low: float = Field(description="Lowest value let through.", json_schema_extra={"unit": "of the operand"})
    high: float = Field(description="Highest value let through.", json_schema_extra={"unit": "of the operand"})


class Switch(Frozen):
    op: Literal["switch"] = "switch"
    of: Driver = Field(description="Operand.")
    on: float = Field(description="1 from here up.", json_schema_extra={"unit": "of the operand"})
    off: float = Field(
        description="0 from here down; between the two it stays.", json_schema_extra={"unit": "of the operand"}
    )


class Direction(Frozen):
    op: Literal["direction"] = "direction"
    axis: str = Field(description="Letter of the axis, such as X.")
    threshold: float = Field(
        0.001, ge=0, description="Travel against the direction after which it turns.", json_schema_extra={"unit": "mm"}
    )
    start: Literal[-1, 1] = Field(1, description="Direction before the first travel.")


class Approach(Frozen):
    op: Literal["approach"] = "approach"
    axis: str = Field(description="Letter of the axis, such as X.")
    length: float = Field(
        gt=0, description="Travel after a reversal in which 63 % builds up.", json_schema_extra={"unit": "mm"}
    )
    threshold: float = Field(
        0.001, ge=0, description="Travel against the direction after which it turns.", json_schema_extra={"unit": "mm"}
    )
    start: Literal[-1, 1] = Field(1, description="Direction before the first travel.")


class Lookup(Frozen):
    op: Literal["lookup"] = "lookup"
    of: Driver = Field(description="Operand.")
    start: float = Field(description="Operand at the first value.", json_schema_extra={"unit": "of the operand"})
    step: float = Field(gt=0, description="Distance between two values.", json_schema_extra={"unit": "of the operand"})
    values: tuple[float, ...] = Field(
        min_length=2, description="Values, held beyond both ends.", json_schema_extra={"unit": "of the result"}
    )


Driver = Annotated[
    Constant | Input | Affine | First | Lag | Product | Power | Clip | Switch | Direction | Approach | Lookup,
    Field(discriminator="op"),
]
for _node in (Affine, First, Lag, Product, Power, Clip, Switch, Lookup):
    _node.model_rebuild()

ONE = Constant(value=1.0)


def rise(name: str) -> Affine:
    """Temperature rise of an input over its value at the start of the run, K."""
    source = Input(name=name)
    return Affine(weights=(1.0, -1.0), of=(source, First(of=source)))


def above(name: str, reference: float) -> Affine:
    """Temperature rise of an input over a fixed reference, K."""
    return Affine(offset=-reference, weights=(1.0,), of=(Input(name=name),))


def inputs(driver: Driver) -> tuple[str, ...]:
    """Names of the inputs a driver reads, in order of first use."""
    if isinstance(driver, Input):
        return (driver.name,)
    of = getattr(driver, "of", ())
    children = of if isinstance(of, tuple) else (of,)
    return tuple(dict.fromkeys(name for child in children for name in inputs(child)))
