"""Both evaluators where two rules of the specification meet: bounds met exactly, limits, the functions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from errpipe.domain import table as t
from tests.contract.second_agreement import agree, bits
from tests.contract.second_functions import exp, ln, power

TICK = 2.0**-10  # so that times add up without rounding


def channel(name: str, **more) -> t.TableInput:
    return t.TableInput(name=name, kind="sensor", **({"low": -1000.0, "high": 1000.0, "default": 3.0} | more))


def shown(inputs, nodes, **more) -> t.CompensationTable:
    """A table of which each node is an output of its own, 1 um for 1."""
    components = tuple(t.Component(name=f"C{n}") for n in range(len(nodes)))
    pairs = tuple(t.Pair(component=f"C{n}", profile=0, driver=n, keep=True) for n in range(len(nodes)))
    outputs = tuple(
        t.Output(name=f"O{n}", correction_unit="um", terms=(t.Monomial(weight=1.0, component=f"C{n}"),), **more)
        for n in range(len(nodes))
    )
    return t.CompensationTable(
        position_cycle_s=TICK,
        slow_every=2,
        ramp_s=0.0,
        fade_s=4 * TICK,
        inputs=inputs,
        nodes=nodes,
        profiles=(t.Profile(values=(1,), scale=1.0),),
        components=components,
        pairs=pairs,
        outputs=outputs,
    )


def rows(*values):
    """Readings, fresh and enable of one input; None: nothing new."""
    fresh = np.array([[v is not None] for v in values], dtype=np.uint8)
    return np.array([[0.0 if v is None else v] for v in values]), fresh, np.ones(len(values), dtype=np.uint8)


@pytest.mark.parametrize(
    "more",
    [
        {"stale_after_s": 3 * TICK, "hold_s": 3 * TICK},
        {"stale_after_s": 3 * TICK, "hold_s": 0.0},
        {"max_rate": 8 / TICK},
        {"max_rate": 8 / TICK, "hold_s": 2 * TICK},
        {"valid": (-1.0, 1.0), "margin": 8.0},
        {"optional": True},
        {"fade_on_default": False, "hold_s": 0.0},
        {"low": 0.0, "high": 8.0, "hold_s": TICK},
    ],
    ids=str,
)
def test_readings_exactly_at_a_bound(more):
    table = shown((channel("a", **more),), (t.InputNode(input="a"), t.InputNode(input="a", slow=True)))
    pair = t.Pair(component="C0", profile=0, driver=0)  # this one fades
    table = table.model_copy(update={"pairs": (*table.pairs, pair)})
    agree(
        table,
        *rows(
            None,
            math.nan,
            0.0,
            8.0,
            16.0,
            32.0,
            None,
            8.0,
            None,
            None,
            None,
            None,
            None,
            None,
            -8.0,
            math.inf,
            0.0,
            1e30,
            2e30,
            -1e30,
            1.0,
            -1.0,
            9.0,
            -9.0,
            math.nextafter(1.0, 2.0),
            1000.0,
            math.nextafter(1000.0, 2000.0),
            None,
            None,
            None,
            -1000.0,
            -0.0,
            5e-324,
            0.0,
            -8.0,
            -24.0,
            math.nan,
            -40.0,
        ),
    )


def test_a_substitute_is_kept_within_the_range_of_its_input():
    inputs = (
        channel("a", low=-4.0, high=4.0, substitute=({"input": "b", "weight": 2.0},), substitute_offset=-1.0),
        channel("b", substitute=({"input": "a", "weight": 1.0},)),
    )
    table = shown(inputs, (t.InputNode(input="a"), t.InputNode(input="b"), t.FirstNode(of=(0,))))
    values = [(math.nan, None), (math.nan, 1.0), (9.0, 2.5), (9.0, 3.0), (9.0, -9.0), (2.0, math.nan), (9.0, math.nan)]
    fresh = np.array([[v is not None for v in row] for row in values], dtype=np.uint8)
    readings = np.array([[0.0 if v is None else v for v in row] for row in values])
    agree(table, readings, fresh, np.ones(len(values), dtype=np.uint8))


def test_operations_exactly_at_a_bound():
    of = (0,)
    nodes = (
        t.InputNode(input="a"),
        t.SwitchNode(of=of, on=8.0, off=0.0),
        t.SwitchNode(of=of, on=8.0, off=8.0),
        t.ClipNode(of=of, low=0.0, high=8.0),
        t.DirectionNode(of=of, threshold=0.0),
        t.DirectionNode(of=of, threshold=8.0, start=-1),
        t.DirectionNode(of=(0, 1), threshold=8.0),
        t.DirectionNode(of=of, threshold=8.0, slow=True),
        t.ApproachNode(of=(0, 4), length=1e-3),
        t.ApproachNode(of=(0, 5), length=1e14),
        t.LagNode(of=of, tau_up=TICK, tau_down=TICK / 4),
        t.LagNode(of=of, tau_up=1e-14, tau_down=1e14, start="zero"),
        t.LagNode(of=of, tau_up=0.125, tau_down=0.5, slow=True),
        t.LookupNode(of=of, start=-0.0, step=8.0, values=(-0.0, 5.0)),
        t.PowerNode(of=of, exponent=1.0),
        t.PowerNode(of=of, exponent=2.0),
        t.PowerNode(of=of, exponent=3.0),
        t.PowerNode(of=of, exponent=0.3),
        t.PowerNode(of=of, exponent=16.0),
        t.AffineNode(of=of, offset=0.0, weights=(1e15,)),
        t.PowerNode(of=(19,), exponent=2.5),
        t.ProductNode(of=(19, 19)),
        t.AffineNode(of=of, offset=0.0, weights=(1e-15,)),
        t.PowerNode(of=(22,), exponent=1.5),
        t.ProductNode(of=(22, 22, 22)),
        t.PowerNode(of=(24,), exponent=0.5),
    )
    way = [
        math.nan,
        0.0,
        8.0,
        0.0,
        4.0,
        -4.0,
        4.0,
        4.0,
        12.0,
        4.0,
        3.0,
        -0.0,
        0.0,
        7.0,
        -1.0,
        1e3,
        -1e3,
        5e-324,
        1e-7,
        -1e-7,
        1e-15,
        8.0,
        16.0,
        8.0,
        8.0,
        1.0,
        -7.0,
        1.0,
        1.5,
        2.0,
        3.0,
        5.0,
        8.0,
        13.0,
        5.0,
        3.0,
        2.0,
        1.0,
    ]
    assert agree(shown((channel("a"),), nodes), *rows(*way)) & 1 << 12


@pytest.mark.parametrize("slew", [None, 4.0 / TICK])
@pytest.mark.parametrize("acceleration", [None, 1.0 / TICK**2])
@pytest.mark.parametrize("magnitude", [None, 20.0])
def test_limits_that_are_met_exactly(slew, acceleration, magnitude):
    table = shown(
        (channel("a"),), (t.InputNode(input="a"),), slew=slew, acceleration=acceleration, magnitude=magnitude
    ).model_copy(update={"ramp_s": 8 * TICK})
    way = [0.0, 1.0, 3.0, 6.0, 10.0, 14.0, 18.0, 21.0, 23.0, 24.0, 24.0, 20.0, 16.0, *[-30.0] * 30, *range(-30, 0, 3)]
    readings, fresh, enable = rows(*map(float, [*way, *way, *[v / 3 for v in way]]))
    enable[60:75] = 0
    agree(table, readings, fresh, enable)


def test_functions_are_those_of_the_runtime():
    from errpipe.kernels import arithmetic

    r = np.random.default_rng(5)
    for y in [0.0, -0.0, 700.0, 701.0, -700.0, -701.0, 5e-324, *r.uniform(-710, 710, 300), *r.normal(0, 1, 300)]:
        assert exp(float(y)).hex() == arithmetic.exp(float(y)).hex()
    for x in [1.0, 1e-30, 2.0, 0.5, 1e300, *10 ** r.uniform(-30, 30, 300), *r.uniform(0.5, 2, 300)]:
        assert ln(float(x)).hex() == arithmetic.ln(float(x)).hex()
        for e in (1.0, 2.0, 3.0, 0.37, 2.5, 16.0):
            assert power(-float(x), e).hex() == float(arithmetic.power(-float(x), e)).hex()
    assert bits([power(-1e-31, 1.0), power(-0.0, 2.0)]) == bits([0.0, 0.0])
