"""Drivers lowered to the nodes of a table: each structure once, operands before what reads them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import get_args

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.errors import GateError

# A lag this many thermal cycles long runs in thermal cycles: a single-precision controller would lose it in a
# position cycle, where it moves by less than a rounding.
SLOW_LAG_CYCLES = 20.0

MAX_OPERANDS = t.AffineNode.operands[1]  # of one node; a longer sum is one of sums

_NODES = {node.model_fields["op"].default: node for node in get_args(get_args(t.AnyNode)[0])}


@dataclass
class Nodes:
    """Nodes under construction, each structure once."""

    inputs: dict[str, t.TableInput]
    thermal_cycle_s: float
    nodes: list[t.Node] = field(default_factory=list)
    numbers: dict[t.Node, int] = field(default_factory=dict)
    seen: dict[tuple[int, bool], tuple[d.Driver, int]] = field(default_factory=dict)

    def add(self, node: t.Node) -> int:
        """Number of a node, new or known."""
        if node not in self.numbers:
            self.numbers[node] = len(self.nodes)
            self.nodes.append(node)
        return self.numbers[node]

    def read(self, name: str, slow: bool) -> int:
        """The node of an input. Raises GateError for an undescribed input."""
        if name not in self.inputs:
            raise GateError(f"a driver reads {name!r}, which is not an input of the table ({', '.join(self.inputs)})")
        return self.add(t.InputNode(input=name, slow=slow or not self.inputs[name].fast))

    def position(self, axis: str) -> t.TableInput:
        """The input that holds the position of an axis. Raises GateError if there is none."""
        for channel in self.inputs.values():
            if channel.kind == "position" and channel.axis == axis:
                return channel
        raise GateError(f"no input holds the position of axis {axis}")

    def compile(self, driver: d.Driver, slow: bool = False) -> int:
        """Number of the node that computes a driver; slow: everything below it is only needed in thermal cycles.

        A driver that is met again, as parts shared by many drivers are, is not walked again.
        """
        key = (id(driver), slow)
        if key not in self.seen:
            self.seen[key] = (driver, self._walk(driver, slow))
        return self.seen[key][1]

    def _walk(self, driver: d.Driver, slow: bool) -> int:
        match driver:
            case d.Constant():
                return self.add(t.ConstantNode(value=driver.value, slow=True))
            case d.Input():
                return self.read(driver.name, slow)
            case d.Direction():
                return self.direction(driver.axis, driver.threshold, driver.start)
            case d.Approach():
                side = self.direction(driver.axis, driver.threshold, driver.start)
                place = self.read(self.position(driver.axis).name, False)
                return self.add(t.ApproachNode(of=(place, side), length=driver.length, threshold=driver.threshold))
            case d.Lag():
                slow = slow or min(driver.tau_up, driver.tau_down) >= SLOW_LAG_CYCLES * self.thermal_cycle_s
        if isinstance(driver, d.Affine) and len(driver.of) > MAX_OPERANDS:
            driver = _nested(driver)
        children = driver.of if isinstance(driver.of, tuple) else (driver.of,)
        of = tuple(self.compile(child, slow) for child in children)
        if len(of) == 1 and (isinstance(driver, d.Product) or driver == d.Affine(weights=(1.0,), of=(children[0],))):
            return of[0]
        slow = slow or all(self.nodes[o].slow for o in of)
        own = {name: getattr(driver, name) for name in type(driver).model_fields if name not in ("op", "of")}
        return self.add(_NODES[driver.op](of=of, slow=slow, **own))

    def direction(self, axis: str, threshold: float, start: int) -> int:
        """The node of an axis' direction of travel; an input with the direction is preferred."""
        of = [self.read(self.position(axis).name, False)]
        for kind in ("direction", "velocity"):
            known = [i.name for i in self.inputs.values() if i.kind == kind and i.axis == axis]
            if known:
                of.append(self.read(known[0], False))
                break
        return self.add(t.DirectionNode(of=tuple(of), threshold=threshold, start=start))

    def reads(self, number: int) -> set[str]:
        """Names of the inputs below a node."""
        below = {number}
        for n in range(number, -1, -1):  # operands come before their node: each is met once
            if n in below:
                below.update(self.nodes[n].of)
        return {node.input for node in (self.nodes[n] for n in below) if isinstance(node, t.InputNode)}


def _nested(driver: d.Affine) -> d.Affine:
    """A sum of more operands than a node takes, as a sum of sums."""
    pairs = list(zip(driver.weights, driver.of, strict=True))
    parts = [pairs[k : k + MAX_OPERANDS] for k in range(0, len(pairs), MAX_OPERANDS)]
    sums = tuple(d.Affine(weights=tuple(w for w, _ in part), of=tuple(o for _, o in part)) for part in parts)
    return d.Affine(offset=driver.offset, weights=(1.0,) * len(sums), of=sums)
