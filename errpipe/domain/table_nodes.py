"""Nodes of a compensation table: the operations of a driver, each on earlier nodes."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from errpipe.domain import operations
from errpipe.domain.operations import NotNegative
from errpipe.domain.table_text import Index, Name, Part
from errpipe.yamlfile import quantity


class Node(Part):
    """One operation on earlier nodes (`of` are their numbers). slow: runs in thermal cycles only."""

    slow: bool = Field(False, description="Runs in thermal cycles only.")
    of: tuple[Index, ...] = Field((), description="Numbers of the nodes it reads, all of them earlier ones.")

    operands: ClassVar[tuple[int, int]] = (1, 1)  # fewest and most operands


class ConstantNode(operations.Constant, Node):
    operands: ClassVar = (0, 0)


class InputNode(Node):
    operands: ClassVar = (0, 0)
    op: Literal["input"] = "input"
    input: Name = Field(description="Name of the input.")


class AffineNode(operations.Affine, Node):
    operands: ClassVar = (1, 64)


class FirstNode(operations.First, Node):
    operands: ClassVar = (1, 1)


class LagNode(operations.Lag, Node):
    operands: ClassVar = (1, 1)


class ProductNode(operations.Product, Node):
    operands: ClassVar = (1, 16)


class PowerNode(operations.Power, Node):
    operands: ClassVar = (1, 1)


class ClipNode(operations.Clip, Node):
    operands: ClassVar = (1, 1)


class SwitchNode(operations.Switch, Node):
    operands: ClassVar = (1, 1)


class DirectionNode(operations.Direction, Node):
    """Operands: the position, and, if there is one, the input of the direction (sign, 0 unknown)."""

    operands: ClassVar = (1, 2)


class ApproachNode(operations.Approach, Node):
    """Operands: the position and its direction."""

    operands: ClassVar = (2, 2)
    threshold: NotNegative = quantity(
        "mm", "Readings no further apart than this agree; one alone between two that do is undone.", 0.0
    )


class LookupNode(operations.Lookup, Node):
    operands: ClassVar = (1, 1)


AnyNode = Annotated[
    ConstantNode
    | InputNode
    | AffineNode
    | FirstNode
    | LagNode
    | ProductNode
    | PowerNode
    | ClipNode
    | SwitchNode
    | DirectionNode
    | ApproachNode
    | LookupNode,
    Field(discriminator="op"),
]


def check_node(number: int, node: AnyNode, inputs: set[str]) -> None:
    """Raise ValueError if a node reads a later or missing one, or is inconsistent."""
    fewest, most = node.operands
    if not fewest <= len(node.of) <= most:
        raise ValueError(f"node {number} ({node.op}): {len(node.of)} operands (allowed: {fewest}..{most})")
    for operand in node.of:
        if operand >= number:
            raise ValueError(f"node {number} ({node.op}): operand {operand} does not come before it")
    if isinstance(node, InputNode) and node.input not in inputs:
        raise ValueError(f"node {number}: input {node.input!r} is not in the table")
    if isinstance(node, AffineNode) and len(node.weights) != len(node.of):
        raise ValueError(f"node {number}: {len(node.weights)} weights for {len(node.of)} operands")
    if isinstance(node, ClipNode) and not node.low <= node.high:
        raise ValueError(f"node {number}: clip range is reversed")
    if isinstance(node, SwitchNode) and not node.off <= node.on:
        raise ValueError(f"node {number}: switch turns off above where it turns on")
