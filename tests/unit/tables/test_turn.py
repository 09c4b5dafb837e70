"""A turn whose ends were measured as actual positions, which differ from whole degrees by the axis' own error."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.drivers.lowered import Lowered
from errpipe.targets import TARGETS, _sample
from tests.unit.tables.made import position


def rotary(low: float, high: float, nodes: tuple[float, ...] = (), slope: float = 0.0):
    """Deviation (30 + 200 slope) sin(x) + slope * x, urad, over a rotary axis measured from low to high, deg."""
    curve = Lowered(d.ONE, "C", lambda x: (30.0 + 200.0 * slope) * np.sin(np.radians(x)) + slope * x, None, nodes)
    channel = position("c", "C", low=-720.0, high=1080.0)
    return tables.compile_table(
        [tables.ComponentSource("ECC", "urad", (curve,), True)], inputs=[channel], travel={"C": (low, high)}
    )


@pytest.mark.parametrize("low", [0.0, -180.0])
@pytest.mark.parametrize("below, above", [(-0.0004, 0.0031), (0.002, -0.001), (-0.003, -0.003)])
def test_ends_that_are_off_by_the_error_of_the_axis_are_one_turn(low: float, below: float, above: float) -> None:
    table = rotary(low + below, low + 360.0 + above)
    assert _sample.turns(table, "C")
    assert _sample.span(table, "C") == (low, low + 360.0)


def test_targets_that_were_measured_so_are_one_turn() -> None:
    nodes = tuple(np.linspace(-0.0004, 360.0031, 13).tolist())
    table = rotary(nodes[0], nodes[-1], nodes)
    assert _sample.span(table, "C") == (0.0, 360.0)


def test_less_than_a_turn_is_none() -> None:
    assert not _sample.turns(rotary(0.0, 359.9), "C")


def test_a_control_that_counts_from_0_has_its_turn_from_0() -> None:
    text = TARGETS["twincat_nc_table"].write(rotary(-180.0, 180.0))["GVL_Compensation_C.st"]
    assert "MinPosition := 0.000000000000000E+00, MaxPosition := 3.600000000000000E+02" in text
    assert "Modulo := TRUE" in text


def test_a_turn_that_ends_short_of_itself_closes_without_a_step() -> None:
    """A smooth curve that went on beyond 359.98 deg stepped by 0.015 urad there: no grid was fine enough."""
    assert _sample.span(rotary(0.0, 359.98, slope=0.05), "C") == (0.0, 360.0)


def test_an_axis_that_does_not_turn_on_keeps_the_difference_of_its_ends() -> None:
    """18 urad more at 359.98 deg than at 0 are not spread over its travel."""
    curve = Lowered(d.ONE, "C", lambda x: 0.05 * x)
    made = {
        stated: tables.compile_table(
            [tables.ComponentSource("ECC", "urad", (curve,), True)],
            inputs=[position("c", "C", low=-720.0, high=1080.0)],
            travel={"C": (0.0, 359.98)},
            limited=stated,
        )
        for stated in ((), ("C",))
    }
    assert _sample.turns(made[()], "C") and not _sample.turns(made["C",], "C")
    ends = _sample.curve(made["C",], "C", "C", np.array([0.0, 359.98])).up
    assert np.radians(np.diff(ends)) * 1e6 == pytest.approx([-0.05 * 359.98], abs=0.02)
