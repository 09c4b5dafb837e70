"""What a format's range or spacing cannot hold is refused with the number that is too large."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import CompensationTable, TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError
from errpipe.targets import TARGETS

HAAS = TARGETS["haas_pitch"]


def one_axis(axis: str, travel: tuple[float, float], *pairs: Lowered) -> CompensationTable:
    low, high = travel
    place = TableInput(name="p", kind="position", axis=axis, low=low - 10, high=high + 10, default=low)
    source = tables.ComponentSource(f"E{axis}{axis}", "urad" if axis == "C" else "um", pairs)
    return tables.compile_table([source], inputs=[place], travel={axis: travel})


def straight(axis: str, um: float, span: float) -> Lowered:
    return Lowered(d.ONE, axis, lambda x: um * x / span)


def test_a_value_of_more_than_127_steps_is_refused() -> None:
    """127 steps of 0.0001 inch are 322.6 um."""
    HAAS.write(one_axis("X", (0.0, 254.0), straight("X", 320.0, 254.0)))
    with pytest.raises(GateError, match=r"a value of 0\.0130 inch is needed, 0\.0127 inch \(127 steps\)"):
        HAAS.write(one_axis("X", (0.0, 254.0), straight("X", 330.2, 254.0)))


def test_more_than_256_values_are_refused() -> None:
    assert len(HAAS.write(one_axis("X", (0.0, 3238.5), straight("X", 50.0, 3238.5)))) == 1
    with pytest.raises(GateError, match="257 values of half an inch are needed, 256 fit"):
        HAAS.write(one_axis("X", (0.0, 3251.2), straight("X", 50.0, 3251.2)))


def test_the_steps_per_inch_that_the_largest_value_allows_are_to_be_checked() -> None:
    table = one_axis("X", (0.0, 254.0), straight("X", 25.4, 254.0))  # 0.001 inch
    says = [x.text for x in HAAS.by_hand(table, HAAS.read_back(HAAS.write(table)), [])]
    assert any("the largest value is 0.0010 inch" in x and "more than 127000" in x for x in says)


def test_lost_motion_of_a_rotary_axis_is_in_degrees() -> None:
    gap = Lowered(d.Direction(axis="C"), None, lambda x: np.full(np.shape(x), 15.0))
    with pytest.raises(GateError, match=r"C would have to be pushed back by 0\.00172 deg at reversals"):
        TARGETS["grblhal_backlash"].write(one_axis("C", (-30.0, 110.0), gap))
