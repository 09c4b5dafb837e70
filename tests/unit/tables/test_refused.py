"""Each rule of the format page, broken by itself: every reader refuses the file.

The readers: Python (strict, in words), C in double and in single precision, and the function block in Structured Text.
In single precision stored reciprocals and lag factors are rounded before they are used, so their last bit is not seen.
"""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from errpipe.errors import VerifyError
from errpipe.tables import ect
from tests.unit.tables import refused

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
every = pytest.mark.parametrize(("what", "data"), refused.CASES, ids=[c[0] for c in refused.CASES])
# What a reader in single precision cannot tell from sound: products, reciprocals and lag factors are compared rounded.
SINGLE = {
    "max_rate of 1e-15",
    "hold a negative subnormal",
    *(c[0] for c in refused.CASES if "last bit" in c[0] and c[0] != "factor, last bit"),
}


@pytest.fixture(scope="module")
def libraries(tmp_path_factory):
    from tests.unit.targets.c import test_c_runtime as c

    folder = tmp_path_factory.mktemp("readers")
    double = c.Library(c.build(folder))
    single = c.Library(c.build(folder, "-DECT_SINGLE", name="single.so"), np.float32)
    return double, single


@pytest.fixture(scope="module")
def block(tmp_path_factory):
    from tests.unit.targets.st import test_iec_st as st
    from tests.unit.targets.st import translate

    return st.Block(tmp_path_factory.mktemp("block"), translate.by_lines(st.units()))


def test_the_rules_are_many_and_the_table_itself_is_sound():
    assert len(refused.CASES) > 150 and len({c[0] for c in refused.CASES}) == len(refused.CASES)
    data = ect.dumps(refused.sound())
    assert ect.loads(data) == refused.sound()


@every
def test_python(what, data):
    with pytest.raises(VerifyError) as output:
        ect.loads(data)
    assert "\n" not in str(output.value) and "pydantic" not in str(output.value)


@needs_gcc
@pytest.mark.toolchain
def test_c_and_structured_text_take_the_sound_table(libraries, block):
    data = ect.dumps(refused.sound())
    assert [reader.load(data)[0] for reader in (*libraries, block)] == [0, 0, 0]


@needs_gcc
@pytest.mark.toolchain
@every
def test_c_in_double(what, data, libraries):
    assert libraries[0].load(data)[0] != 0


@needs_gcc
@pytest.mark.toolchain
def test_c_in_single(libraries):
    """All but those that need more digits than it has."""
    taken = {what for what, data in refused.CASES if libraries[1].load(data)[0] == 0}
    assert taken <= SINGLE, taken - SINGLE


@needs_gcc
@pytest.mark.toolchain
@every
def test_structured_text(what, data, block):
    assert block.load(data)[0] != 0


@needs_gcc
@pytest.mark.toolchain
def test_c_and_structured_text_give_one_reason(libraries, block):
    """The same code in both, and the same record where it is that of a record."""
    differ = []
    for what, data in refused.CASES:
        ours, theirs = block.load(data), libraries[0].load(data)
        if ours[0] != theirs[0]:
            differ.append((what, ours, theirs))
    # Which of two broken rules is named first differs where one change breaks two.
    assert len(differ) < 15, differ


@needs_gcc
@pytest.mark.toolchain
@pytest.mark.slow
def test_damaged_tables_in_both_readers(tmp_path):
    """Twenty thousand of what `python -m tests.unit.tables.fuzz_readers 1000000` does."""
    from tests.unit.tables import fuzz_readers

    taken, result = fuzz_readers.run(20_000, 5, fuzz_readers.c_reader(tmp_path))
    assert result == [] and 500 < taken < 8_000
