"""Column names, axes and units that a table cannot hold are refused at export, with the column and what is allowed."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError
from errpipe.stages import _inputs


@pytest.mark.parametrize(
    ("name", "facts", "words"),
    [
        ("temperature of the front spindle bearing", {"role": "temperature", "unit": "degC"}, "longer than 31 bytes"),
        ('T"; M30', {"role": "temperature", "unit": "degC"}, "allowed: letters"),
        ("T\nnut", {"role": "temperature", "unit": "degC"}, "allowed: letters"),
        ("x", {"role": "position", "axis": "../../x", "unit": "mm"}, "the axis of column 'x'"),
        ("x", {"role": "position", "axis": "/tmp/zz", "unit": "mm"}, "the axis of column 'x'"),
        ("T", {"role": "temperature", "unit": "*/"}, "the unit of column 'T'"),
    ],
)
def test_a_column_that_does_not_fit_a_table_is_named(name, facts, words):
    with pytest.raises(GateError, match="Rename it in the recording") as output:
        _inputs.table_inputs(SimpleNamespace(columns={name: facts}))
    assert words in str(output.value) and repr(name) in str(output.value)


def test_a_title_of_several_lines_becomes_one():
    """Titles come from YAML, where they may run over lines; a table's title is one line without control characters."""
    place = TableInput(name="x", kind="position", axis="X", low=0, high=100, default=0)
    source = tables.ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 0.1 * x),))
    made = tables.compile_table([source], inputs=[place], title="a\n  b\0\tc\u2028d", machine="m\r\n")
    assert made.title == "a b c d" and made.machine == "m"
