"""A sensor whose first reading comes late: what its rise lacks, with the right sign and within its limits."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.guard import learn, replace
from errpipe.guard.rows import rows_of
from errpipe.tables import ComponentSource, batch, compile_table
from tests.unit.guard import simulated_sensors

NAMES = simulated_sensors.NAMES
LATE_S = 1800.0
OFFSETS = {"T_bearing": -3.0, "T_housing": 5.0}  # K: a start is not that of the mean of the others


def machine(runs, seed):
    rows = simulated_sensors.machine(runs, seed)
    return rows.with_columns({n: rows.array(n) + k for n, k in OFFSETS.items()}, {})


@pytest.fixture(scope="module")
def healthy():
    return machine(10, 3)


@pytest.fixture(scope="module", params=[learn.learn, learn.limits], ids=["compared", "alone"])
def guard(request, healthy):
    return request.param(healthy, NAMES)


def evaluated(drivers, rows):
    """Drivers in a table, as a controller evaluates them, shape (rows, drivers)."""
    inputs = [
        TableInput(name=n, kind="sensor", unit="degC", low=-200.0, high=200.0, default=20.0, fade_on_default=False)
        for n in NAMES
    ]
    components = ("E_X", "E_Y", "E_Z", "EXX", "EYY", "EZZ")[: len(drivers)]
    pairs = [(Lowered(driver, None, lambda x: np.ones(np.shape(x))),) for driver in drivers]
    table = compile_table(
        [ComponentSource(name, "um", of, True) for name, of in zip(components, pairs, strict=True)],
        inputs=inputs,
        position_cycle_s=10.0,
        thermal_cycle_s=60.0,
    )
    replayed = batch.Rows(table)({n: rows.array(n) for n in NAMES}, rows.time(), rows.run_codes())
    return np.column_stack([replayed.deviation[name] for name in components])


def rise(guard, rows, name):
    return evaluated([replace.guarded(d.rise(name), guard)], rows)[:, 0]


def late(rows, name, change=0.0):
    """The rows in which a sensor is silent at first, and then reads its own value plus a change, K."""
    return rows.with_columns({name: np.where(rows.time() < LATE_S, np.nan, rows.array(name) + change)}, {})


@pytest.mark.parametrize("name", OFFSETS)
def test_the_rise_before_the_first_reading_is_added(guard, name):
    """In runs other than those learnt from; without the estimate, what each run lacks is its error."""
    fresh = machine(10, 4)
    first = fresh.time() == LATE_S
    lacks = rise(guard, fresh, name)[first]
    added = rise(guard, late(fresh, name), name)[first]
    assert np.abs(lacks).max() > 2.0
    assert np.sqrt(np.mean((added - lacks) ** 2)) < 0.5 * np.sqrt(np.mean(lacks**2))


def test_the_start_follows_the_sensor_that_it_follows_in_the_recording():
    """The first of four starts half the way from their mean to the second: its weights and offset are found."""
    start = 20.0 + np.random.default_rng(1).normal(0.0, 3.0, (200, 4))
    mean = start[:, 1:].mean(axis=1)
    start[:, 0] = 2.0 + mean + 0.5 * (start[:, 1] - mean)
    weights, usual = learn._start_of(0, start)
    np.testing.assert_allclose(weights, [0.0, 2 / 3, 1 / 6, 1 / 6], atol=0.02)
    np.testing.assert_allclose(start @ weights + usual, start[:, 0], atol=0.2)


@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("name", OFFSETS)
def test_no_more_is_added_than_the_sensor_ever_rose_soon_after_a_start(guard, healthy, name, side):
    """A first reading 20 K off is no rise."""
    rows = rows_of(healthy, (name,))
    soon = rows.rises()[(rows.since() > 0.0) & (rows.since() <= learn.LATEST_S)]
    limit = max(soon.max(), 0.0) if side > 0 else min(soon.min(), 0.0)
    first = healthy.time() == LATE_S
    np.testing.assert_allclose(rise(guard, late(healthy, name, 20.0 * side), name)[first], limit, atol=0.01)


def test_nothing_is_added_to_a_sensor_that_is_not_late(guard, healthy):
    first = np.flatnonzero(healthy.time() == 0.0)[healthy.run_codes()]
    for name in OFFSETS:
        own = healthy.array(name) - healthy.array(name)[first]
        np.testing.assert_allclose(rise(guard, healthy, name), own, atol=1e-6)


@pytest.mark.parametrize("since", [600.0, 5400.0])
def test_a_late_sensor_raises_no_alarm(healthy, since):
    """Its recent changes start with its first reading, and those of the others are compared from there on, too."""
    guard, fresh = learn.learn(healthy, NAMES), machine(10, 4)
    for name in ("T_bearing", "T_bed"):
        rows = fresh.with_columns({name: np.where(fresh.time() < since, np.nan, fresh.array(name))}, {})
        read = evaluated([replace.guarded(d.Input(name=n), guard) for n in NAMES], rows)
        own = np.column_stack([fresh.array(n) for n in NAMES])
        assert np.abs(read - own)[fresh.time() >= since].max() < 1.0, name
