"""Static analysis of a table: bounds of nodes and outputs, error budget, cost of a cycle.

Slow nodes hold their value between thermal cycles: a held value lies within the node's bounds too. The error by that
delay is computed in `held`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from errpipe.domain import table as t
from errpipe.kernels.arithmetic import power

Span = tuple[float, float]


def input_span(channel: t.TableInput, version: int = 2) -> Span:
    """Range of an input in the table: its validity, else its plausible range.

    In version 1, which does not keep drivers within it, validity and the margin over which the table fades.
    """
    if channel.valid is None:
        return channel.low, channel.high
    margin = (channel.margin or 0.0) if version == 1 else 0.0
    return max(channel.low, channel.valid[0] - margin), min(channel.high, channel.valid[1] + margin)


def node_spans(nodes: Sequence[t.Node], inputs: Sequence[t.TableInput], version: int = 2) -> list[Span]:
    """Lowest and highest value of every node, by interval arithmetic over `input_span`."""
    known = {i.name: input_span(i, version) for i in inputs}
    spans: list[Span] = []
    for node in nodes:
        spans.append(_span(node, [spans[o] for o in node.of], known))
    return spans


def _span(node: t.Node, of: list[Span], inputs: dict[str, Span]) -> Span:
    match node:
        case t.ConstantNode():
            return node.value, node.value
        case t.InputNode():
            return inputs[node.input]
        case t.AffineNode():
            parts = [sorted((w * low, w * high)) for w, (low, high) in zip(node.weights, of, strict=True)]
            return node.offset + sum(p[0] for p in parts), node.offset + sum(p[1] for p in parts)
        case t.LagNode() if node.start == "zero":
            return min(of[0][0], 0.0), max(of[0][1], 0.0)
        case t.FirstNode() | t.LagNode():
            return of[0]
        case t.ProductNode():
            span = of[0]
            for low, high in of[1:]:
                corners = [a * b for a in span for b in (low, high)]
                span = min(corners), max(corners)
            return span
        case t.PowerNode():
            return power(of[0][0], node.exponent), power(of[0][1], node.exponent)
        case t.ClipNode():
            return min(max(of[0][0], node.low), node.high), min(max(of[0][1], node.low), node.high)
        case t.SwitchNode():
            return 0.0, 1.0
        case t.DirectionNode():
            return -1.0, 1.0
        case t.ApproachNode():
            return of[1]
        case t.LookupNode():
            return min(node.values), max(node.values)
    raise TypeError(f"unknown node {node!r}")


def largest(span: Span) -> float:
    """Largest magnitude in a span."""
    return max(abs(span[0]), abs(span[1]))


@dataclass(frozen=True)
class DeviationBounds:
    """Bounds of one component or output in um or urad: of its deviation, and of what gridding and rounding add."""

    name: str
    unit: str
    deviation: float
    gridding: float


def components(table: t.CompensationTable) -> tuple[DeviationBounds, ...]:
    """Largest deviation and error of every component, by interval arithmetic (never too small)."""
    spans = node_spans(table.nodes, table.inputs, table.table)
    out = []
    for component in table.components:
        deviation = gridding = 0.0
        for pair in table.pairs:
            if pair.component == component.name:
                profile = table.profiles[pair.profile]
                factor = largest(spans[pair.driver])
                deviation += factor * profile.scale * max(abs(v) for v in profile.values)
                gridding += factor * (profile.interpolation_error + profile.rounding_error)
        out.append(DeviationBounds(component.name, component.unit, deviation, gridding))
    return tuple(out)


def outputs(table: t.CompensationTable) -> tuple[DeviationBounds, ...]:
    """Largest deviation and error of every output, by interval arithmetic (never too small)."""
    spans = node_spans(table.nodes, table.inputs, table.table)
    reach = {c.name: c for c in components(table)}
    out = []
    for output in table.outputs:
        deviation = gridding = 0.0
        for term in output.terms:
            factor = abs(term.weight)
            for node in term.factors:
                factor *= largest(spans[node])
            deviation += factor * reach[term.component].deviation
            gridding += factor * reach[term.component].gridding
        out.append(DeviationBounds(output.name, output.unit, deviation, gridding))
    return tuple(out)


@dataclass(frozen=True)
class Cost:
    """Worst case of one cycle, counted from the table: floating-point operations, comparisons, memory reads."""

    additions: int
    multiplications: int
    divisions: int
    comparisons: int
    reads: int

    def __add__(self, other: Cost) -> Cost:
        return Cost(*(a + b for a, b in zip(_counts(self), _counts(other), strict=True)))

    @property
    def operations(self) -> int:
        """Additions, multiplications and divisions together."""
        return self.additions + self.multiplications + self.divisions


def _counts(cost: Cost) -> tuple[int, ...]:
    return cost.additions, cost.multiplications, cost.divisions, cost.comparisons, cost.reads


# Counted in kernels/arithmetic.py, largest path: additions, multiplications, divisions, comparisons, reads.
_EXP = Cost(17, 35, 0, 24, 16)
_LN = Cost(26, 62, 1, 24, 13)
_PROFILE = Cost(4, 4, 0, 6, 6)
_PERIODIC = Cost(6, 6, 0, 7, 7)
_RECALL = Cost(4, 0, 0, 12, 8)


def _node_cost(node: t.Node) -> Cost:
    guard = Cost(0, 0, 0, 3, 2)
    n = len(node.of)
    match node:
        case t.AffineNode():
            return guard + Cost(n, n, 0, 0, 2 * n)
        case t.ProductNode():
            return guard + Cost(0, n - 1, 0, 0, n)
        case t.LagNode():
            return guard + Cost(2, 1, 0, 2, 4)
        case t.PowerNode():
            return guard + _EXP + _LN + Cost(0, 1, 0, 5, 2)
        case t.ApproachNode():
            return guard + _RECALL + _EXP + Cost(3, 1, 1, 3, 3)
        case t.DirectionNode():
            return guard + _RECALL + Cost(1, 0, 0, 5, 3)
        case t.LookupNode():
            return guard + _PROFILE
        case t.ClipNode() | t.SwitchNode():
            return guard + Cost(0, 0, 0, 2, 3)
    return guard + Cost(0, 0, 0, 0, 1)


def _input_cost(channel: t.TableInput) -> Cost:
    own = Cost(3, 1, 0, 11, 8)
    if channel.valid is not None:
        own += Cost(2, 0, 1, 5, 4)
    return own + Cost(len(channel.substitute), len(channel.substitute), 0, 2, 2 * len(channel.substitute))


def _output_cost(output: t.Output) -> Cost:
    own = Cost(1, 3, 0, 5, 3)
    if output.slew is not None or output.acceleration is not None:
        own += Cost(10, 10, 0, 12, 4)
    for term in output.terms:
        own += Cost(1, 1 + len(term.factors), 0, 0, 2 + len(term.factors))
    return own


def cost(table: t.CompensationTable) -> tuple[Cost, Cost]:
    """(of a position cycle, of a cycle that is a thermal one too), worst case. Approximate to a few per cent."""
    always = Cost(2, 1, 2, 10, 8)
    for channel in table.inputs:
        always += _input_cost(channel)
    for profile in table.profiles:
        always += Cost(0, 1, 0, 0, 1) if profile.input is None else _PERIODIC if profile.periodic else _PROFILE
    always += Cost(len(table.pairs), 2 * len(table.pairs), 0, len(table.pairs), 4 * len(table.pairs))
    for output in table.outputs:
        always += _output_cost(output)
    slow = Cost(0, 0, 0, 0, 0)
    for node in table.nodes:
        if node.slow:
            slow += _node_cost(node)
        else:
            always += _node_cost(node)
    return always, always + slow


# Instructions of the C runtime on a Cortex-M4 (single precision, gcc -O2): the smallest counts that hold the slowest of
# 300 cycles in QEMU, for 180 random tables (`everything` of the tests, seeds 0 to 79 and 100 to 199) and 8 of the
# benches. A node counts its own and those of its operands.
_NODE_INSTRUCTIONS: dict[type[t.Node], tuple[int, int]] = {
    t.AffineNode: (64, 18),
    t.ApproachNode: (134, 0),
    t.ClipNode: (75, 0),
    t.ConstantNode: (57, 0),
    t.DirectionNode: (118, 0),
    t.FirstNode: (82, 0),
    t.InputNode: (47, 0),
    t.LagNode: (53, 0),
    t.LookupNode: (54, 0),
    t.PowerNode: (172, 0),
    t.ProductNode: (31, 24),
    t.SwitchNode: (63, 0),
}
_PER_CYCLE = 280  # of a cycle without anything
_PER_INPUT, _PER_RATE, _PER_VALIDITY, _PER_SUBSTITUTE = 77, 16, 44, 18
_PER_CONSTANT_PROFILE, _PER_PROFILE, _PER_PERIODIC_PROFILE, _PER_PAIR = 34, 58, 72, 13
_PER_OUTPUT, _PER_LIMITED_OUTPUT, _PER_FACTOR = 64, 66, 9
_MARGIN = 1.1  # for paths that 300 cycles did not take


def cortex_m4_instructions(table: t.CompensationTable) -> int:
    """At most so many instructions a cycle on a Cortex-M4 in single precision; caches and wait states are not in it.

    An envelope of counts in an emulator with a margin of 10 %, not a proof: `bench/bench_cortex.py` counts.
    """
    count = _PER_CYCLE
    for channel in table.inputs:
        count += _PER_INPUT + _PER_SUBSTITUTE * len(channel.substitute)
        count += (channel.max_rate is not None) * _PER_RATE + (channel.valid is not None) * _PER_VALIDITY
    for node in table.nodes:
        own, each = _NODE_INSTRUCTIONS[type(node)]
        count += own + each * len(node.of)
    for profile in table.profiles:
        periodic = _PER_PERIODIC_PROFILE if profile.periodic else _PER_PROFILE
        count += _PER_CONSTANT_PROFILE if profile.input is None else periodic
    count += _PER_PAIR * len(table.pairs)
    for output in table.outputs:
        count += _PER_OUTPUT + _PER_FACTOR * sum(len(term.factors) for term in output.terms)
        count += (output.slew is not None or output.acceleration is not None) * _PER_LIMITED_OUTPUT
    return math.ceil(_MARGIN * count)


# Bytes of one record of the C runtime's work area on a 64-bit machine in double, and on a 32-bit one in single.
_WORK = {8: (176, 16, 88, 16, 8, 64, 8, 32, 88, 56, 4), 4: (96, 8, 56, 8, 4, 36, 4, 16, 48, 28, 4)}


def work_bytes(table: t.CompensationTable, real: int = 8) -> int:
    """Working memory the C runtime needs in addition to the table, bytes: `ect_work_size` on a 64-bit machine.

    real: 8 in double precision, 4 in single precision on a 32-bit machine.
    """
    counts = (
        len(table.inputs),
        sum(len(i.substitute) for i in table.inputs),
        len(table.nodes),
        sum(len(n.of) for n in table.nodes),
        sum(len(n.values) for n in table.nodes if isinstance(n, t.LookupNode)),
        len(table.profiles),
        len(table.components),
        len(table.pairs),
        len(table.outputs),
        sum(len(o.terms) for o in table.outputs),
        len(table.nodes),
    )
    return sum(-(-count * each // 8) * 8 for count, each in zip(counts, _WORK[real], strict=True))
