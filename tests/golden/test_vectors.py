"""All runtimes on the golden vectors: to the bit where the arithmetic is the same, within 5 nm in single precision."""

from __future__ import annotations

import shutil
from functools import cache

import numpy as np
import pytest

from errpipe.tables import ect
from errpipe.tables.reference import Evaluator
from tests.golden import vectors
from tests.unit.targets.c import test_c_runtime as c
from tests.unit.targets.st import test_iec_st as st
from tests.unit.targets.st import translate


@cache
def golden():
    return vectors.read(vectors.FILE.read_text(encoding="utf-8"))


NAMES = ("straight", "curves", "thermal", "reversal", "limits", "volumetric", "mixed-6", "mixed-13")
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
        cycle = evaluator.cycle(given, enable=bool(enable[k]))
        assert [*cycle.deviation.values(), *cycle.correction.values()] == results[k].tolist()
        assert cycle.status == status[k]


@every
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
    deviation, correction, found = stream(table, readings, fresh, enable)
    outputs = len(table.outputs)
    return deviation - results[:, :outputs], correction - results[:, outputs:], found == status


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
    return st.Block(tmp_path_factory.mktemp("st"), translate.by_lines(st.units()))


@needs_c
@pytest.mark.toolchain
@every
def test_c_runtime(number, library):
    deviation, correction, status = compare(number, library.stream)
    assert not deviation.any() and not correction.any() and status.all()


@needs_c
@pytest.mark.toolchain
@pytest.mark.parametrize("number", range(6), ids=NAMES[:6])
def test_c_runtime_in_single_precision(number, single):
    deviation, _, status = compare(number, single.stream)
    assert np.abs(deviation).max() < 0.001  # um: a nanometre; the largest is 0.4 nm, where a reversal meets a slope
    assert status.mean() > 0.9  # one ulp of a double beside a knot is on it in single precision


@needs_gcc
@pytest.mark.toolchain
@every
def test_function_block(number, block):
    deviation, correction, status = compare(number, block.stream)
    assert not deviation.any() and not correction.any() and status.all()


def test_the_vectors_visit_what_matters():
    """Every status bit but `not finite` of the hand-made tables, every operation, both ends and beyond."""
    bits = 0
    operations = set()
    for _, data, _, _, _, _, status in golden():
        bits |= int(np.bitwise_or.reduce(status))
        operations |= {n.op for n in ect.loads(data).nodes}
    assert bits & 0xFFF == 0xFFF
    assert len(operations) == 12
