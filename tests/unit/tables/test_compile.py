"""From components to a table: what is compiled, what is merged, and that stated errors hold."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.errors import GateError
from errpipe.tables import (
    ComponentSource,
    Limits,
    MonomialSource,
    OutputSource,
    batch,
    bounds,
    compile_table,
    ect,
    with_limits,
)
from errpipe.tables.gridding import grid, interpolation_error
from errpipe.tables.reference import Evaluator
from tests.unit.tables.made import everything, position, sensor, ten_um_too_long

TRAVEL = {"X": (0.0, 1000.0)}
line = lambda x: 0.01 * x  # noqa: E731


def compiled(*pairs, inputs=None, **more):
    source = ComponentSource("EXX", "um", tuple(pairs))
    return compile_table([source], inputs=inputs or [position(), sensor("T")], travel=TRAVEL, **more)


def test_equal_drivers_become_one_node():
    table = compiled(
        Lowered(d.rise("T"), "X", line), Lowered(d.Lag(of=d.rise("T"), tau_up=50, tau_down=50)), Lowered(d.rise("T"))
    )
    assert [n.op for n in table.nodes] == ["input", "first", "affine", "lag"]
    assert table == compiled(
        Lowered(d.rise("T"), "X", line), Lowered(d.Lag(of=d.rise("T"), tau_up=50, tau_down=50)), Lowered(d.rise("T"))
    )


def test_profiles_of_one_axis_and_driver_are_added():
    table = compiled(
        Lowered(d.ONE, "X", line),
        Lowered(d.ONE, "X", lambda x: 2.0 - 0.01 * x),
        Lowered(d.ONE, "X", lambda x: np.sin(x), 2 * np.pi),
        Lowered(d.ONE, "X", lambda x: -np.sin(x), 2 * np.pi),
    )
    assert len(table.pairs) == 2
    x = np.linspace(0, 1000, 97)[:, None]
    assert np.abs(batch.position(table, x) - 2.0).max() < 1e-9


def test_slow_is_what_no_fast_input_reaches():
    force = t.TableInput(name="F", kind="force", low=-1e4, high=1e4, default=0)
    lag = d.Lag(of=d.Input(name="F"), tau_up=600, tau_down=600)
    short = d.Lag(of=d.Input(name="F"), tau_up=0.1, tau_down=0.1)
    mixed = d.Product(of=(lag, short, d.above("T", 20)))
    table = compiled(Lowered(mixed), inputs=[force, sensor("T")])
    assert [(n.op, n.slow) for n in table.nodes] == [
        ("input", True),
        ("lag", True),
        ("input", False),
        ("lag", False),
        ("input", True),
        ("affine", True),
        ("product", False),
    ]


def test_directions_take_the_input_that_knows():
    known = t.TableInput(name="side", kind="direction", axis="X", low=-1, high=1, default=0, optional=True)
    table = compiled(Lowered(d.Direction(axis="X")), inputs=[position(), known])
    assert table.nodes[-1].of == (0, 1) and [i.name for i in table.inputs] == ["x", "side"]


def test_unused_inputs_are_omitted_and_substitutes_are_kept():
    spare = sensor("B", substitute=(t.Substitute(input="C", weight=1.0),))
    table = compiled(Lowered(d.Input(name="B")), inputs=[position(), sensor("A"), spare, sensor("C")])
    assert [i.name for i in table.inputs] == ["B", "C"]


@pytest.mark.parametrize("bound", [1.0, 0.1, 0.01, 0.001])
def test_gridding_keeps_its_bound_with_few_points(bound):
    curve = lambda x: 5 * np.sin(x / 50) + 1e-7 * x**3  # noqa: E731
    profile = grid(curve, 0.0, 700.0, bound=bound)
    assert profile.interpolation_error <= bound and profile.rounding_error <= 0.5001e-3
    x = np.random.default_rng(0).uniform(0, 700, 50_000)
    nodes = profile.start + profile.step * np.arange(len(profile.values))
    interpolated = np.interp(x, nodes, np.array(profile.values) * profile.scale)
    assert np.abs(interpolated - curve(x)).max() <= bound + 0.0006
    fewer = interpolation_error(curve, 0.0, 700.0, int(0.8 * (len(profile.values) - 1)))
    assert fewer > bound


def test_gridding_sees_kinks():
    profile = grid(lambda x: np.abs(x - 123.4), 0.0, 700.0, bound=0.1)
    nodes = profile.start + profile.step * np.arange(len(profile.values))
    x = np.linspace(123, 124, 999)
    interpolated = np.interp(x, nodes, np.array(profile.values) * profile.scale)
    assert np.abs(interpolated - np.abs(x - 123.4)).max() < 0.11


def test_a_step_is_refused_with_the_error_it_would_leave():
    with pytest.raises(GateError, match=r"64 intervals leave .* \(allowed 0.01\)"):
        grid(lambda x: np.where(x > 333.3, 5.0, 0.0), 0.0, 700.0, bound=0.01, limit=64)


def test_a_reversed_range_and_a_curve_without_value_are_refused():
    with pytest.raises(GateError, match="nothing to grid between 700 and 0"):
        grid(line, 700.0, 0.0, bound=0.01)
    with pytest.raises(GateError, match="not a number at"), np.errstate(invalid="ignore"):
        grid(lambda x: np.sqrt(x - 100), 0.0, 700.0, bound=0.01)


def test_a_huge_curve_gets_a_coarser_unit_instead_of_an_overflow():
    profile = grid(lambda x: 1e9 * x, 0.0, 700.0, bound=1.0)
    assert max(abs(v) for v in profile.values) <= t.LARGEST_VALUE and profile.scale > 1e-3


def test_rounding_of_a_slope_per_kelvin_stays_below_a_nanometre_at_full_temperature():
    table = compiled(Lowered(d.above("T", 20.0), "X", lambda x: 0.011 * x))
    reach = bounds.components(table)[0]
    assert reach.gridding <= 0.0006
    assert reach.deviation >= 0.011 * 1000 * 100


def test_bounds_are_never_too_small():
    for seed in range(30):
        table = everything(seed)
        spans = bounds.node_spans(table.nodes, [i.model_copy(update={"valid": None}) for i in table.inputs])
        rng = np.random.default_rng(seed)
        evaluator = Evaluator(table)
        for _ in range(60):
            evaluator.cycle({i.name: rng.uniform(i.low, i.high) for i in table.inputs}, dt=float(rng.uniform(0, 0.1)))
            for value, (low, high) in zip(evaluator.nodes(), spans, strict=True):
                slack = 1e-9 * max(1.0, abs(low), abs(high))
                assert abs(high) > 1e29 or abs(low) > 1e29 or low - slack <= value <= high + slack


def test_magnitude_is_limited_to_what_the_table_can_reach():
    table = ten_um_too_long()
    assert table.outputs[0].magnitude == pytest.approx(10.0, rel=0.1) and table.outputs[0].magnitude >= 10.0
    own = with_limits(table, {"EXX": Limits(3.0, 100.0, 1000.0)}).outputs[0]
    assert (own.magnitude, own.slew, own.acceleration) == (3.0, 100.0, 1000.0)
    with pytest.raises(GateError, match="EYY"):
        with_limits(table, {"EYY": Limits(3.0)})


def test_outputs_are_sums_of_monomials():
    components = [
        ComponentSource("EXX", "um", (Lowered(d.ONE, "X", line),)),
        ComponentSource("C0Y", "urad", (Lowered(d.Constant(value=20.0)),)),
    ]
    lean = MonomialSource(-1e-3, "C0Y", (d.Input(name="y"),))
    outputs = [OutputSource("E_X", (MonomialSource(1.0, "EXX"), lean), "X")]
    inputs = [position(), position("y", "Y")]
    table = compile_table(components, inputs=inputs, outputs=outputs, travel=TRAVEL)
    values = batch.position(table, np.array([[1000.0, 300.0], [0.0, -300.0]]))[:, 0]
    assert values == pytest.approx([10.0 - 6.0, 6.0])
    assert table.outputs[0].correction_unit == "mm"


def test_a_driver_of_an_unknown_input_is_refused_by_name():
    with pytest.raises(GateError, match=r"reads 'T_nut', which is not an input of the table \(x, T\)"):
        compiled(Lowered(d.Input(name="T_nut")))
    with pytest.raises(GateError, match="position of axis Y"):
        compiled(Lowered(d.ONE, "Y", line))


def test_long_titles_are_shortened_at_a_letter():
    title = compiled(Lowered(d.ONE), title="ü" * 100).title
    assert title.endswith("…") and len(title.encode()) <= 127 and set(title) == {"ü", "…"}


def test_cost_grows_with_what_a_table_holds():
    from bench.bench_tables import machine

    small, _ = bounds.cost(ten_um_too_long())
    always, thermal = bounds.cost(machine(thermal=True))
    assert small.operations < 30 < 200 < always.operations < thermal.operations < 500
    assert len(ect.dumps(machine(thermal=True))) < 40_000
