"""Largest lag of corrections, because slow nodes hold their value between two thermal cycles.

`bounds` gives the range of a table, also of held values. The effect of holding them is at most what a
slow node can change by within one thermal cycle, carried through the nodes, pairs and outputs that use it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from errpipe.domain import table as t
from errpipe.tables import bounds
from errpipe.tables.bounds import Span, largest

USUAL = 1.0 / 60.0  # per s: a temperature of a machine in use moves by a kelvin a minute at most


@dataclass(frozen=True)
class HoldLag:
    """One output: the most its deviation can be behind, um or urad."""

    output: str
    unit: str
    largest: float


def outputs(table: t.CompensationTable, otherwise: float = math.inf) -> tuple[HoldLag, ...]:
    """Worst case per output, never too small; readings that fail (and jump to their substitute) are not counted.

    otherwise: largest change of an input that states no `max_rate`, per s. Without it such an input may cross its
    whole range within a cycle, and is counted so.
    """
    spans = bounds.node_spans(table.nodes, table.inputs, table.table)
    behind = _behind(table, spans, otherwise)
    reach = {c.name: c.deviation for c in bounds.components(table)}
    lag = dict.fromkeys(reach, 0.0)
    for pair in table.pairs:
        profile = table.profiles[pair.profile]
        lag[pair.component] += behind[pair.driver] * profile.scale * max(abs(v) for v in profile.values)
    out = []
    for output in table.outputs:
        total = 0.0
        for term in output.terms:
            sizes = [reach[term.component], *(largest(spans[n]) for n in term.factors)]
            lags = [lag[term.component], *(behind[n] for n in term.factors)]
            total += abs(term.weight) * _of_product(lags, sizes)
        out.append(HoldLag(output.name, output.unit, total))
    return tuple(out)


def _behind(table: t.CompensationTable, spans: Sequence[Span], otherwise: float) -> list[float]:
    """Per node: the most its value can differ from one that is recomputed in every cycle."""
    hold = table.position_cycle_s * (table.slow_every - 1)
    rates = _rates(table, spans, otherwise)
    behind: list[float] = []
    for number, node in enumerate(table.nodes):
        span, of = spans[number], [spans[o] for o in node.of]
        if not node.slow or hold <= 0:
            lag = _carried(node, [behind[o] for o in node.of], of)
        else:
            lag = rates[number] * hold
            if isinstance(node, t.LagNode):  # it takes its operand for held since the cycle before
                lag += rates[node.of[0]] * table.thermal_cycle_s
        behind.append(min(lag, span[1] - span[0]))
    return behind


def _rates(table: t.CompensationTable, spans: Sequence[Span], otherwise: float) -> list[float]:
    """Per node: largest change of its value in a second; infinite if unknown."""
    known = {i.name: i.max_rate or otherwise for i in table.inputs}
    rates: list[float] = []
    for number, node in enumerate(table.nodes):
        of, width = [rates[o] for o in node.of], spans[number][1] - spans[number][0]
        if isinstance(node, t.InputNode):
            rates.append(known[node.input])
        elif isinstance(node, t.LagNode):
            quick, slow = sorted((node.tau_up, node.tau_down))
            follows = of[0] * slow / quick if node.start == "input" else math.inf
            rates.append(min(follows, width / quick))
        else:
            rates.append(_carried(node, of, [spans[o] for o in node.of]))
    return rates


def _carried(node: t.Node, change: list[float], of: list[Span]) -> float:
    """What changes of the operands make of the result: the largest slope times each."""
    if not any(change) or isinstance(node, t.FirstNode | t.ConstantNode | t.InputNode):
        return 0.0
    match node:
        case t.AffineNode():
            return sum(abs(w) * c for w, c in zip(node.weights, change, strict=True) if c)
        case t.ProductNode():
            return _of_product(change, [largest(s) for s in of])
        case t.ClipNode() | t.LagNode():
            return change[0]
        case t.LookupNode():
            return max(abs(b - a) for a, b in zip(node.values, node.values[1:], strict=False)) / node.step * change[0]
        case t.PowerNode():
            nearest = 0.0 if of[0][0] <= 0 <= of[0][1] else min(abs(of[0][0]), abs(of[0][1]))
            at = largest(of[0]) if node.exponent >= 1 else nearest
            return math.inf if at == 0 else node.exponent * at ** (node.exponent - 1) * change[0]
    return math.inf  # switch, direction, approach: they jump; their span bounds it


def _of_product(change: list[float], sizes: list[float]) -> float:
    """Sum over the factors of its change times the sizes of the others; a change of 0 counts as none."""
    total = 0.0
    for n, c in enumerate(change):
        if c:
            total += c * math.prod(s for k, s in enumerate(sizes) if k != n)
    return total
