"""The thermal model for all seasons: recovers a known machine, stays causal, fades, and survives a real season."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from errpipe.domain import driver as d
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.evaluation import drive
from errpipe.errors import DataError
from errpipe.fitting.statistics import rms
from errpipe.thermal import arithmetic, causes, network
from errpipe.thermal import season as thermal_season

REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", Path(__file__).parents[4] / "shared" / "real-data"))
STEP = 140.0


def machine(runs: int = 8, warm: float = 0.0, seed: int = 0, rows: int = 120, room_early: float = 0.0) -> Recording:
    """Days of a lathe: a spindle that runs, stops for lunch, runs again; a bed; a slide without a sensor."""
    rng = np.random.default_rng(seed)
    frames = []
    for k in range(runs):
        t = np.arange(rows) * STEP
        on = ((t < 0.4 * t[-1]) | (t > 0.55 * t[-1])).astype(float)
        start = 20.0 + warm + rng.normal(0, 0.8)
        room = start + room_early + (3.0 + rng.normal(0, 1.5)) * (1 - np.exp(-t / 9000.0))
        spindle, bed, slide = np.full(rows, start), np.full(rows, start), np.full(rows, start)
        for i in range(1, rows):
            spindle[i] = spindle[i - 1] + STEP * (on[i] * 12.0 / 5400 - (spindle[i - 1] - bed[i - 1]) / 5400)
            bed[i] = bed[i - 1] + STEP * ((spindle[i - 1] - bed[i - 1]) / 30000 + (room[i - 1] - bed[i - 1]) / 20000)
            slide[i] = slide[i - 1] + STEP * (room[i - 1] - slide[i - 1]) / 7200.0
        growth = 4.0 * (spindle - spindle[0]) - 6.0 * (slide - slide[0])
        frames.append(
            pd.DataFrame(
                {
                    "run": f"r{k}",
                    "season": "warm" if warm else "cold",
                    "t": t + k * 86400.0 + warm * 1e7,
                    "T_room": room,
                    "T_spindle": spindle,
                    "T_bed": bed,
                    "E_D": 45.0 + rng.normal(0, 3) + growth + rng.normal(0, 0.3, rows),
                }
            )
        )
    columns = {
        "run": Column(role="run"),
        "season": Column(role="group", of="season"),
        "t": Column(role="time", unit="s"),
        "T_room": Column(role="temperature", unit="degC", location="room air"),
        "T_spindle": Column(role="temperature", unit="degC", location="spindle bearing"),
        "T_bed": Column(role="temperature", unit="degC", location="bed"),
        "E_D": Column(role="error", component="E_D", unit="um"),
    }
    return Recording(Manifest(recording=1, tables=("x.csv",), columns=columns), pd.concat(frames, ignore_index=True))


def both(one: Recording, two: Recording) -> Recording:
    frame = two.frame.assign(run=[f"w{r}" for r in two.frame["run"]])
    return Recording(one.manifest, pd.concat([one.frame, frame], ignore_index=True))


def truth(recording: Recording) -> np.ndarray:
    return thermal_season.since_start(recording.array(recording.names("error")[0]), recording.run_codes(), 3)[0]


def test_sensors_are_distinguished_by_location():
    sensors = causes.sensors(machine(1))
    assert (sensors.room, sensors.spindles, sensors.bed) == ("T_room", ("T_spindle",), "T_bed")
    assert sensors.starts == ("T_bed",)
    with pytest.raises(DataError, match=r"'T_rom' is not a temperature.*Did you mean T_room"):
        causes.sensors(machine(1), room="T_rom")


def test_running_is_read_from_the_bearing_alone():
    recording = machine(2)
    state = drive(causes.running(recording, causes.sensors(recording)), recording)
    t = recording.time() % 86400.0
    last = t.max()
    settled_on = (t > 900) & ((t < 0.4 * last) | (t > 0.55 * last + 900))
    settled_off = (t > 0.4 * last + 1200) & (t < 0.55 * last)
    assert state[settled_on].mean() > 0.99
    assert state[settled_off].mean() < 0.01


def two_bearings(recording: Recording) -> Recording:
    """A second bearing near the spindle: four fifths as warm, a little later."""
    spindle, bed = recording.array("T_spindle"), recording.array("T_bed")
    columns = recording.manifest.columns | {
        "T_front": Column(role="temperature", unit="degC", location="front bearing")
    }
    manifest = recording.manifest.model_copy(update={"columns": columns})
    return Recording(manifest, recording.frame.assign(T_front=bed + 0.8 * (spindle - bed)))


def running_differs(healthy: Recording, drift: float) -> float:
    """Share of the rows in which a spindle sensor that drifts, K/h, changes whether the spindle runs."""
    state = causes.running(healthy, causes.sensors(healthy))
    day = healthy.time() % 86400.0
    spoilt = healthy.frame.assign(T_spindle=healthy.array("T_spindle") + drift * day / 3600)
    return float(np.mean(drive(state, Recording(healthy.manifest, spoilt)) != drive(state, healthy)))


def test_running_is_read_off_all_bearings_so_that_one_that_drifts_changes_it_little():
    alone, both_of_them = machine(8), two_bearings(machine(8))
    assert causes.sensors(both_of_them).spindles == ("T_spindle", "T_front")
    for drift in (-2.0, 3.0):
        assert running_differs(both_of_them, drift) < 0.06 < 0.15 < running_differs(alone, drift), drift


def test_the_levels_of_running_come_from_the_rows_that_may_be_looked_at():
    recording = machine(4)
    sensors = causes.sensors(recording)
    rows = recording.run_codes() < 2
    wild = recording.frame.assign(T_spindle=np.where(rows, recording.array("T_spindle"), 1e3 * np.arange(rows.size)))
    switch = causes.running(recording, sensors, rows)
    assert causes.running(Recording(recording.manifest, wild), sensors, rows) == switch
    assert 0.0 < switch.off < switch.on < 12.0 * 3600 / 5400  # K/h: standing, and the heat this spindle makes


def test_one_kind_of_heat_or_two_speeds_tell_no_level():
    heat = np.random.default_rng(0).normal(1.0, 0.2, 2000)
    assert causes._levels(heat) == causes.HEATED
    assert causes._levels(np.r_[heat + 5.0, heat + 8.0]) == causes.HEATED
    assert causes._levels(np.r_[heat[:50], heat[:50] + 3.0]) == causes.HEATED  # too few to tell
    on, off = causes._levels(np.r_[heat, heat + 3.0])
    assert 1.0 < off < 2.5 < on < 4.0


def test_a_model_of_cold_days_holds_on_warm_days():
    cold, warm = machine(10), machine(6, warm=7.0, seed=5, room_early=2.0)
    model = thermal_season.fit(cold, "E_D")
    residual = truth(warm) - model.values(warm)
    assert rms(residual) < 0.25 * rms(truth(warm))
    pushes = {k: v for k, v in model.report["causes"].items() if "follows" not in k}
    pulls = {k: v for k, v in model.report["causes"].items() if "follows" in k}
    assert all(v > 0 for v in pushes.values()) and all(v < 0 for v in pulls.values())
    assert -8.0 < sum(pulls.values()) < -4.0


def test_a_response_that_counts_the_other_way_gives_the_mirrored_model():
    recording = machine(6)
    mirrored = Recording(recording.manifest, recording.frame.assign(E_D=-recording.frame["E_D"]))
    one, two = thermal_season.fit(recording, "E_D"), thermal_season.fit(mirrored, "E_D")
    assert_allclose(two.values(mirrored), -one.values(recording), atol=1e-9)


def test_no_deviation_no_gain():
    recording = machine(4)
    flat = Recording(recording.manifest, recording.frame.assign(E_D=12.0))
    assert_allclose(thermal_season.fit(flat, "E_D").values(flat), 0.0, atol=1e-9)


def test_row_k_uses_rows_up_to_k_only():
    recording = machine(3, seed=2)
    model = thermal_season.fit(recording, "E_D")
    whole = model.predict(recording).predicted
    cut = recording.take(np.arange(60))
    assert_allclose(model.predict(cut).predicted, whole[:60], atol=1e-9)


def test_the_fit_never_looks_outside_its_rows():
    recording = both(machine(5), machine(4, warm=7.0, seed=3))
    rows = recording.frame["season"].to_numpy() == "cold"
    spoilt = recording.frame.copy()
    spoilt.loc[~rows, "E_D"] = 1e4
    one = thermal_season.fit(recording, "E_D", rows=rows)
    two = thermal_season.fit(Recording(recording.manifest, spoilt), "E_D", rows=rows)
    assert one.terms == two.terms and one.intervals == two.intervals


def test_outside_what_was_seen_nothing_jumps_and_the_limit_holds():
    model = thermal_season.fit(machine(6), "E_D")
    last = None
    for offset in np.linspace(0.0, 30.0, 61):
        recording = machine(1, seed=9, rows=40)
        shifted = {n: recording.array(n) + offset for n in ("T_room", "T_spindle", "T_bed")}
        hot = Recording(recording.manifest, recording.frame.assign(**shifted))
        value = model.predict(hot)
        assert value.predicted.max() <= model.limit[1] + 1e-9 and value.predicted.min() >= model.limit[0] - 1e-9
        if last is not None:
            assert np.abs(value.predicted - last.predicted).max() < 1.5
            wider = (value.upper - value.lower) / (last.upper - last.lower)
            assert (wider > 0.999).all() or offset < 3.0  # less is predicted there, which narrows it by a trace
        last = value
    assert last.outside.all()


def test_a_summer_that_was_never_seen_is_not_made_worse():
    """Fitted on cold days; 14 K hotter, the room ahead of the machine, some days with a room that hardly moves."""
    model = thermal_season.fit(machine(10), "E_D")
    for early, seed in ((0.0, 21), (3.0, 22), (-3.0, 23)):
        summer = machine(4, warm=14.0, seed=seed, room_early=early)
        left = truth(summer) - model.values(summer)
        assert rms(left) < 0.7 * rms(truth(summer))


def test_far_outside_only_a_share_is_used_and_the_interval_is_as_much_wider():
    cold = machine(8)
    model = thermal_season.fit(cold, "E_D")
    one = machine(1, seed=9, rows=40)
    output = []
    for offset in (0.0, 25.0):
        shifted = {n: one.array(n) + offset for n in ("T_room", "T_spindle", "T_bed")}
        output.append(model.predict(Recording(one.manifest, one.frame.assign(**shifted))))
    near, far = output
    assert rms(far.predicted) < 0.65 * rms(near.predicted)
    assert (far.upper - far.lower > 1.6 * (near.upper - near.lower))[5:].all()


def test_warm_oil_rubs_less():
    recording = machine(2)
    sensors = causes.sensors(recording)
    friction = drive(causes.oil_friction(sensors, 0.05), recording)
    level = recording.frame.groupby("run")[["T_spindle", "T_bed"]].transform("first").mean(axis=1).to_numpy()
    assert_allclose(friction, np.exp(-0.05 * (level - 20.0)), rtol=3e-3)
    assert causes.oil_friction(sensors, 0.0) is None


def test_a_follower_may_begin_some_of_the_way_to_the_room():
    recording = machine(1, room_early=2.0)
    machine_s, room_s, half = (
        drive(causes.room_lag("T_room", "T_bed", 7200.0, mix), recording) for mix in (0.0, 1.0, 0.5)
    )
    assert_allclose(half, 0.5 * (machine_s + room_s), atol=1e-9)
    assert half[-1] < machine_s[-1] - 0.3


def test_one_run_that_earned_something_is_not_believed():
    """The correction's share needs several runs that started as warm; in between and beyond it is small."""
    recording = both(machine(6), machine(1, warm=5.0, seed=3))
    worth = {float(k): v for k, v in thermal_season.fit(recording, "E_D").report["correction_worth"].items()}
    assert worth[max(worth)] <= 1 / 3


def test_the_terms_are_plain_drivers_that_survive_json():
    recording = machine(5)
    model = thermal_season.fit(recording, "E_D")
    component = model.component_model()
    again = sum(
        t.values()["gain"] * drive(d.Affine.model_validate({"weights": [1.0], "of": [t.term["driver"][0]]}), recording)
        for t in component.terms
    )
    assert_allclose(again, model.values(recording), atol=1e-12)


def test_signed_gains_keep_their_sign():
    rng = np.random.default_rng(0)
    x = rng.normal(size=(200, 2))
    x[:, 1] = x[:, 0] + 0.01 * x[:, 1]
    y = 3.0 * x[:, 0] + rng.normal(0, 0.5, 200)
    triangle = network.stack(network.triangles(x, y, np.zeros(200, int)), [0])
    gains = network.signed_gains(triangle, 200, [np.array([0, 1])], np.array([1.0, -1.0]), 1e-6)
    assert gains[0] >= 0.0 and gains[1] <= 0.0
    assert_allclose(gains.sum(), 3.0, atol=0.15)


def test_conformal_half_width_counts_every_group_once():
    error = np.r_[np.full(900, 1.0), np.full(10, 9.0)]
    group = np.r_[np.zeros(900), np.ones(10)]
    student = 6.313752 / 1.644854  # two groups: one degree of freedom
    assert_allclose(arithmetic.conformal_half_width(error, group, 0.9), 9.0 * student, rtol=1e-6)
    uniform = np.random.default_rng(1).uniform(size=20000)
    width = arithmetic.conformal_half_width(uniform, np.arange(20000) % 100, 0.9)
    assert_allclose(width, 0.909 * 1.0095, atol=0.01)


def test_a_half_width_that_is_not_raised_is_the_quantile_itself():
    """Runs and seasons left out are judged by fits on fewer of them: a small-sample factor on top is too wide."""
    error = np.arange(1.0, 11.0)
    assert arithmetic.conformal_half_width(error, np.arange(10), 0.9, 2, raised=False) == 9.0


@pytest.mark.realdata
@pytest.mark.slow
def test_a_season_left_out_of_a_real_turning_centre():
    folder = REAL / "turning-centre-thermal"
    if not folder.is_dir():
        pytest.skip(f"no real recordings at {folder.name}")
    manifest_folder = pytest.importorskip("errpipe.formats.manifest_folder")
    recording = manifest_folder.read(folder)
    season = recording.frame["season"].to_numpy()
    y = truth(recording)
    for left_out, bar in (("winter", 10.0), ("spring", 8.7)):
        judged = season == left_out
        model = thermal_season.fit(recording, "E_D", rows=~judged)
        assert rms((y - model.values(recording))[judged]) < min(bar, rms(y[judged]))


def test_a_day_that_fits_badly_counts_more():
    rng = np.random.default_rng(3)
    x = rng.normal(size=(400, 1))
    group = np.repeat(np.arange(4), 100)
    y = x[:, 0] * np.where(group == 3, 2.0, 1.0)
    parts = network.triangles(x, y, group)
    rows = dict.fromkeys(range(4), 100)
    gains = np.array([1.25])
    weight = network.reweighted(dict.fromkeys(range(4), 1.0), parts, rows, gains)
    assert weight[3] > 1.3 * weight[0]
    assert_allclose(sum(100 * w**2 for w in weight.values()) / 400, 1.0)
