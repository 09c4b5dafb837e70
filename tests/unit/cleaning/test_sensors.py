"""Sensors that say nothing, stick, break or jump: set aside or blanked; a standstill by nature is kept."""

import numpy as np
import pytest

from errpipe.cleaning import clean
from errpipe.cleaning.outliers import Outliers
from errpipe.cleaning.sensor_jumps import SensorJumps
from errpipe.cleaning.stuck_sensors import StuckSensors
from errpipe.errors import DataError
from tests.unit.cleaning.faulty_recordings import changed, recording, touched, warm_up


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


@pytest.mark.filterwarnings("error")
def test_one_reading_for_each_run_is_no_sensor_that_stands_still():
    """A thermometer noted once a run: not one row outside these stretches."""
    source = warm_up(4)
    readings = np.repeat([20.0, 21.5, 23.0], [300, 300, len(source) - 600])
    others = {name: readings + k for k, name in enumerate(source.names("temperature"))}
    assert touched(clean(changed(source, **others), (StuckSensors(),))[1], "stuck_sensors") == []


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
def test_a_response_over_a_position_or_with_its_simulation_keeps_its_steps(also):
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
