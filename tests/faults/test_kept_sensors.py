"""A table that keeps sensors consistent with others, or holds them: the same bits in all evaluators."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.guard import learn
from errpipe.kernels.table_codes import ON
from errpipe.models.lagged import Lagged
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.tables import ect
from tests.faults import campaign, runners
from tests.faults.sequences import Part
from tests.faults.test_faults import needs_gcc, toolchain
from tests.unit.guard import simulated_sensors
from tests.unit.stages.test_guarded import nine

COMPARED, KEPT = simulated_sensors.NAMES, ("T_7", "T_8", "T_9")
CYCLE = 10.0  # s; rows of the recording come every sixth cycle
ALLOWED = 0.8  # um: each counts 0.3 um/K, and its noise and clipping 0.5 um


@pytest.fixture(scope="module")
def tables():
    """Of one model: the further sensors kept; held."""
    rows = nine(8, 5)
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    options = CompileOptions(position_cycle=CYCLE, thermal_cycle=CYCLE)
    holds = learn.learn(rows, COMPARED).model_copy(update={"held": KEPT})
    guards = {"kept": learn.learn(rows, COMPARED, KEPT), "held": holds}
    return {name: compile_model(model, options, guard, rows) for name, guard in guards.items()}


@pytest.fixture(scope="module")
def table(tables):
    return tables["kept"]


def day(table, wrong: dict[str, float]) -> list[Part]:
    """A day in which some sensors read wrong from the third to the fifth hour; the controller restarts in the fourth.

    Before the last hour they read wrong again, until the end.
    """
    rows = nine(1, 6)
    hour = rows.time() / 3600.0
    bad = ((hour >= 2.0) & (hour < 4.5)) | (hour >= 7.0)
    columns = [np.where(bad, wrong.get(i.name, rows.array(i.name)), rows.array(i.name)) for i in table.inputs]
    readings = np.repeat(np.column_stack(columns), 6, axis=0)
    fresh, mode = np.ones(readings.shape, dtype=np.uint8), np.full(len(readings), ON, dtype=np.uint8)
    at = np.searchsorted(np.repeat(hour, 6), 3.5)
    return [
        Part("table", 0, readings[:at], fresh[:at], mode[:at]),
        Part("reset", 0, readings[at:], fresh[at:], mode[at:]),
    ]


WRONG = (
    {},
    dict.fromkeys(KEPT, np.nan),
    dict.fromkeys(KEPT, 0.0),
    {"T_7": np.nan, "T_8": 0.0, "T_9": 26.0, "T_bed": np.nan},  # 26 degC: frozen, within its range
    {"T_9": np.inf, "T_8": -1e30, "T_housing": 0.0},
)


@pytest.mark.parametrize("way", ["kept", "held"])
@pytest.mark.parametrize(
    "wrong", [*WRONG[3:4], *(pytest.param(w, marks=pytest.mark.slow) for w in (*WRONG[:3], *WRONG[4:]))]
)
def test_reference_and_kernels_agree_to_the_bit(tables, monkeypatch, wrong, way):
    table = tables[way]
    monkeypatch.setattr(runners, "table", lambda number: table)
    parts = day(table, wrong)
    values = runners.by_reference(parts)
    assert np.array_equal(values, runners.by_numba(parts)) and np.ptp(values) > 10.0


@needs_gcc
@toolchain
@pytest.mark.parametrize("way", ["kept", "held"])
@pytest.mark.parametrize("name", ["C, double", "Structured Text"])
def test_compiled_evaluators_give_the_same_bits(tables, monkeypatch, tmp_path, name, way):
    table = tables[way]
    monkeypatch.setattr(runners, "table", lambda number: table)
    monkeypatch.setattr(runners, "_bytes", lambda number: ect.dumps(table))
    run = campaign.compiled(name, tmp_path, table)
    for wrong in WRONG:
        parts = day(table, wrong)
        assert np.array_equal(run(parts), runners.by_numba(parts)), wrong


@pytest.mark.parametrize("value", [0.0, 26.0, 35.0])
def test_a_kept_sensor_moves_the_correction_by_little_whatever_it_reads(table, monkeypatch, value):
    """Also over a restart; from its gain of 0.3 um/K alone, 0 degC would be 8 um."""
    monkeypatch.setattr(runners, "table", lambda number: table)
    healthy = runners.by_numba(day(table, {}))
    for name in KEPT:
        assert np.abs(runners.by_numba(day(table, {name: value})) - healthy).max() < ALLOWED, name


def test_a_sensor_without_a_reading_since_a_restart_leaves_no_correction(table, monkeypatch):
    """No correction rather than one without its share; it comes with the first reading, and no later loss ends it."""
    monkeypatch.setattr(runners, "table", lambda number: table)
    healthy, lost = (runners.by_numba(day(table, wrong)) for wrong in ({}, {"T_9": np.nan}))
    hour = np.arange(len(lost)) * CYCLE / 3600.0
    assert np.abs(lost - healthy)[hour < 3.5].max() < ALLOWED
    assert not lost[(hour > 3.7) & (hour < 4.5)].any() and np.abs(lost[(hour > 4.7) & (hour < 7.0)]).max() > 2.0
    assert np.ptp((lost - healthy)[hour >= 7.0]) < ALLOWED


def test_a_held_sensor_keeps_its_last_reading_and_counts_no_further_than_its_limit(tables, monkeypatch):
    """A failed input that drifts moves the correction as one at the limit, at last; validity is that of the model."""
    table = tables["held"]
    monkeypatch.setattr(runners, "table", lambda number: table)
    seen = nine(8, 5).array("T_9")
    limit = 2.0 * float(seen.max()) - float(seen.min())
    healthy, lost, at_limit, beyond = (  # before the restart
        runners.by_numba(day(table, wrong)[:1]) for wrong in ({}, {"T_9": np.nan}, {"T_9": limit}, {"T_9": limit + 45})
    )
    assert all(i.valid is None for i in table.inputs)
    assert np.abs(lost - healthy).max() < 2.0 < np.abs(at_limit - healthy)[-1]
    assert np.abs(beyond - at_limit)[-1] < 0.2  # 45 K are 13 um
