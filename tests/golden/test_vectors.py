"""Every runtime on the golden vectors: to the bit in double, in single precision as near as its head says."""

from __future__ import annotations

import shutil
from functools import cache

import numpy as np
import pytest

from errpipe.domain import table as t
from errpipe.tables import ect
from errpipe.tables.reference import Evaluator
from errpipe.targets import iec_st
from tests.golden import vectors
from tests.unit.tables.made import modes
from tests.unit.targets.c import test_c_runtime as c
from tests.unit.targets.st import test_iec_st as st
from tests.unit.targets.st import translate


@cache
def golden():
    return vectors.golden()


NAMES = vectors.names()
AT_RATE = 1 << t.STATUS.index("at_rate")
every = pytest.mark.parametrize("number", range(len(NAMES)), ids=NAMES)
needs_c = pytest.mark.skipif(not c.COMPILERS, reason="no C compiler on this machine")
needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")


@every
def test_reference(number):
    """If this fails, tables mean something else than before: that needs a new format version."""
    name, data, readings, fresh, enable, results, status = golden()[number]
    assert name == NAMES[number]
    evaluator = Evaluator(ect.loads(data))
    names = [i.name for i in evaluator.table.inputs]
    for k, row in enumerate(readings):
        given = {n: v for n, v, new in zip(names, row, fresh[k], strict=True) if new}
        cycle = evaluator.cycle(given, **modes(enable[k]))
        assert [*cycle.deviation.values(), *cycle.correction.values()] == results[k].tolist()
        assert cycle.status == status[k]


@pytest.mark.parametrize("number", range(len(vectors.NAMES)), ids=vectors.NAMES)
def test_the_compiler_still_makes_these_tables(number):
    """Up to one step of a profile value and the last bits of a stated error, which depend on the machine's sine."""
    (made,) = [b.table for n, b in enumerate(vectors.blocks()) if n == number]
    kept = ect.loads(golden()[number][1])
    for ours, theirs in zip(made.profiles, kept.profiles, strict=True):
        assert np.abs(np.subtract(ours.values, theirs.values)).max() <= 1
    plain = {"interpolation_error": 0.0, "rounding_error": 0.0, "values": (0,), "input": None, "periodic": False}
    same = [
        x.model_copy(update={"profiles": tuple(p.model_copy(update=plain) for p in x.profiles)}) for x in (made, kept)
    ]
    assert same[0] == same[1]


def compare(number, stream):
    _, data, readings, fresh, enable, results, status = golden()[number]
    table = ect.loads(data)
    deviation, correction, streamed = stream(table, readings, fresh, enable)
    outputs = len(table.outputs)
    return deviation - results[:, :outputs], correction - results[:, outputs:], streamed == status


@every
def test_numba(number):
    deviation, correction, status = compare(number, c.numba_stream)
    assert not deviation.any() and not correction.any() and status.all()


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    return c.Library(c.build(tmp_path_factory.mktemp("c")))


@pytest.fixture(scope="module")
def single(tmp_path_factory):
    return c.Library(c.build(tmp_path_factory.mktemp("c"), "-DECT_SINGLE"), np.float32)


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    rooms = [iec_st.capacity_for(ect.loads(data)) for _, data, *_ in golden()]
    room = {what: max(r[what] for r in rooms) for what in rooms[0]}
    units = [iec_st.unit(name, room) for name in st.UNITS]
    return st.Block(tmp_path_factory.mktemp("st"), translate.by_lines(units))


@needs_c
@pytest.mark.toolchain
@every
def test_c_runtime(number, library):
    deviation, correction, status = compare(number, library.stream)
    assert not deviation.any() and not correction.any() and status.all()


@needs_c
@pytest.mark.toolchain
@every
def test_c_runtime_in_single_precision(number, single):
    name, data, *_, results, exact_status = golden()[number]
    outputs = ect.loads(data).outputs
    with np.errstate(over="ignore"):  # 1e300 is infinite in single precision
        deviation, correction, status = compare(number, single.stream)
    bound = vectors.single_bound(name, results[:, : len(outputs)])
    assert np.abs(deviation).max() <= bound
    assert status.mean() > 0.94  # one ulp of a double beside a knot is on it in single precision
    limited = np.array([o.slew is not None or o.acceleration is not None for o in outputs])
    factor = np.array([o.factor for o in outputs])
    correction = np.abs(correction) / factor
    there = status & ((exact_status & AT_RATE) == 0)
    assert correction[:, ~limited].max(initial=0.0) <= bound and correction[there].max(initial=0.0) <= bound
    # On its way: a part of what it moves in a cycle where it brakes a cycle late, else as exact as anything.
    moves = np.abs(np.diff(results[:, len(outputs) :], axis=0, prepend=0.0)).max(axis=0) / factor
    late = 0.25 * moves if name.removeprefix("v1/") in ("limits", "mixed-1", "mixed-13") else np.zeros_like(moves)
    assert (correction.max(axis=0)[limited] <= np.maximum(vectors.SINGLE, late)[limited]).all()


@needs_c
@pytest.mark.toolchain
@pytest.mark.parametrize("name", ["readings", "fading", "motion", "doubts", "slowly", "undone"])
def test_ties_are_ties_in_single_precision(name, single):
    with np.errstate(over="ignore"):
        deviation, correction, status = compare(NAMES.index(name), single.stream)
    assert not deviation.any() and not correction.any() and status.all()


@needs_gcc
@pytest.mark.toolchain
@every
def test_function_block(number, block):
    deviation, correction, status = compare(number, block.stream)
    assert not deviation.any() and not correction.any() and status.all()


def test_the_vectors_visit_what_matters():
    """Every status bit, every operation, both ends and beyond."""
    bits = 0
    operations = set()
    for _, data, _, _, _, _, status in golden():
        bits |= int(np.bitwise_or.reduce(status))
        operations |= {n.op for n in ect.loads(data).nodes}
    assert bits == (1 << len(t.STATUS)) - 1
    assert len(operations) == 12
