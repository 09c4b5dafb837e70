"""What holding slow nodes between thermal cycles costs: a bound that a ramp at the largest rate nearly reaches."""

from __future__ import annotations

import math

import numpy as np
import pytest

from errpipe.domain import table as t
from errpipe.kernels import table_cycle
from errpipe.tables import hold_lag, pack
from tests.unit.tables.made import everything
from tests.unit.tables.made import ten_um_too_long as plain

RATE = 0.5  # K/s


def made(slow_every: int, nodes, max_rate: float | None = RATE, driver: int = -1) -> t.CompensationTable:
    inputs = (
        t.TableInput(name="x", kind="position", axis="X", unit="mm", low=-10.0, high=1010.0, default=0.0),
        t.TableInput(name="T", kind="sensor", unit="degC", low=-40.0, high=100.0, default=20.0, max_rate=max_rate),
    )
    nodes = tuple(n.model_copy(update={"slow": slow_every > 1}) for n in nodes)
    return t.CompensationTable(
        position_cycle_s=0.01,
        slow_every=slow_every,
        ramp_s=0.0,
        inputs=inputs,
        nodes=nodes,
        profiles=(t.Profile(input="x", start=0.0, step=1000.0, values=(0, 10000)),),
        components=(t.Component(name="EXX"),),
        pairs=(t.Pair(component="EXX", profile=0, driver=len(nodes) - 1),),
        outputs=(t.Output(name="X", axis="X", terms=(t.Monomial(weight=1.0, component="EXX"),)),),
    )


T = t.InputNode(input="T")
RISE = t.AffineNode(of=(0,), offset=-20.0, weights=(1.0,))
NODES = {
    "a rise": (T, RISE),
    "a product": (T, RISE, t.ProductNode(of=(1, 1))),
    "a power": (T, RISE, t.PowerNode(of=(1,), exponent=3.0)),
    "a lookup": (T, t.LookupNode(of=(0,), start=0.0, step=10.0, values=(0.0, 2.0, 1.0, 8.0, 9.0, 9.0))),
    "a clip": (T, RISE, t.ClipNode(of=(1,), low=-5.0, high=5.0)),
    "a switch": (T, RISE, t.SwitchNode(of=(1,), on=3.0, off=2.0)),
    "a lag": (T, RISE, t.LagNode(of=(1,), tau_up=3.0, tau_down=3.0)),
}


def lateness(nodes) -> float:
    """Largest difference between a table that holds and one that does not, while T ramps as fast as it may."""
    time = 0.01 * np.arange(6000)
    ramp = 20.0 + RATE * 125.0 / (2 * math.pi) * np.sin(time * 2 * math.pi / 125.0)
    readings = np.column_stack([np.full(time.size, 1000.0), ramp])
    fresh, enable = np.ones(readings.shape, dtype=np.uint8), np.ones(time.size, dtype=np.uint8)
    runs = []
    for slow_every in (1, 100):
        program = pack.program(made(slow_every, nodes))
        deviation, correction = np.empty((2, time.size, 1))
        status = np.empty(time.size, dtype=np.int64)
        table_cycle.stream(program, pack.state(program), readings, fresh, enable, deviation, correction, status)
        runs.append(deviation[:, 0])
    there = slice(200, None)  # a sensor is accepted half a thermal cycle after the start
    return float(np.abs(runs[0] - runs[1])[there].max())


@pytest.mark.parametrize("name", NODES)
def test_the_bound_holds_and_is_not_idle(name):
    (bound,) = hold_lag.outputs(made(100, NODES[name]))
    delays = lateness(NODES[name])
    assert delays <= bound.largest
    if name in ("a rise", "a clip", "a switch"):
        assert delays > 0.9 * bound.largest
    assert hold_lag.outputs(made(1, NODES[name]))[0].largest == 0.0


def test_an_input_without_a_rate_may_cross_its_range():
    (free,) = hold_lag.outputs(made(100, NODES["a rise"], None))
    assert free.largest == pytest.approx(140.0 * 10.0)
    (output,) = hold_lag.outputs(made(100, NODES["a rise"], None), otherwise=hold_lag.USUAL)
    assert output.largest == pytest.approx(10.0 * 0.99 / 60.0)


def test_a_table_without_slow_nodes_is_never_late():
    assert hold_lag.outputs(plain())[0].largest == 0.0


@pytest.mark.parametrize("seed", range(12))
def test_any_table_has_a_bound(seed):
    for row in hold_lag.outputs(everything(seed)):
        assert row.largest >= 0.0 and not math.isnan(row.largest)
