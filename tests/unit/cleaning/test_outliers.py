"""Outliers: what was planted is found, and physics stays: steps, reversals, warm-up, coarse displays, twins."""

import numpy as np
import pytest

from errpipe.cleaning import clean
from errpipe.cleaning.outliers import Outliers, outlying
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.simulation import sample_recordings
from tests.unit.cleaning.faulty_recordings import changed, noise, recording, touched, warm_up


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
def test_an_outlier_next_to_a_step_or_at_an_end_is_still_found(shape, row):
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


def test_runs_are_separate_and_empty_cells_are_missing():
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


def test_the_last_target_of_a_stroke_may_lie_further_off_than_the_others():
    """A steep scale error at targets of which the last is 1.8 steps away; a reading that is off is still found."""
    targets = np.r_[np.arange(18.0), 18.8] * 40
    there_and_back = np.tile(np.r_[targets, targets[::-1]], 5)
    error = 0.1 * there_and_back + noise(190)
    run, t = np.repeat(np.arange(5), 38), np.arange(190.0)
    assert outlying(error, run, t, 6.0, position=there_and_back).size == 0
    error[[18, 103]] += 2.0
    assert list(outlying(error, run, t, 6.0, position=there_and_back)) == [18, 103]
    assert len(outlying(error, run, t, 6.0)) > 2  # as it was: the ends were taken for outliers


def test_a_steep_end_that_every_pass_repeats_is_no_outlier_and_a_wrong_reading_there_is_one():
    """A curve that rises by 40 um over its last targets, as an autocollimator or a worn screw shows."""
    x = np.linspace(2.0, 598.0, 25)
    there_and_back = np.r_[x, x[::-1]]
    curve = 45.0 * ((there_and_back - 300.0) / 298.0) ** 8
    error = np.r_[curve, curve] + noise(100, 3) * 0.3
    run, t, position = np.repeat(np.arange(2), 50), np.arange(100.0), np.tile(there_and_back, 2)
    assert outlying(error, run, t, 6.0).size > 2
    assert outlying(error, run, t, 6.0, position=position).size == 0
    error[24] += 40.0
    assert list(outlying(error, run, t, 6.0, position=position)) == [24]


def test_next_to_a_twin_the_difference_is_judged():
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


def test_one_outlier_of_few_readings_is_blanked() -> None:
    """One of twenty is 5 %: a log of twenty readings was refused for it."""
    values = np.random.default_rng(3).normal(0.0, 0.1, 20)
    values[9] += 20.0
    cleaned, _ = clean(changed(warm_up().take(np.arange(20)), E_Z=values), (Outliers(),))
    assert np.isnan(cleaned.array("E_Z")).nonzero()[0].tolist() == [9]


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
