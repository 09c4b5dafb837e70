"""Tables that read temperatures are guarded by default; what cannot be guarded says so."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from errpipe.domain import driver as d
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.shared import drive_all
from errpipe.guard import in_table, learn
from errpipe.guard import replace as replace_reading
from errpipe.guard.detect import faults
from errpipe.guard.rows import rows_of
from errpipe.models.lagged import Lagged
from errpipe.models.terms import Terms
from errpipe.stages import _compile, _guarded
from errpipe.stages._checklist import _sensor_monitoring
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import table_values
from errpipe.targets import _sample
from errpipe.targets._base import ReadBack
from errpipe.targets._whole import WholeTable
from tests.unit.guard import simulated_sensors as sensors

GAINS = np.array([0.5, 0.0, 2.0, 1.0, -1.5, 0.5])  # um/K


def measured(runs: int, seed: int) -> Recording:
    """A recording with a deviation of its temperatures."""
    rows = sensors.machine(runs, seed)
    x = np.column_stack([rows.array(n) for n in sensors.NAMES])
    y = (x - 20.0) @ GAINS + 0.3 * np.random.default_rng(seed).standard_normal(len(x))
    return rows.with_columns({"E_Z": y}, {"E_Z": Column(role="error", component="E_Z", unit="um")})


def machine(runs: int, seed: int, read: tuple[str, ...] = sensors.NAMES) -> tuple[Recording, ErrorModel]:
    """A recording, and a model of terms fitted to it."""
    rows = measured(runs, seed)
    terms = [{"term": "offset"}, *({"term": "thermal_drift", "sensor": n} for n in read)]
    return rows, Terms.model_validate({"components": [{"component": "E_Z", "terms": terms}]}).fit(rows).model


def judged(rows: Recording, model: ErrorModel) -> _guarded.Baseline:
    plain = compile_model(model, CompileOptions(), None, rows)
    (c,) = model.components
    return _guarded.Baseline(model, CompileOptions(), rows, plain, {"E_Z": c.rms_after}, {"E_Z": c.rms_before})


@pytest.fixture(scope="module")
def watched():
    rows, model = machine(8, 5)
    judge = judged(rows, model)
    return rows, model, judge, _guarded.choose_guard(judge, None)


def test_six_sensors_are_watched_within_400_nodes_and_cost_nothing(watched):
    _, _, judge, found = watched
    table = judge.compiled(found.guard)
    assert found.guard.names() == sensors.NAMES and found.guard.compares
    assert len(table.nodes) - len(judge.plain.nodes) <= 400
    assert found.document["cost"] <= _guarded.MAX_COST
    assert found.title("a lathe") == "a lathe"


@pytest.mark.parametrize("way", ["stuck", "lost", "hot", "step", "low"])
def test_a_failed_sensor_is_stood_in_for(watched, way):
    """The one that counts most, from the third hour on."""
    _, model, judge, found = watched
    fresh = measured(4, 6)
    late, x = fresh.time() >= 7200.0, fresh.array("T_housing").copy()
    stuck = np.concatenate([np.full(480, x[480 * k + 120]) for k in range(4)])
    wrong = {"stuck": stuck, "lost": np.nan, "hot": 850.0, "step": x - 4.0, "low": 0.85 * x}[way]
    failed = fresh.with_columns({"T_housing": np.where(late, wrong, x)}, {})

    def left(table):
        return np.sqrt(np.mean((fresh.array("E_Z") - table_values(table, model, failed)["E_Z"])[late] ** 2))

    bare, guarded = left(judge.plain), left(judge.compiled(found.guard))
    assert guarded < 0.7 * bare


def nine(runs: int, seed: int) -> Recording:
    """`measured`, with three further sensors between others, which the deviation follows too."""
    rows, rng = measured(runs, seed), np.random.default_rng(1000 + seed)
    x = {n: rows.array(n) for n in sensors.NAMES}
    pairs = {"T_7": ("T_bearing", "T_housing"), "T_8": ("T_motor", "T_column"), "T_9": ("T_bed", "T_room")}
    more = {n: (x[a] + x[b]) / 2 + 0.05 * rng.standard_normal(len(rows)) for n, (a, b) in pairs.items()}
    y = rows.array("E_Z") + sum(0.3 * (v - 20.0) for v in more.values())
    role = Column(role="temperature", unit="degC")
    return rows.with_columns(more | {"E_Z": y}, dict.fromkeys(more, role))


@pytest.fixture(scope="module")
def kept():
    """A model of nine sensors, of which six are compared; its baseline, and the guard chosen."""
    rows = nine(8, 5)
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    judge = judged(rows, model)
    return model, judge, _guarded.choose_guard(judge, None)


@pytest.mark.parametrize("wrong", [0.0, np.nan, 35.0])
def test_a_sensor_beyond_those_compared_is_kept_consistent_with_them(kept, wrong):
    model, judge, found = kept
    assert len(found.guard.sensors) == 6 and len(found.guard.kept) == 3
    table, fresh = judge.compiled(found.guard), nine(4, 6)
    healthy, late = table_values(table, model, fresh)["E_Z"], fresh.time() >= 7200.0
    assert np.sqrt(np.mean((healthy - table_values(judge.plain, model, fresh)["E_Z"]) ** 2)) < 0.1
    for name in found.guard.kept_names():
        failed = fresh.with_columns({name: np.where(late, wrong, fresh.array(name))}, {})
        assert np.std(table_values(table, model, failed)["E_Z"] - healthy) < 0.1 * np.std(healthy)
    free = in_table.without_guard(table)
    assert len(free.nodes) == len(judge.plain.nodes)
    assert np.array_equal(table_values(free, model, fresh)["E_Z"], table_values(judge.plain, model, fresh)["E_Z"])


def test_a_kept_sensor_is_compared_with_the_replacement_of_one_that_failed():
    """4 K less on T_housing: half of it would be taken off T_7 by an estimate from the reading itself."""
    learnt, fresh = learn.learn(nine(8, 5), sensors.NAMES, ("T_7", "T_8", "T_9")), nine(4, 6)
    wrong = np.where(fresh.time() >= 7200.0, fresh.array("T_housing") - 4.0, fresh.array("T_housing"))
    failed = fresh.with_columns({"T_housing": wrong}, {})
    for sensor in learnt.kept:
        (counted,) = drive_all([replace_reading.guarded(d.Input(name=sensor.name), learnt)], failed).T
        assert np.abs(counted - fresh.array(sensor.name)).max() < 1.0, sensor.name


def test_a_table_without_its_guard_is_the_plain_one(watched):
    rows, model, judge, found = watched
    table = judge.compiled(found.guard)
    free = in_table.without_guard(table)
    assert in_table.has_guard(table) and in_table.has_substitutes(table) and not in_table.has_guard(free)
    assert len(free.nodes) == len(judge.plain.nodes) and in_table.without_guard(judge.plain) is judge.plain
    output, plain = (table_values(t, model, rows)["E_Z"] for t in (free, judge.plain))
    np.testing.assert_array_equal(output, plain)
    names = {"T_bed": np.array([20.0, 25.0])}
    settled = [_sample.corrections(t, "Z", names, np.ones(2)) for t in (table, judge.plain)]
    np.testing.assert_array_equal(*settled)
    assert np.ptp(settled[0]) > 0.005  # 1.5 um/K x 5 K: a settled reading is not a frozen one


def test_one_run_or_one_sensor_is_watched_by_itself():
    for runs, read, why in ((1, ("T_bearing", "T_room"), "found: 2, 1"), (4, ("T_bed",), "found: 1, 4")):
        rows, model = machine(runs, 7, read)
        rows = without(rows, set(sensors.NAMES) - set(read))
        found = _guarded.choose_guard(judged(rows, model), None)
        assert not found.guard.compares and why in found.sentence, found.sentence
        assert found.title(200 * "x").endswith(f"x; {_guarded.MONITORED_ALONE}") and len(found.title(200 * "x")) == 127
        table = judged(rows, model).compiled(found.guard)
        assert in_table.has_guard(table) and not in_table.has_substitutes(table)


def without(rows: Recording, names: set[str]) -> Recording:
    columns = {k: c for k, c in rows.manifest.columns.items() if k not in names}
    return Recording(rows.manifest.model_copy(update={"columns": columns}), rows.frame.drop(columns=list(names)))


def test_a_sensor_watched_by_itself_fades_the_correction_where_it_stands_still():
    rows, model = machine(1, 7, ("T_bearing", "T_room"))
    judge = judged(rows, model)
    table = judge.compiled(_guarded.choose_guard(judge, None).guard)
    late = rows.time() >= 7200.0
    x = rows.array("T_bearing")
    failed = rows.with_columns({"T_bearing": np.where(late, x[120], x)}, {})
    end = -1
    assert abs(table_values(judge.plain, model, failed)["E_Z"][end]) > 5.0
    assert abs(table_values(table, model, failed)["E_Z"][end]) < 0.5


def test_a_jump_is_a_fault_and_the_quickest_sound_change_none(watched):
    rows, _, _, found = watched
    guard = found.guard
    k = sensors.NAMES.index("T_bed")
    assert not drive_all(faults(guard), rows).any()
    step = np.where(rows.time() > 7200.0, 2.0 * guard.sensors[k].rule("sudden_change").jump, 0.0)
    jumped = rows.with_columns({"T_bed": rows.array("T_bed") + step}, {})
    assert drive_all(faults(guard), jumped)[:, k].any()


def test_a_guard_that_costs_sound_sensors_too_much_is_left_out_and_reported(watched):
    """One that alarms in every other group: each temperature is then monitored individually."""
    rows, _, judge, _ = watched
    real = learn.learn

    def jumpy(recording, names):
        guard = real(recording, names)
        return guard if len(recording) == len(rows) else guard.model_copy(update={"threshold": 0.05 * guard.threshold})

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(learn, "learn", jumpy)
        found = _guarded.choose_guard(judge, None)
    assert not found.guard.compares and "with healthy sensors it would cost" in found.sentence


def test_a_group_whose_states_go_on_from_the_group_before_it_makes_no_guard_costly():
    """Days of two runs each, the second without a pause: evaluated alone, its lags start in another state."""
    rows = measured(4, 9)
    late = rows_of(rows, ("T_bearing",))
    shaft = 3.0 * late.lagged(late.x, 5400.0)[:, 0] + rows.array("E_Z") / 100.0  # um, at 3 um/K
    rows = rows.with_columns({"E_Z": shaft}, {})
    halves = [
        f"{day} {'late' if t > 7200.0 else 'early'}" for day, t in zip(rows.run_codes(), rows.time(), strict=True)
    ]
    rows = rows.with_columns({"run": np.array(halves)}, {"run": Column(role="run")})
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    judge = judged(rows, model)
    by_group = [judge.predicted(judge.plain, rows.take(rows.run_codes() == k))["E_Z"] for k in range(8)]
    assert np.abs(np.concatenate(by_group) - judge.predicted(judge.plain, rows)["E_Z"]).max() > 0.3
    found = _guarded.choose_guard(judge, "leave-one-run-out")
    assert found.guard.compares and found.document["cost"] <= _guarded.MAX_COST, found.sentence


def test_a_sensor_that_no_other_tells_fades_the_correction(watched):
    """The stand-in of a sensor whose noise the table turns into more than the whole error."""
    rows, model, judge, _ = watched
    before = {"E_Z": 1.01 * judge.left["E_Z"]}
    poor = _guarded.Baseline(model, CompileOptions(), rows, judge.plain, judge.left, before)
    lost = _guarded.choose_guard(poor, None)
    assert not all(s.stands_in for s in lost.guard.sensors) and "fades if" in lost.sentence
    alone = [s for s in lost.guard.sensors if not s.stands_in]  # a false alarm would cost the whole correction
    assert all(s.rule("sudden_change").jump >= 5.0 for s in alone)


@pytest.mark.slow
def test_temperatures_of_little_influence_are_held_and_others_fade(kept):
    """Without room for those beyond six: the smallest change that each makes counts, the sum up to the limit."""
    model, judge, _ = kept
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_guarded, "NODES_KEPT", 10_000)
        found = _guarded.choose_guard(judge, None)
        patch.setattr(_guarded, "MAX_HELD", 0.0)
        fading = _guarded.choose_guard(judge, None)
    assert len(found.guard.held) == 3 and "T_9" in found.guard.held and "keeps its last reading" in found.sentence
    assert not fading.guard.held and "fades if one is lost" in fading.sentence
    taken = len(judge.compiled(found.guard).nodes) - len(judge.compiled(fading.guard).nodes)
    assert taken == 3 * _guarded.NODES_HELD
    fresh = nine(4, 6)
    gone = fresh.with_columns({"T_9": np.where(fresh.time() >= 7200.0, np.nan, fresh.array("T_9"))}, {})
    last = fresh.time() == fresh.time().max()
    healthy, held, faded = (
        table_values(judge.compiled(g), model, rows)["E_Z"][last]
        for g, rows in ((found.guard, fresh), (found.guard, gone), (fading.guard, gone))
    )
    assert np.abs(held - healthy).max() < 2.0 and np.abs(faded).max() < 1e-6 < 10.0 < np.abs(healthy).max()


def test_temperatures_are_held_up_to_the_nodes_and_the_sum_of_their_influences():
    """The smallest first; 0.09, 0.18 ... of the uncompensated rms."""
    little = {f"T_{k}": (0.0, 0.09 * k) for k in (4, 1, 3, 2, 5)}
    assert _guarded._held_sensors(little, 100) == ("T_4", "T_1", "T_3", "T_2")
    assert _guarded._held_sensors(little, 2) == ("T_1", "T_2") and not _guarded._held_sensors(little, -1)


@pytest.mark.parametrize("guarded", [True, False])
def test_checklists_say_whether_sensors_are_watched(watched, guarded):
    _, _, judge, found = watched
    table = judge.compiled(found.guard) if guarded else judge.plain
    whole, lines = WholeTable(table=table), ReadBack()
    assert any("monitored against each other" in x for x in _sensor_monitoring(whole, table)) == guarded
    assert any("the table has no guard" in x for x in _sensor_monitoring(whole, table)) != guarded
    assert any("no memory for a guard" in x for x in _sensor_monitoring(lines, table))


def test_no_guard_is_reported_in_the_title(tmp_path):
    found = _guarded.no_guard("guard: false")
    assert found.title("lathe") == f"lathe; {_guarded.NOT_MONITORED}" and "guard: false" in found.sentence


def test_a_table_without_room_has_a_smaller_guard_or_none(watched):
    """300 nodes are enough for five sensors that are compared, 100 for four by themselves, 20 for none."""
    _, _, judge, _ = watched

    def with_room(nodes: int) -> _guarded.TableGuard:
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(_guarded.Baseline, "free_nodes", lambda self: nodes)
            return _guarded.choose_guard(judge, None)

    few, alone, none = map(with_room, (300, 100, 20))
    assert few.guard.compares and len(few.guard.sensors) == 5
    assert not alone.guard.compares and len(alone.guard.sensors) == 4 and "free nodes" in alone.sentence
    assert none.guard is None and "free nodes" in none.sentence
    assert len(judge.compiled(few.guard).nodes) - len(judge.plain.nodes) <= 300
    assert len(judge.compiled(alone.guard).nodes) - len(judge.plain.nodes) <= 100


def test_a_guard_of_a_long_recording_is_learnt_from_some_of_its_rows():
    """Rows every half minute first, then some of the runs: 43,200 rows of a minute and 60,000 of 5 ms."""
    slow = _guarded._fewer_rows(sensors.machine(90, 5))
    assert len(slow) <= _guarded.MAX_ROWS and len(np.unique(slow.run_codes())) == 30
    assert np.allclose(np.diff(slow.time()[:480]), 60.0)
    columns = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    frame = pd.DataFrame({"run": np.repeat(["a", "b"], 30_000), "t": np.tile(np.arange(30_000) * 0.005, 2)})
    quick = _guarded._fewer_rows(Recording(Manifest(recording=1, tables=("r.csv",), columns=columns), frame))
    assert len(quick) == 20_000 and quick.time()[0] == 0.0 and np.allclose(np.diff(quick.time()[:100]), 0.015)


def test_a_sensor_that_is_late_at_the_start_does_not_delay_the_others() -> None:
    """Lags and rises of the other sensors count from the start of the run, as without a guard, not from its reading."""
    rows = measured(8, 5)
    shaft = rows_of(rows, sensors.NAMES).lagged(rows_of(rows, sensors.NAMES).x, 5400.0)
    rows = rows.with_columns({"E_Z": shaft @ GAINS}, {})
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    late = rows.with_columns({"T_bed": np.where(rows.time() < 1500.0, np.nan, rows.array("T_bed"))}, {})
    plain, guarded = (
        table_values(compile_model(model, CompileOptions(), g, rows), model, late)["E_Z"]
        for g in (None, learn.learn(rows))
    )
    known = np.isfinite(plain) & (rows.time() >= 1500.0)
    assert np.abs(plain[known]).max() > 5.0
    assert np.abs(guarded - plain)[known].max() < 1.0  # T_bed's own rise is estimated


@pytest.mark.parametrize("by", [learn.learn, learn.limits])
def test_what_a_late_sensor_missed_is_estimated_from_the_starts_of_others(by) -> None:
    rows = measured(8, 5)  # with sensors that read 5 K more than the others, and 3 K less
    offsets = {"T_housing": 5.0, "T_bearing": -3.0}
    rows = rows.with_columns({n: rows.array(n) + offset for n, offset in offsets.items()}, {})
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    tables = [compile_model(model, CompileOptions(), g, rows) for g in (None, by(rows, sensors.NAMES))]
    whole = table_values(tables[0], model, rows)["E_Z"]
    for name, since in (("T_housing", 2400.0), ("T_bearing", 900.0)):
        late = rows.with_columns({name: np.where(rows.time() < since, np.nan, rows.array(name))}, {})
        known = rows.time() >= since
        off, mended = (np.abs(table_values(t, model, late)["E_Z"] - whole)[known].mean() for t in tables)
        assert mended < 0.5 * off, (name, mended, off)
        free = in_table.without_guard(tables[1])
        assert np.array_equal(table_values(free, model, late)["E_Z"], table_values(tables[0], model, late)["E_Z"])
    assert np.array_equal(table_values(tables[1], model, rows)["E_Z"], whole)


def test_sensors_that_are_late_together_missed_nothing_that_is_known() -> None:
    """Whether the machine was warm when a log of its temperatures began is not known."""
    rows = measured(8, 5)
    model = Lagged.model_validate({"family": "lagged", "component": "E_Z"}).fit(rows).model
    gone = rows.time() < 1800.0
    late = rows.with_columns({n: np.where(gone, np.nan, rows.array(n)) for n in sensors.NAMES}, {})
    guard = learn.limits(rows, sensors.NAMES)
    none = guard.model_copy(update={"sensors": tuple(s.model_copy(update={"start": None}) for s in guard.sensors)})
    one, other = (
        table_values(compile_model(model, CompileOptions(), g, rows), model, late)["E_Z"] for g in (guard, none)
    )
    assert np.abs(one - other)[~gone].max() < 1e-6 < 1.0 < np.abs(one[~gone]).max()


def test_a_start_that_is_known_no_better_than_the_rise_is_not_estimated() -> None:
    rows = measured(8, 5)
    away = np.random.default_rng(1).normal(0.0, 30.0, 8)[rows.run_codes()]  # K, another offset in each run
    moved = rows.with_columns({"T_bearing": rows.array("T_bearing") + away}, {})
    for by in (learn.learn, learn.limits):
        assert by(moved, sensors.NAMES).sensors[0].start is None
        assert by(rows, sensors.NAMES).sensors[0].start is not None
        assert by(rows.take(rows.run_codes() < 2), sensors.NAMES).sensors[0].start is None


def test_a_model_whose_lags_fill_the_table_is_guarded_all_the_same(watched) -> None:
    """One node more for each lag does not fit: these then start with the last sensor."""
    rows, model, _judge, found = watched
    real, bed = _compile._guarded, d.Input(name="T_bed")
    many = [d.Clip(of=bed, low=-1.0 - 0.01 * k, high=50.0) for k in range(1100)]
    sums = [d.Affine(weights=(1.0,) * 44, of=tuple(many[k::25])) for k in range(25)]

    def large(pair, guard, inputs, apart):
        return (
            replace(pair, driver=d.Affine(weights=(1e-3,) * 25, of=tuple(sums)))
            if apart
            else real(pair, guard, inputs, apart)
        )

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(_compile, "_guarded", large)
        table = compile_model(model, CompileOptions(), found.guard, rows)
    assert in_table.has_guard(table) and len(table.nodes) < 1000
