"""What both evaluators say of a table, compared bit by bit: the second one was written from the specification."""

from __future__ import annotations

from functools import cache

from errpipe.domain import table as t
from errpipe.tables import ect, reference
from tests.contract import second_reader
from tests.contract.second_cycle import Evaluator
from tests.golden import vectors
from tests.unit.tables.made import modes


@cache
def golden():
    return vectors.golden()


def bits(numbers) -> list[str]:
    """Every bit of some numbers, the sign of a zero too."""
    return [float(x).hex() for x in numbers]


def given(row, fresh) -> list[float | None]:
    """Readings of one cycle: None where there is no new one."""
    return [float(v) if new else None for v, new in zip(row, fresh, strict=True)]


def agree(table: t.CompensationTable, readings, fresh, enable) -> int:
    """Run both evaluators side by side; the status bits that were visited."""
    first, second = reference.Evaluator(table), Evaluator(second_reader.load(ect.dumps(table)))
    names = [i.name for i in table.inputs]
    visited = 0
    for k, row in enumerate(readings):
        values = given(row, fresh[k])
        theirs = first.cycle({n: v for n, v in zip(names, values, strict=True) if v is not None}, **modes(enable[k]))
        ours = second.cycle(int(enable[k]), values)
        assert bits(ours.deviations) == bits(theirs.deviation.values()), k
        assert bits(ours.corrections) == bits(theirs.correction.values()), k
        assert bits(s.y for s in second.nodes) == bits(first.nodes()), k
        assert (ours.status, ours.heartbeat) == (theirs.status, theirs.heartbeat), k
        assert [t.FAULTS[f] for f in ours.faults] == list(theirs.faults.values()), k
        assert ours.rejected == list(theirs.rejected.values()), k
        assert [t.SOURCES[s] for s in ours.sources] == list(theirs.sources.values()), k
        visited |= ours.status
    return visited
