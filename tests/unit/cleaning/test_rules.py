"""Every rule: finds what was planted, leaves alone what is physics, says which rows and why, keeps to its share."""

import numpy as np
import pytest

from errpipe import jsonfile
from errpipe.cleaning import RULES, WHOLE_RUN, clean
from errpipe.cleaning._base import resolution
from errpipe.cleaning.gaps import Gaps
from errpipe.cleaning.outliers import Outliers, outlying
from errpipe.cleaning.quantisation import Quantisation
from errpipe.cleaning.repeated_rows import RepeatedRows
from errpipe.cleaning.sensor_jumps import SensorJumps
from errpipe.cleaning.stuck_sensors import StuckSensors
from errpipe.cleaning.time_order import TimeOrder
from errpipe.cleaning.unit_slips import UnitSlips
from errpipe.domain.recording import Constant, Recording
from errpipe.errors import DataError
from errpipe.simulation import sample_recordings
from tests.unit.cleaning.faulty_recordings import changed, recording, warm_up


def touched(report, rule, column=None):
    """Row numbers that a rule touched."""
    done = [d for r in report.rules if r.rule == rule for d in r.done if column in (None, d.column)]
    return sorted(row for d in done for start, end in d.rows for row in range(start, end))


def test_a_clean_recording_stays_as_it_is():
    for seed in range(5):
        source = warm_up(seed, step=0.05)
        cleaned, report = clean(source)
        removing = [d for r in report.rules for d in r.done if d.what != "note"]
        assert removing == [] and cleaned.frame.equals(source.frame)


def test_the_report_is_canonical_json_and_names_every_rule_and_option():
    source = warm_up()
    source.frame.loc[100, "E_Z"] += 40.0
    _, report = clean(source)
    text = jsonfile.dumps(report.plain())
    assert text == jsonfile.dumps(clean(source)[1].plain())
    assert [r.rule for r in report.rules] == [rule.model_fields["rule"].default for rule in RULES]
    plain = {r["rule"]: r for r in report.plain()["rules"]}
    assert plain["outliers"]["options"] == {"threshold": 6.0, "most": 0.02}
    (done,) = plain["outliers"]["done"]
    assert (done["what"], done["column"], done["rows"], done["count"]) == ("blank cells", "E_Z", [[100, 101]], 1)


def test_every_option_has_a_meaning():
    for rule in RULES:
        for name, field in rule.model_fields.items():
            assert name == "rule" or field.description, f"{rule.__name__}.{name}"


def test_row_numbers_are_those_of_the_recording_that_came_in():
    source = warm_up()
    doubled = source.take(np.r_[0:50, 49, 50:1200])
    doubled.frame.loc[200, "E_Z"] += 40.0  # row 200 here, row 199 once the double is gone
    _, report = clean(doubled)
    assert touched(report, "repeated_rows") == [50]
    assert touched(report, "outliers") == [200]


# ---------------------------------------------------------------- outliers


@pytest.mark.parametrize("seed", range(5))
def test_planted_outliers_are_found_and_little_else(seed):
    """Outliers of 8 noises and more, 1 % of the rows: at least 95 in 100 found, at most 1 in 2000 clean rows lost."""
    rng = np.random.default_rng(seed)
    source = warm_up(seed, rows=2000)
    rows = np.sort(rng.choice(4000, 40, replace=False))
    error = source.array("E_Z").copy()
    error[rows] += rng.choice([-1, 1], 40) * rng.uniform(4.0, 15.0, 40)
    _, report = clean(changed(source, E_Z=error), (Outliers(),))
    counts = touched(report, "outliers", "E_Z")
    assert len(set(counts) & set(rows)) >= 38
    assert len(set(counts) - set(rows)) <= 2


def noise(rows, seed=0):
    return 0.1 * np.random.default_rng(seed).standard_normal(rows)


T = np.arange(400.0)
SHAPES = {
    "a step": np.where(T < 200, 0.0, 50.0),
    "a staircase": np.floor(T / 20) * 10,
    "a steep ramp": 5 * T,
    "a warm-up": 80 * (1 - np.exp(-T / 6)),
    "a decaying spike": np.where(T >= 150, 20 * np.exp(-(T - 150) / 1.5), 0),
    "a pulse of three readings": np.where((T >= 150) & (T < 153), 20.0, 0),
    "a wave": 30 * np.sin(T / 3),
    "backlash, there and back": np.where(T % 40 < 20, 8.0, 0.0),
    "a rough stretch": np.where((T > 100) & (T < 200), 40 * noise(400, 1), 0),
}


@pytest.mark.parametrize("shape", SHAPES)
def test_what_is_physics_stays(shape):
    y = SHAPES[shape] + noise(400)
    assert outlying(y, np.zeros(400, dtype=int), T, 6.0).size == 0


@pytest.mark.parametrize("shape", ["a step", "a staircase", "backlash, there and back", "a steep ramp"])
@pytest.mark.parametrize("row", [0, 1, 199, 200, 201, 398, 399])
def test_an_outlier_beside_a_step_or_at_an_end_is_still_found(shape, row):
    y = SHAPES[shape] + noise(400)
    if shape == "a step" and row in (0, 1, 398, 399):
        y *= 0.2  # at an end whatever is no further off than a step of the run could be one
    y[row] += -30.0 if row == 199 else 30.0  # between two levels of a step anything could be the step itself
    assert list(outlying(y, np.zeros(400, dtype=int), T, 6.0)) == [row]


@pytest.mark.parametrize("seed", range(12))
def test_a_temperature_logged_every_ten_minutes_has_no_outlier_where_it_starts_to_warm(seed):
    """Speeds change every half hour; first and last readings begin or end a rise of 10 K, which is none."""
    rng = np.random.default_rng(seed)
    t = np.arange(48) * 600.0
    speed = np.repeat(rng.choice([0.0, 0.3, 0.6, 1.0], 16), 3)
    share = 1 - np.exp(-600.0 / rng.uniform(600, 3000))
    rise = np.zeros(48)
    for k in range(1, 48):
        rise[k] = rise[k - 1] + share * (20 * speed[k] - rise[k - 1])
    y = 20 + rise + 0.05 * rng.standard_normal(48)
    assert outlying(y, np.zeros(48, dtype=int), t, 6.0).size == 0


def test_runs_are_judged_apart_and_empty_cells_are_none():
    y = np.r_[noise(50), 100 + noise(50, 1)]
    y[[10, 11, 12, 49, 50]] = np.nan
    assert outlying(y, np.repeat([0, 1], 50), np.arange(100.0), 6.0).size == 0
    y[20] = 5.0
    assert list(outlying(y, np.repeat([0, 1], 50), np.arange(100.0), 6.0)) == [20]


def test_two_outliers_side_by_side_are_found_and_a_quantised_line_has_none():
    y = noise(300)
    y[[100, 101]] += 4
    assert list(outlying(y, np.zeros(300, dtype=int), np.arange(300.0), 6.0)) == [100, 101]
    flat = np.zeros(300)
    flat[::37] = 0.1
    assert outlying(flat, np.zeros(300, dtype=int), np.arange(300.0), 6.0, step=0.1).size == 0


def test_after_a_pause_everything_may_be_different():
    t = np.r_[np.arange(200.0), 5000 + np.arange(2.0), 9000 + np.arange(200.0)]
    y = np.r_[np.zeros(200), [30, 31], np.zeros(200)] + noise(402)
    assert outlying(y, np.zeros(402, dtype=int), t, 6.0).size == 0


def test_spikes_at_rare_reversals_are_physics():
    """A spike of one reading at each reversal of a circular test repeats with the motion: it is not removed."""
    rows = 2000
    phase = 2 * np.pi * np.arange(rows) / 500
    v = np.cos(phase)
    turns = np.flatnonzero(np.sign(v[1:]) != np.sign(v[:-1])) + 1
    error = noise(rows)
    error[turns] += 5.0
    error[777] += 5.0
    source = recording(run=["1"] * rows, t=np.arange(rows) * 0.01, x=np.sin(phase), v=v, E_Z=error)
    _, report = clean(source, (Outliers(),))
    assert touched(report, "outliers") == [777]


def test_beside_a_twin_the_difference_is_judged():
    shape = 30 * np.sin(np.arange(600) * 1.3)  # so rough in time that the record itself shows nothing
    error = shape + noise(600)
    error[300] += 3.0
    source = recording(run=["1"] * 600, t=np.arange(600.0), E_Z=error, E_Z_sim=0.97 * shape)
    assert touched(clean(source, (Outliers(),))[1], "outliers") == []
    source = changed(source, E_Z_sim=shape)
    assert touched(clean(source, (Outliers(),))[1], "outliers") == [300]


def test_more_outliers_than_the_share_are_refused():
    source = warm_up()
    error = source.array("E_Z").copy()
    error[::17] += 30.0
    with pytest.raises(DataError, match=r"clean, outliers: would remove \d+ of 1200 cells of E_Z \(\d\.\d %\), more"):
        clean(changed(source, E_Z=error), (Outliers(),))
    assert len(touched(clean(changed(source, E_Z=error), (Outliers(most=0.1),))[1], "outliers")) > 60


# ---------------------------------------------------------------- sensors


def test_dead_sensors_are_set_aside_so_that_nothing_binds_to_them():
    source = warm_up()
    half = np.where(np.arange(1200) > 500, np.nan, source.array("T_column"))
    source = source.with_columns(
        {"T_flat": np.full(1200, 20.0), "T_none": np.full(1200, np.nan)},
        dict.fromkeys(("T_flat", "T_none"), source.manifest.columns["T_room"]),
    )
    cleaned, report = clean(changed(source, T_column=half), (StuckSensors(),))
    assert cleaned.names("temperature") == ("T_bearing", "T_motor", "T_room")
    assert cleaned.manifest.columns["T_flat"].role == "ignore"
    reasons = {d.column: d.reason for d in report.rules[0].done}
    assert reasons == {
        "T_column": "empty in 699 of 1200 rows",
        "T_flat": "shows 20 in every row",
        "T_none": "holds no value",
    }


@pytest.mark.parametrize("step", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("name", ["T_bearing", "T_motor"])
def test_a_stuck_stretch_is_blanked(step, name):
    source = warm_up(step=step)
    values = source.array(name).copy()
    values[300:420] = values[299]
    cleaned, report = clean(changed(source, **{name: values}), (StuckSensors(),))
    rows = touched(report, "stuck_sensors", name)
    assert set(range(300, 420)) <= set(rows) and len(rows) <= 125
    assert np.isnan(cleaned.array(name)[300:420]).all()
    assert report.rules[0].done[0].reason.endswith("while the other sensors moved")


def test_a_sensor_that_is_stuck_most_of_the_time_is_set_aside():
    source = warm_up(step=0.05)
    values = source.array("T_motor").copy()
    values[400:1000] = values[399]
    cleaned, _ = clean(changed(source, T_motor=values), (StuckSensors(),))
    assert "T_motor" not in cleaned.frame


def test_a_coarse_display_that_stands_still_by_nature_is_not_stuck():
    """A room sensor of 0.5 degC steps stands still for hours; so do all of them over a night at rest."""
    for seed in range(5):
        source = warm_up(seed, noise=0.01, step=0.5)
        assert touched(clean(source, (StuckSensors(),))[1], "stuck_sensors") == []
    night = warm_up(noise=0.0, step=0.1)
    frame = night.frame.copy()
    for name in night.names("temperature"):
        frame.loc[600:, name] = frame.loc[600, name]
    assert touched(clean(changed(night, **dict(frame.items())), (StuckSensors(),))[1], "stuck_sensors") == []


@pytest.mark.parametrize("mark", [0.0, -999.0, 850.0])
def test_a_broken_sensors_mark_is_blanked(mark):
    values = warm_up().array("T_bearing").copy()
    values[[7, 8, 500]] = mark
    _, report = clean(changed(warm_up(), T_bearing=values), (StuckSensors(),))
    assert touched(report, "stuck_sensors", "T_bearing") == [7, 8, 500]
    assert report.rules[0].done[0].reason == f"shows {mark:g}, a broken sensor's mark"


def test_a_workshop_in_winter_may_be_at_zero():
    source = warm_up()
    cold = np.round(source.array("T_room") - 20, 1)
    assert (cold == 0).sum() > 3
    assert touched(clean(changed(source, T_room=cold), (StuckSensors(),))[1], "stuck_sensors") == []


def test_setting_most_sensors_aside_is_refused():
    source = warm_up()
    dead = {n: np.full(1200, 20.0) for n in ("T_bearing", "T_motor", "T_column")}
    with pytest.raises(DataError, match="clean, stuck_sensors: would set aside 3 of 4 sensors"):
        clean(changed(source, **dead), (StuckSensors(),))


# ---------------------------------------------------------------- units


@pytest.mark.parametrize("name", ["T_bearing", "T_motor", "T_column", "T_room"])
def test_a_fahrenheit_column_is_named_and_set_aside(name):
    source = warm_up()
    slipped = changed(source, **{name: source.array(name) * 1.8 + 32})
    cleaned, report = clean(slipped, (UnitSlips(),))
    (done,) = report.rules[0].done
    assert done.column == name and done.what == "set column aside" and "degF, not degC" in done.reason
    assert name not in cleaned.frame
    assert clean(slipped, (UnitSlips(trust=(name,)),))[0].frame.equals(slipped.frame)


def test_kelvin_pressure_and_humidity_slips_are_named():
    source = warm_up()
    source = source.with_columns(
        {"p": np.full(1200, 1.013), "rh": np.linspace(0.4, 0.5, 1200)},
        {"p": recording(p=[1.0]).manifest.columns["p"], "rh": recording(rh=[1.0]).manifest.columns["rh"]},
    )
    _, report = clean(changed(source, T_room=source.array("T_room") + 273.15), (UnitSlips(),))
    reasons = {d.column: d.reason for d in report.rules[0].done}
    assert "these are kelvin" in reasons["T_room"]
    assert reasons["p"] == "reads 1.013 hPa, which no air has; as bar it is 1013 hPa"
    assert reasons["rh"] == "never exceeds 0.5 %: a fraction, not per cent"


def test_a_hot_oil_is_not_taken_for_fahrenheit():
    source = warm_up()
    assert clean(changed(source, T_motor=source.array("T_motor") + 35), (UnitSlips(),))[1].rules[0].done == ()


def axis_rows(rows=200):
    x = 400 + 390 * np.sin(np.arange(rows) / 20)
    return {"run": ["1"] * rows, "t": np.arange(rows) * 0.1, "x": x, "v": np.gradient(x, 0.1), "E_Z": noise(rows)}


@pytest.mark.parametrize(
    ("column", "factor", "message"),
    [
        ("x", 1 / 25.4, "x: spans 30.71 of a travel of 800 mm; taken as inch it spans 780: inch, not mm"),
        ("x", 1e-3, "x: spans 0.78 of a travel of 800 mm; taken as m it spans 780: m, not mm"),
        ("v", 60.0, "v: the change of x in time is 0.0166"),
    ],
)
def test_a_slipped_position_or_speed_is_refused_with_the_evidence(column, factor, message):
    rows = axis_rows()
    travel = {"X": Constant(role="axis", kind="linear", travel=(0, 800), unit="mm")}
    assert clean(recording(travel, **rows), (UnitSlips(),))[1].rules[0].done == ()
    rows[column] = rows[column] * factor
    with pytest.raises(DataError) as refusal:
        clean(recording(travel, **rows), (UnitSlips(),))
    assert str(refusal.value).splitlines()[0].startswith(f"clean, unit_slips: {message}")


def test_a_response_in_millimetres_beside_its_twin_is_refused():
    shape = 30 * np.sin(np.arange(300) / 30)
    source = recording(run=["1"] * 300, t=np.arange(300.0), E_Z=shape * 1e-3, E_Z_sim=shape)
    with pytest.raises(DataError, match=r"E_Z: E_Z_sim is 1000 times as large .*: mm\. Mend its unit in the manifest"):
        clean(source)
    gain_off = changed(source, E_Z=shape * 1.15)
    assert clean(gain_off, (UnitSlips(),))[1].rules[0].done == ()


# ---------------------------------------------------------------- rows


def test_repeated_rows_go_and_equal_readings_at_other_times_stay():
    source = recording(run=list("111122"), t=[0, 1, 1, 2, 3, 3], T1=[20, 21, 21, 21, 21, 22.0])
    cleaned, report = clean(source, (RepeatedRows(most=0.5),))
    assert touched(report, "repeated_rows") == [2, 5]  # 2 is removed, 5 is noted: same time, another reading
    assert [d.what for d in report.rules[0].done] == ["remove rows", "note"]
    assert len(cleaned) == 5


def test_rows_equal_in_what_is_missing_are_repeated_too():
    source = recording(run=list("111"), t=[0, 1, 1.0], T1=[20, np.nan, np.nan])
    assert touched(clean(source, (RepeatedRows(most=0.5),))[1], "repeated_rows") == [2]
    with pytest.raises(DataError, match=r"would remove 1 of 3 rows .* the first at row 2 \(run 1, t = 1 s\)"):
        clean(source, (RepeatedRows(),))


def test_the_fewest_rows_go_where_time_steps_back():
    t = np.arange(300.0)
    t[100] = 5.0
    t[200:202] = 999.0
    t[250] = np.nan
    source = recording(run=["1"] * 300, t=t, T1=t)
    cleaned, report = clean(source, (TimeOrder(most=0.05),))
    assert touched(report, "time_order") == [100, 200, 201, 250]
    assert (np.diff(cleaned.time()) >= 0).all()


# ---------------------------------------------------------------- gaps


def test_short_holes_hold_the_reading_before_and_long_ones_stay():
    values = np.arange(20.0)
    values[[0, 5, 6, 12, 13, 14, 15, 16]] = np.nan
    source = recording(run=["1"] * 20, t=60.0 * np.arange(20), T1=values)
    cleaned, report = clean(source, (Gaps(hold=200, most=0.5),))
    assert touched(report, "gaps") == [5, 6]
    np.testing.assert_array_equal(cleaned.array("T1")[[4, 5, 6, 7]], [4, 4, 4, 7])
    assert np.isnan(cleaned.array("T1")[[0, 12, 16]]).all()


def test_a_hole_over_the_end_of_a_run_is_not_held():
    source = recording(run=list("111222"), t=[0, 1, 2, 0, 1, 2.0], T1=[20, 21, np.nan, np.nan, 25, 26])
    cleaned, _ = clean(source, (Gaps(most=0.5),))
    assert cleaned.array("T1")[2] == 21 and np.isnan(cleaned.array("T1")[3])


def test_a_long_pause_splits_the_run_and_the_whole_stays_a_group():
    t = np.r_[0:5, 20000:20005, 90000:90005, 0:3].astype(float)
    source = recording(run=["a"] * 15 + ["b"] * 3, t=t, T1=t)
    cleaned, report = clean(source, (Gaps(longest=7200),))
    assert cleaned.run_labels() == ("a", "a part 2", "a part 3", "b")
    assert list(cleaned.frame[WHOLE_RUN]) == ["a"] * 15 + ["b"] * 3
    assert cleaned.manifest.columns[WHOLE_RUN].of == "run"
    assert touched(report, "gaps") == list(range(5, 15))


# ---------------------------------------------------------------- display steps


def test_the_display_step_is_noted():
    done = clean(warm_up(noise=0.02, step=0.1), (Quantisation(),))[1].rules[0].done
    assert {d.column for d in done} == {"T_bearing", "T_motor", "T_column", "T_room"}
    assert done[0].reason == "displayed in steps of 0.1 degC: rounding alone is 0.029 degC rms"
    assert clean(warm_up(), (Quantisation(),))[1].rules[0].done == ()


def test_a_coarse_dial_gauge_has_no_outliers_for_its_rounding():
    """Noise of a third of the step, read in 0.01 mm: a reading one step off its neighbours is rounding."""
    for seed in range(8):
        rng, made = np.random.default_rng(seed), sample_recordings.dial_gauge(seed)
        commanded = made.array("commanded")
        reading = np.round(commanded + 0.003 * rng.normal(size=len(made)), 2)
        made = Recording(made.manifest, made.frame.assign(reading=reading, EXX=1e3 * (reading - commanded)))
        assert Outliers(rule="outliers").find(made) == []
        reading[30] += 0.2
        slipped = Recording(made.manifest, made.frame.assign(reading=reading, EXX=1e3 * (reading - commanded)))
        assert [a.rows.tolist() for a in Outliers(rule="outliers").find(slipped) if a.column == "EXX"] == [[30]]


def test_a_step_is_read_off_a_column_of_text():
    values = np.array([float(f"{0.05 * k:.2f}") for k in range(300, 420)])
    assert resolution(values) == 0.05
    assert resolution(np.random.default_rng(0).standard_normal(100)) == 0.0
    assert resolution(np.array([1.0, 1.0])) == 0.0
    commanded = np.linspace(0.0, 600.0, 88)
    derived = 1e3 * ((commanded + 0.01 * np.arange(88) % 7) - commanded)  # 10 um, but for the arithmetic
    assert resolution(derived) == pytest.approx(10.0)


@pytest.mark.parametrize("size", [5.0, -12.0])
def test_a_sensor_that_jumps_and_stays_is_blanked_to_the_end_of_its_run(size):
    source = warm_up(step=0.05)
    values = source.array("T_bearing").copy()
    values[400:600] += size
    values[900:902] += size  # two wrong readings are no jump of the level
    cleaned, report = clean(changed(source, T_bearing=values), (Outliers(), SensorJumps()))
    assert touched(report, "sensor_jumps", "T_bearing") == list(range(400, 600))
    assert np.isnan(cleaned.array("T_bearing")[400:600]).all()
    assert "stays there" in report.rules[1].done[0].reason


def test_a_sensor_that_jumped_early_is_set_aside():
    source = warm_up(runs=1)
    values = source.array("T_motor").copy()
    values[100:] += 8.0
    cleaned, _ = clean(changed(source, T_motor=values), (SensorJumps(),))
    assert "T_motor" not in cleaned.frame and "T_bearing" in cleaned.frame


def test_heat_of_a_fluid_and_steps_that_come_again_are_no_jump_of_a_sensor():
    """A fluid that is switched on warms its sensor over some readings; a coolant that is switched often steps often."""
    source = warm_up()
    after = np.maximum(np.arange(600) - 300.0, 0.0)
    fast = source.array("T_motor") + np.tile(6.0 * (1 - np.exp(-after * 60 / 90)), 2)  # K: a body of 90 s
    switched = source.array("T_column") + 6.0 * (np.arange(1200) // 100 % 2)
    assert touched(clean(changed(source, T_motor=fast, T_column=switched), (SensorJumps(),))[1], "sensor_jumps") == []
    new_run = source.array("T_room").copy()
    new_run[600:] += 10.0  # another day
    assert touched(clean(changed(source, T_room=new_run), (SensorJumps(),))[1], "sensor_jumps") == []


def test_a_drift_whose_datum_was_lost_is_blanked_to_the_end_of_its_run():
    """60 um between two readings of one run; a season later the drift was left 6.4 um, 1.1 without the jump."""
    source = warm_up()
    moved = source.array("E_Z").copy()
    moved[300:600] += 60.0
    _, report = clean(changed(source, E_Z=moved), (SensorJumps(),))
    assert touched(report, "sensor_jumps", "E_Z") == list(range(300, 600))
    assert "um from one reading to the next" in report.rules[0].done[0].reason
    early = changed(source, E_Z=source.array("E_Z") + 60.0 * (np.arange(1200) % 600 >= 50))
    assert "E_Z" in clean(early, (SensorJumps(),))[0].frame, "a response is never set aside"


@pytest.mark.parametrize("also", ["x", "E_Z_sim"])
def test_a_response_over_a_position_or_beside_its_simulation_keeps_its_steps(also):
    source = warm_up(runs=1)
    columns = {n: source.frame[n] for n in source.frame}
    columns["E_Z"] = source.array("E_Z") + 60.0 * (np.arange(600) >= 300)
    stepped = recording(**columns, **{also: np.zeros(600)})
    assert touched(clean(stepped, (SensorJumps(),))[1], "sensor_jumps") == []


@pytest.mark.parametrize("every", [4, 10])
def test_temperatures_logged_less_often_than_rows_are_neither_empty_nor_full_of_holes(every):
    """Positions every minute, temperatures every 4 or 10 min: the usual rules refused it (exit 3)."""
    source = warm_up()
    names = ("T_bearing", "T_motor", "T_column", "T_room")
    logged = np.arange(len(source)) % every == 0
    sparse = changed(source, **{n: np.where(logged, source.array(n), np.nan) for n in names})
    cleaned, report = clean(sparse)
    assert not [d for r in report.rules for d in r.done if d.what not in ("note",)]
    assert set(names) <= set(cleaned.frame)


def test_coarse_steps_with_small_ones_between_are_no_outliers():
    """A probe of 0.255 um whose converter adds 0.009 um: 6 % of a real warm-up's readings were outliers (exit 3)."""
    rng = np.random.default_rng(6)
    rows = 1200
    growth = 17.0 * (1 - np.exp(-np.arange(rows) / 300.0)) + 0.03 * rng.standard_normal(rows)
    shown = 0.2551 * np.round(growth / 0.2551) - 0.0088 * np.floor(growth / 1.5)
    assert np.mean(np.diff(shown) == 0.0) > 0.5
    slipped = shown.copy()
    slipped[700] += 2.0
    for values, found in ((shown, []), (slipped, [700])):
        source = recording(run=np.full(rows, "1"), t=60.0 * np.arange(rows), E_Z=values)
        assert touched(clean(source, (Outliers(),))[1], "outliers", "E_Z") == found


def test_a_rule_that_is_not_by_default_waits_to_be_named(monkeypatch: pytest.MonkeyPatch) -> None:
    from errpipe import cleaning

    monkeypatch.setattr(cleaning.RULES["gaps"], "by_default", False)
    waiting = {rule.rule for rule in cleaning.DEFAULT} - {rule.rule for rule in cleaning.by_default()}
    assert waiting == {"gaps"}
