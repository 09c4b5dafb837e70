"""The specification of the compensation table alone is enough: a second reader, written from it, against the first.

Both must give every bit of the golden vectors, of random tables under random readings and of the edges where two
rules meet (test_second_reader_edges.py), and must accept or refuse the same damaged files (…_damage.py).
"""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from errpipe.domain import table as t
from errpipe.tables import ect, reference
from tests.contract import second_reader
from tests.contract.second_agreement import agree, bits, given, golden
from tests.contract.second_cycle import Evaluator
from tests.contract.second_functions import Single
from tests.golden import vectors
from tests.unit.tables.made import everything, modes, stimulus
from tests.unit.targets.c import test_c_runtime as c

NAMES = vectors.names()
every = pytest.mark.parametrize("number", range(len(NAMES)), ids=NAMES)
# Random tables that between them use every branch of sections 5 to 8 that random readings reach.
SEEDS = (0, 1, 2, 18, 28, 47, 48, 81, 174, 181, 196)


def test_it_needs_nothing_of_the_package():
    for name in ("reader", "cycle", "functions"):
        tree = ast.parse((Path(__file__).parent / f"second_{name}.py").read_text(encoding="utf-8"))
        modules = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
        modules |= {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
        plain = {"math", "struct", "zlib", "typing", "collections.abc"}
        assert {m for m in modules if not m.startswith("tests.contract.second_")} <= plain


@every
def test_golden_vectors_to_the_bit(number):
    name, data, readings, fresh, enable, results, status = golden()[number]
    assert name == NAMES[number]
    evaluator = Evaluator(second_reader.load(data))
    for k, row in enumerate(readings):
        cycle = evaluator.cycle(int(enable[k]), given(row, fresh[k]))
        assert bits(cycle.deviations + cycle.corrections) == bits(results[k])
        assert (cycle.status, cycle.heartbeat) == (status[k], k + 1)


@every
def test_after_a_reset_corrections_go_on_from_where_they_stand(number):
    _, data, readings, fresh, enable, *_ = golden()[number]
    table = ect.loads(data)
    first, second = reference.Evaluator(table), Evaluator(second_reader.load(data))
    for k in (*range(40), -1, *range(40)):
        if k < 0:
            before = dict(zip(names_of(table), (s.c for s in second.outputs), strict=True))
            first.reset()
            second.reset()
            assert table.table == 1 or before == dict(zip(names_of(table), (s.c for s in second.outputs), strict=True))
            continue
        k = min(k, len(readings) - 1)
        values = given(readings[k], fresh[k])
        known = {i.name: v for i, v in zip(table.inputs, values, strict=True) if v is not None}
        theirs, ours = first.cycle(known, **modes(enable[k])), second.cycle(int(enable[k]), values)
        assert bits(ours.corrections) == bits(theirs.correction.values()), k
        assert (ours.status, ours.heartbeat) == (theirs.status, theirs.heartbeat)


def names_of(table: t.CompensationTable) -> list[str]:
    return [o.name for o in table.outputs]


@every
def test_golden_tables_under_other_readings(number):
    table = ect.loads(golden()[number][1])
    agree(table, *stimulus(table, 150, number))


@pytest.mark.parametrize("seed", SEEDS)
def test_random_tables(seed):
    table = everything(seed)
    agree(table, *stimulus(table, 250, seed))


@pytest.mark.slow
def test_many_random_tables_visit_every_status_bit():
    visited = 0
    for seed in range(1000, 1150):
        table = everything(seed)
        visited |= agree(table, *stimulus(table, 300, seed))
    assert visited == (1 << len(t.STATUS)) - 1


# single precision ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    return c.Library(c.build(tmp_path_factory.mktemp("c"), "-DECT_SINGLE"), np.float32)


@pytest.mark.toolchain
@pytest.mark.skipif(not c.COMPILERS, reason="no C compiler on this machine")
@every
def test_single_precision_is_the_c_runtime_to_the_bit(number, single):
    _, data, readings, fresh, enable, results, _ = golden()[number]
    evaluator = Evaluator(second_reader.load(data), Single)
    with np.errstate(over="ignore"):
        theirs = single.stream(ect.loads(data), readings, fresh, enable)
    for k, row in enumerate(readings):
        cycle = evaluator.cycle(int(enable[k]), given(row, fresh[k]))
        assert bits(cycle.deviations) == bits(theirs[0][k])
        assert bits(cycle.corrections) == bits(theirs[1][k])
        assert cycle.status == theirs[2][k]
        wanted = results[k][: len(cycle.deviations)]
        bound = vectors.single_bound(NAMES[number], results[:, : len(cycle.deviations)])
        assert np.abs(np.subtract(cycle.deviations, wanted)).max() <= bound
