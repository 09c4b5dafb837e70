"""The twelve operations of a driver: name, parameters, units and what each does, stated once.

A driver (`domain/driver.py`) is a tree of them, a compiled table (`domain/table.py`) a numbered list of them: both
take their parameters from here. `drivers/` evaluates a tree over a recording and lowers it to the list;
`tables/reference.py` is what a controller computes of the list.

Semantics of each operation at step k (dt = time since the step before). States start at the first step of a session: a
controller's power-on; in a recording, a run, and with it the runs that follow it in time, because heat does
not stop between runs (a prediction evaluates every run separately):

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

from errpipe.domain.recording import FrozenModel
from errpipe.yamlfile import quantity

LARGEST_NUMBER = 1e15  # of any parameter: keeps a single-precision controller away from overflow

Number = Annotated[float, Field(ge=-LARGEST_NUMBER, le=LARGEST_NUMBER)]
Positive = Annotated[float, Field(gt=1e-15, le=LARGEST_NUMBER)]
NotNegative = Annotated[float, Field(ge=0, le=LARGEST_NUMBER)]


class Operation(FrozenModel):
    """Base of all: `op` names the operation, the other fields are its parameters."""


class Constant(Operation):
    op: Literal["constant"] = "constant"
    value: Number = quantity("of the result", "The value.")


class Affine(Operation):
    op: Literal["affine"] = "affine"
    offset: Number = quantity("of the result", "What is added to the sum.", 0.0)
    weights: tuple[Number, ...] = quantity("of the result per operand", "What each operand is multiplied by.")


class First(Operation):
    op: Literal["first"] = "first"


class Lag(Operation):
    op: Literal["lag"] = "lag"
    tau_up: Positive = quantity("s", "Time constant while the operand is above.")
    tau_down: Positive = quantity("s", "Time constant while the operand is below.")
    start: Literal["input", "zero"] = Field("input", description="Value at the start: the operand's, or zero.")


class Product(Operation):
    op: Literal["product"] = "product"


class Power(Operation):
    op: Literal["power"] = "power"
    exponent: Annotated[float, Field(gt=0, le=16)] = quantity("1", "sign(u) |u|^exponent.")


class Clip(Operation):
    op: Literal["clip"] = "clip"
    low: Number = quantity("of the operand", "Lowest output.")
    high: Number = quantity("of the operand", "Highest output.")


class Switch(Operation):
    op: Literal["switch"] = "switch"
    on: Number = quantity("of the operand", "1 at or above this value.")
    off: Number = quantity("of the operand", "0 at or below this value; unchanged in between (hysteresis).")


class Turning(Operation):
    """Parameters of what turns with the direction of travel."""

    threshold: NotNegative = quantity("mm", "Travel against the direction after which it turns.", 0.001)
    start: Literal[-1, 1] = Field(1, description="Direction before the first travel.")


class Direction(Turning):
    op: Literal["direction"] = "direction"


class Approach(Operation):
    op: Literal["approach"] = "approach"
    length: Positive = quantity("mm", "Travel after a reversal in which 63 % builds up.")


class Lookup(Operation):
    op: Literal["lookup"] = "lookup"
    start: Number = quantity("of the operand", "Operand at the first value.")
    step: Positive = quantity("of the operand", "Distance between two values.")
    values: tuple[Number, ...] = quantity("of the result", "Values, held beyond both ends.", min_length=2)
