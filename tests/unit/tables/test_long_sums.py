"""A sum of more operands than a node of the table takes is lowered to a sum of sums."""

from __future__ import annotations

import pytest

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowering import MAX_OPERANDS, Nodes


@pytest.mark.parametrize("count", [MAX_OPERANDS, MAX_OPERANDS + 1, 3 * MAX_OPERANDS + 5])
def test_a_long_sum_keeps_every_operand_and_weight(count: int) -> None:
    names = [f"T{k}" for k in range(count)]
    reading = {"kind": "sensor", "unit": "degC", "low": 0.0, "high": 60.0, "default": 20.0}
    nodes = Nodes({n: t.TableInput.model_validate({"name": n, **reading}) for n in names}, 1.0)
    total = d.Affine(
        offset=7.0, weights=tuple(float(k + 1) for k in range(count)), of=tuple(d.Input(name=n) for n in names)
    )
    last = nodes.compile(total)
    values: list[float] = []
    for node in nodes.nodes:
        if isinstance(node, t.InputNode):
            values.append(1.0)
        elif isinstance(node, t.AffineNode):
            assert len(node.of) <= MAX_OPERANDS
            values.append(node.offset + sum(w * values[o] for w, o in zip(node.weights, node.of, strict=True)))
    assert values[last] == pytest.approx(7.0 + count * (count + 1) / 2)
