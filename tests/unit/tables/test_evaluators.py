"""The evaluators against each other, to the bit, and against numbers worked out by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.domain import table as t
from errpipe.drivers.lowered import Lowered
from errpipe.kernels import arithmetic, elementary, table_codes
from errpipe.tables import ComponentSource, batch, compile_table, ect
from errpipe.tables.reference import Evaluator
from tests.unit.tables.made import everything, modes, numba_stream, position, sensor, stimulus, ten_um_too_long

pytest.importorskip("numba")


def same(cycle, deviation, correction, status):
    return (
        list(cycle.deviation.values()) == list(deviation)
        and list(cycle.correction.values()) == list(correction)
        and cycle.status == status
    )


@pytest.mark.parametrize("seed", range(25))
def test_numba_cycle_is_the_reference_to_the_bit(seed):
    table = everything(seed)
    readings, fresh, enable = stimulus(table, 400, seed)
    results = numba_stream(table, readings, fresh, enable)
    evaluator = Evaluator(table)
    for k in range(len(readings)):
        given = {i.name: readings[k, n] for n, i in enumerate(table.inputs) if fresh[k, n]}
        assert same(evaluator.cycle(given, **modes(enable[k])), *(r[k] for r in results)), k


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 110))
def test_numba_cycle_is_the_reference_over_many_cycles(seed):
    table = everything(seed)
    readings, fresh, enable = stimulus(table, 20_000, seed)
    results = numba_stream(table, readings, fresh, enable)
    evaluator = Evaluator(table)
    for k in range(len(readings)):
        given = {i.name: readings[k, n] for n, i in enumerate(table.inputs) if fresh[k, n]}
        assert same(evaluator.cycle(given, **modes(enable[k])), *(r[k] for r in results)), k


def rows_of(table, seed, rows=300):
    """Columns, time (which stands still and runs back, too) and runs of a recording that drives a table hard."""
    readings, _, _ = stimulus(table, rows, seed)
    time = np.cumsum(np.random.default_rng(seed).choice([0.0, 0.01, 5.0, -1.0], rows))
    return {i.name: readings[:, n] for n, i in enumerate(table.inputs)}, time, np.arange(rows) // 97


@pytest.mark.parametrize("long", [-1, 10**9])
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("seed", range(25, 40))
def test_replay_is_the_reference_to_the_bit(seed, compiled, long, monkeypatch):
    monkeypatch.setattr(batch, "UNBLOCKED", long)
    table = everything(seed)
    rows = 300
    columns, time, run = rows_of(table, seed, rows)
    replay = batch.Rows(table, compiled)(columns, time, run)
    evaluator = Evaluator(table)
    for k in range(rows):
        dt = 0.0
        if k == 0 or run[k] != run[k - 1]:
            evaluator.reset()
        else:
            dt = max(time[k] - time[k - 1], 0.0)
        cycle = evaluator.cycle({name: values[k] for name, values in columns.items()}, dt=dt)
        assert list(cycle.deviation.values()) == [v[k] for v in replay.deviation.values()]
        assert list(cycle.correction.values()) == [v[k] for v in replay.correction.values()]
        assert cycle.status == replay.status[k]


def calm_rows(table, seed, rows):
    """Columns, time and runs of a recording in which nearly every reading is accepted: its blocks stand."""
    rng, columns = np.random.default_rng(seed), {}
    steady = rng.random() < 0.5
    time = np.cumsum(np.full(rows, 0.5) if steady else rng.choice([0.0, 0.01, 0.5, 20.0], rows))
    for i in table.inputs:
        middle, half = 0.5 * (i.low + i.high), 0.5 * (i.high - i.low)
        values = middle + rng.choice([0.2, 0.9]) * half * np.sin(rng.uniform(0.001, 0.02) * np.arange(rows))
        if i.max_rate is not None and rng.random() < 0.7:
            values = np.full(rows, middle) + 0.4 * (i.noise or 0.0) * rng.uniform(-1, 1, rows)
        if rng.random() < 0.3:
            values = np.round(values)  # steps, and stretches that stand still
        if i.optional and rng.random() < 0.7:
            values[rng.random(rows) < rng.choice([0.1, 1.0])] = np.nan
        columns[i.name] = values
    columns[table.inputs[0].name][rows // 3] = np.nan  # one block does not stand
    return columns, time, np.arange(rows) // 900


@pytest.fixture
def in_blocks(monkeypatch):
    """A compiled replay takes blocks of rows from the beginning, as it does in a long recording."""
    monkeypatch.setattr(batch, "UNBLOCKED", -1)
    monkeypatch.setattr(batch, "SINGLE", 20)


@pytest.mark.parametrize(
    "seed", [*range(200, 220), *(pytest.param(s, marks=pytest.mark.slow) for s in range(220, 240))]
)
def test_blocks_of_a_calm_recording_are_the_reference_to_the_bit(seed, in_blocks):
    table = everything(seed, 1 + seed % 2)
    columns, time, run = calm_rows(table, seed, 1500)
    one, two = (batch.Rows(table, compiled)(columns, time, run) for compiled in (True, False))
    assert np.array_equal(one.status, two.status)
    for name in two.deviation:
        for said in ("deviation", "correction"):
            assert getattr(one, said)[name].tobytes() == getattr(two, said)[name].tobytes()


@pytest.mark.parametrize("made", [rows_of, calm_rows])
@pytest.mark.parametrize("compiled", [True, False])
@pytest.mark.parametrize("rows", [1, 7, 96])
def test_a_replay_in_parts_is_the_replay_in_one(rows, compiled, made, in_blocks):
    table = everything(26)
    columns, time, run = made(table, 26, 300)
    whole = batch.Rows(table, compiled)(columns, time, run)
    step = batch.Rows(table, compiled)
    cuts = [slice(k, k + rows) for k in range(0, len(run), rows)]
    parts = [step({n: v[cut] for n, v in columns.items()}, time[cut], run[cut]) for cut in cuts]
    assert np.array_equal(np.concatenate([p.status for p in parts]), whole.status)
    for name in whole.deviation:
        for said in ("deviation", "correction"):
            joined = np.concatenate([getattr(p, said)[name] for p in parts])
            assert joined.tobytes() == getattr(whole, said)[name].tobytes()


@pytest.mark.parametrize("seed", range(40, 60))
def test_points_are_the_first_cycle_of_the_reference(seed):
    table = everything(seed)
    moving = tuple(i.name for i in table.inputs)[: 1 + seed % 3]
    rng = np.random.default_rng(seed)
    own = [table.inputs[table.input_index(m)] for m in moving]
    points = np.column_stack([rng.uniform(i.low, i.high, 700) for i in own])
    result = batch.Positions(table, moving)(points)
    start = {i.name: i.default for i in table.inputs}
    for k in range(0, 700, 13):
        evaluator = Evaluator(table)
        cycle = evaluator.cycle(start | dict(zip(moving, points[k], strict=True)), dt=0.0)
        if "not_finite" not in cycle.status_names():
            assert list(cycle.deviation.values()) == list(result[k])


def test_points_hold_at_the_ends_and_pass_nan_on():
    table = ten_um_too_long()
    points = np.array([[-1e9], [-1.0], [0.0], [500.0], [1000.0], [1000.1], [1e9], [np.nan], [np.inf]])
    values = batch.position(table, points)[:, 0]
    assert np.array_equal(values, [0.0, 0.0, 0.0, 5.0, 10.0, 10.0, 10.0, np.nan, 10.0], equal_nan=True)


def test_a_machine_ten_um_too_long_is_moved_back():
    cycle = Evaluator(ten_um_too_long()).cycle({"x": 1000.0})
    assert cycle.deviation == {"EXX": 10.0}
    assert cycle.correction == {"EXX": -0.01}
    assert ten_um_too_long().outputs[0].correction_unit == "mm"


def every_knot(profile):
    x = profile.start + profile.step * np.arange(len(profile.values))
    return np.concatenate([x, np.nextafter(x, -np.inf), np.nextafter(x, np.inf)])


@pytest.mark.parametrize("period", [None, 10.0])
def test_every_knot_and_its_neighbours(period):
    source = ComponentSource("EXX", "um", (Lowered(d.ONE, "X", lambda x: 5 * np.sin(x * np.pi / 5), period),))
    table = compile_table([source], inputs=[position()], travel={"X": (0.0, 30.0)}, ramp_s=0.0)
    (profile,) = [p for p in table.profiles if any(p.values)]  # the other says how far X travels
    x = every_knot(profile)
    values = np.array(profile.values) * profile.scale
    outcome = batch.position(table, x[:, None])[:, 0]
    assert np.max(np.abs(outcome - np.tile(values, 3))) < 1e-9
    evaluator = Evaluator(table)
    for point, value in zip(x, outcome, strict=True):
        assert evaluator.cycle({"x": point}).deviation["EXX"] == value


@pytest.mark.slow
def test_a_million_points_follow_the_curve_within_the_stated_bound():
    curve = lambda x: 6 * np.sin(x / 90) + 1e-5 * (x - 400) ** 2  # noqa: E731
    source = ComponentSource("EXX", "um", (Lowered(d.ONE, "X", curve),))
    table = compile_table([source], inputs=[position()], travel={"X": (0.0, 1000.0)}, error_bound=0.01)
    x = np.random.default_rng(1).uniform(0, 1000, 1_000_000)
    (profile,) = table.profiles
    error = np.abs(batch.position(table, x[:, None])[:, 0] - curve(x))
    assert error.max() <= profile.interpolation_error + profile.rounding_error + 1e-9
    assert error.max() <= 0.0105


def test_lag_is_exact_for_a_held_input():
    """A step of 10 K through 60 s: 10 (1 - e^-1) after 60 s, whether in 1 s or in 60 s strides."""
    driver = d.Lag(of=d.above("T", 20.0), tau_up=60.0, tau_down=30.0)
    source = ComponentSource("E_Z", "um", (Lowered(driver),))
    table = compile_table([source], inputs=[sensor("T")], thermal_cycle_s=1.0, position_cycle_s=0.5, ramp_s=0.0)
    for stride in (1.0, 4.0, 60.0):
        evaluator = Evaluator(table)
        evaluator.cycle({"T": 20.0}, dt=0.0)
        evaluator.cycle({"T": 30.0}, dt=stride)
        for _ in range(round(60.0 / stride)):
            z = evaluator.cycle({"T": 30.0}, dt=stride).deviation["E_Z"]
        assert z == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), abs=1e-12)
    evaluator = Evaluator(table)
    evaluator.cycle({"T": 20.0})
    evaluator.cycle({"T": 30.0})
    for _ in range(121):  # seen at the thermal cycle after 1 s, then 60 s of 0.5 s cycles
        z = evaluator.cycle({"T": 30.0}).deviation["E_Z"]
    assert z == pytest.approx(10.0 * (1.0 - math.exp(-1.0)), abs=1e-12)


def test_replay_at_the_controllers_rate_gives_the_controllers_bits():
    driver = d.Lag(of=d.rise("T"), tau_up=50.0, tau_down=80.0)
    source = ComponentSource("EXX", "um", (Lowered(driver, "X", lambda x: 0.011 * x),))
    table = compile_table(
        [source], inputs=[position(), sensor("T")], travel={"X": (0, 900)}, position_cycle_s=0.25, thermal_cycle_s=0.25
    )
    rng = np.random.default_rng(5)
    x, temperature = rng.uniform(0, 900, 400), 20 + np.cumsum(rng.normal(0, 0.1, 400))
    replay = batch.Rows(table)({"x": x, "T": temperature}, 0.25 * np.arange(400), np.zeros(400))
    readings = np.column_stack([{"x": x, "T": temperature}[i.name] for i in table.inputs])
    ones = np.ones(readings.shape, dtype=np.uint8)
    deviation, _, _ = numba_stream(table, readings, ones, np.ones(400, dtype=np.uint8))
    assert np.array_equal(replay.deviation["EXX"], deviation[:, 0])


def test_the_kernels_arithmetic_is_the_documented_one():
    rng = np.random.default_rng(0)
    for y in [*rng.uniform(-705, 705, 3000), 0.0, -0.0, -700.0, 700.0, -1e-300, 1e5, -1e5]:
        assert elementary.exp(y) == arithmetic.exp(y)
    for a in [*np.exp(rng.uniform(-69, 69, 3000)), 1.0, 2.0, 0.5, 1e-30, math.sqrt(2)]:
        assert elementary.ln(a) == arithmetic.ln(a)
        assert elementary.power(-a, 1.3) == arithmetic.power(-a, 1.3) == -arithmetic.power(a, 1.3)


def test_arithmetic_is_close_to_the_truth():
    rng = np.random.default_rng(1)
    for y in rng.uniform(-700, 700, 20_000):
        assert abs(arithmetic.exp(y) - math.exp(y)) <= 1.01 * math.ulp(math.exp(y))
    for a in [*np.exp(rng.uniform(-69, 69, 10_000)), *rng.uniform(0.5, 2, 10_000)]:
        assert abs(arithmetic.ln(a) - math.log(a)) <= 3 * math.ulp(math.log(a))
    for u, e in zip(np.exp(rng.uniform(-20, 20, 5000)), rng.uniform(0.1, 4, 5000), strict=True):
        assert arithmetic.power(u, e) == pytest.approx(u**e, rel=1e-14)
    assert arithmetic.power(-9.0, 2.0) == -81.0
    assert arithmetic.power(0.0, 0.3) == arithmetic.power(1e-31, 0.1) == 0.0


def test_a_position_that_is_not_a_number_holds_the_last_one():
    evaluator = Evaluator(ten_um_too_long())
    evaluator.cycle({"x": 600.0})
    for bad in (math.nan, math.inf, -math.inf, 1e300, 2000.0):
        cycle = evaluator.cycle({"x": bad})
        assert cycle.correction["EXX"] == pytest.approx(-0.006, abs=1e-12)
        assert "held" in cycle.status_names()
    assert "held" in evaluator.cycle({}).status_names()
    assert evaluator.cycle({"x": 601.0}).status_names() == ("running", "active")


def test_a_recording_without_a_required_column_is_refused():
    from errpipe.errors import DataError

    with pytest.raises(DataError, match="no column for the table's input x"):
        batch.evaluate(ten_um_too_long(), {}, np.zeros(3), np.zeros(3))


def test_status_bits_have_the_documented_values():
    names = [n.upper() for n in t.STATUS]
    assert [getattr(table_codes, n) for n in names] == [1 << k for k in range(len(names))]


def test_same_table_same_name():
    assert ect.fingerprint(everything(3)) == ect.fingerprint(everything(3)) != ect.fingerprint(everything(4))
