"""A guard in a compiled table: whether there is one, and the table without it.

The steady states of a table, which formats without memory export, are evaluated without a guard: every settled sensor
is constant, which a guard reports as a fault.
"""

from __future__ import annotations

from functools import lru_cache

from errpipe.domain import table as t
from errpipe.guard.detect import FADE_S
from errpipe.guard.replace import NEWLY_S


def has_guard(table: t.CompensationTable) -> bool:
    """Whether the table contains a sensor guard."""
    return bool(_gates(table))


def has_substitutes(table: t.CompensationTable) -> bool:
    """Whether a guarded table contains estimates of sensors from each other."""
    return any(_guarded_input(table, node) is not None and _estimates(table, node) for node in table.nodes)


def without_guard(table: t.CompensationTable) -> t.CompensationTable:
    """The table with plain readings, and without the gate of its guard; unchanged if it has none."""
    return _without(table) if _gates(table) else table


def _gates(table: t.CompensationTable) -> set[int]:
    """Numbers of the nodes that fade a correction when readings are not trusted (`detect.trust`)."""
    out = set()
    for number, node in enumerate(table.nodes):
        if isinstance(node, t.LagNode) and node.tau_up == node.tau_down == FADE_S:
            clip = table.nodes[node.of[0]]
            none_of = table.nodes[clip.of[0]] if isinstance(clip, t.ClipNode) else None
            if isinstance(none_of, t.AffineNode) and none_of.offset == 1.0 and set(none_of.weights) == {-1.0}:
                out.add(number)
    return out


def _guarded_input(table: t.CompensationTable, node: t.Node) -> int | None:
    """Number of the input whose guarded reading a node is (`replace.readings`, clipped); else None."""
    if not isinstance(node, t.ClipNode):
        return None
    shift = table.nodes[node.of[0]]
    if not isinstance(shift, t.AffineNode) or shift.weights != (1.0, -1.0) or shift.offset:
        return None
    reading, fault = shift.of
    is_one = isinstance(table.nodes[reading], t.InputNode) and isinstance(table.nodes[fault], t.ProductNode)
    return reading if is_one else None


def _estimates(table: t.CompensationTable, node: t.Node) -> bool:
    """Whether the replacement of a guarded reading depends on other sensors."""
    below = {node.of[0]}
    for n in range(max(below), -1, -1):
        if n in below:
            below.update(table.nodes[n].of)
    moved = [table.nodes[n] for n in below if isinstance(table.nodes[n], t.FirstNode)]
    return any(isinstance(table.nodes[m.of[0]], t.AffineNode) for m in moved)


def _is_missed_rise(table: t.CompensationTable, node: t.Node) -> bool:
    """Whether a node is the estimated rise of a sensor before its first reading (`replace`)."""
    if isinstance(node, t.FirstNode) and isinstance(table.nodes[node.of[0]], t.ProductNode):
        newly = table.nodes[table.nodes[node.of[0]].of[-1]]
        there = table.nodes[newly.of[0]] if isinstance(newly, t.AffineNode) else None
        return isinstance(there, t.LagNode) and there.tau_up == there.tau_down == NEWLY_S
    late = table.nodes[node.of[0]] if isinstance(node, t.ProductNode) else None
    when = table.nodes[late.of[0]] if isinstance(late, t.ClipNode) else None
    if not isinstance(when, t.AffineNode):
        return False
    first = [table.nodes[n] for n in when.of]
    clocks = [table.nodes[n.of[0]] for n in first if isinstance(n, t.FirstNode)]
    return len(clocks) == len(first) and all(isinstance(c, t.AffineNode) and c.weights == (1.0, 0.0) for c in clocks)


def _is_no_change(table: t.CompensationTable, node: t.Node, of: list[int], no_change: set[int]) -> bool:
    """Whether a node is zero without a guard, by its operands: a difference of equals, or a sum or lag of such.

    Equal is also the rise of a sensor beyond its estimate and its clipped value (`replace`).
    """
    if isinstance(node, t.AffineNode) and node.weights == (1.0, -1.0) and not node.offset:
        clip, beyond = (table.nodes[n] for n in node.of)
        if of[0] == of[1] or (isinstance(clip, t.ClipNode) and clip.of == node.of[1:] and _is_rise(table, beyond)):
            return True
    linear = isinstance(node, t.LagNode) or (isinstance(node, t.AffineNode) and not node.offset)
    return linear and bool(of) and no_change.issuperset(of)


def _is_rise(table: t.CompensationTable, node: t.Node) -> bool:
    """Whether a node is a sum minus its own value at the start of the run."""
    if not isinstance(node, t.AffineNode) or node.weights != (1.0, -1.0):
        return False
    first = table.nodes[node.of[1]]
    return (
        isinstance(first, t.FirstNode)
        and first.of == node.of[:1]
        and isinstance(table.nodes[first.of[0]], t.AffineNode)
    )


@lru_cache(maxsize=4)
def _without(table: t.CompensationTable) -> t.CompensationTable:
    gates = _gates(table)
    stand_for: dict[int, int] = {}
    no_change: set[int] = set()
    seen: dict[t.Node, int] = {}  # what was bent with guarded readings equals what was bent with plain ones

    def source(number: int) -> int:
        while number in stand_for:
            number = stand_for[number]
        return number

    for number, node in enumerate(table.nodes):
        reading = _guarded_input(table, node)
        if reading is not None:
            stand_for[number] = reading
        elif isinstance(node, t.ProductNode) and len(node.of) == 2 and node.of[1] in gates:
            stand_for[number] = node.of[0]
        elif isinstance(node, t.AffineNode) and node.weights == (1.0, 1.0) and source(node.of[1]) in no_change:
            stand_for[number] = node.of[0]  # a driver plus what the guard changes of it
        elif _is_missed_rise(table, node) or _is_no_change(table, node, [source(n) for n in node.of], no_change):
            no_change.add(number)
        if number not in stand_for:
            same = node.model_copy(update={"of": tuple(source(n) for n in node.of)})
            if (earlier := seen.setdefault(same, number)) != number:
                stand_for[number] = earlier

    factors = {f for o in table.outputs for m in o.terms for f in m.factors}
    wanted = {source(n) for n in factors | {p.driver for p in table.pairs}}
    for number in range(len(table.nodes) - 1, -1, -1):
        if number in wanted:
            wanted |= {source(k) for k in table.nodes[number].of}
    place = {number: k for k, number in enumerate(sorted(wanted))}
    nodes = tuple(
        table.nodes[n].model_copy(update={"of": tuple(place[source(k)] for k in table.nodes[n].of)}) for n in place
    )
    pairs = tuple(p.model_copy(update={"driver": place[source(p.driver)]}) for p in table.pairs)
    outputs = tuple(
        o.model_copy(
            update={
                "terms": tuple(
                    m.model_copy(update={"factors": tuple(place[source(f)] for f in m.factors)}) for m in o.terms
                )
            }
        )
        for o in table.outputs
    )
    return table.model_copy(update={"nodes": nodes, "pairs": pairs, "outputs": outputs})
