"""Champion against challenger: the evidence is valid however often it is looked at, and drift has a name."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.holdout import Fold
from errpipe.fitting.judging import HeldOut
from errpipe.validation.cusum import cusum
from errpipe.validation.input_drift import drifting_sensors, other_unit, sensor_drift
from errpipe.validation.retraining import (
    Gate,
    RunScore,
    decide,
    e_value,
    reused_names,
    run_contents,
    run_keys,
    runs_among,
    score_new_runs,
)
from errpipe.verbs import _retrain_gates


def score(run: int, champion: float, challenger: float, nothing: float = 100.0, season: str = "winter") -> RunScore:
    return RunScore(f"{run}", f"{run}", "EXX", {"season": season}, nothing, champion, challenger, rows=50)


def test_no_run_is_no_evidence() -> None:
    assert e_value([]) == pytest.approx(1.0)
    assert e_value([0.0] * 50) == pytest.approx(1.0)


def test_looking_after_every_run_promotes_a_challenger_that_is_no_better_in_at_most_5_percent() -> None:
    rng = np.random.default_rng(11)
    ever = 0
    for _ in range(300):  # of 100 nights each
        a, b = rng.chisquare(20, 100), rng.chisquare(20, 100)
        scores = ((a - b) / (a + b)).tolist()
        ever += any(e_value(scores[:n]) >= 20.0 for n in range(1, 101))
    assert ever <= 15 + 3 * np.sqrt(15)


def test_a_challenger_that_halves_the_residual_is_promoted_within_two_weeks_of_nightly_runs() -> None:
    rng = np.random.default_rng(12)
    scores = [score(k, 4.0 * rng.chisquare(20) / 20, rng.chisquare(20) / 20) for k in range(14)]
    assert decide(scores).promote


def test_a_challenger_worse_than_uncompensated_in_one_season_is_rejected_however_good_elsewhere() -> None:
    good = [score(k, 16.0, 1.0) for k in range(40)]
    bad = [score(100 + k, 90.0, 130.0, season="summer") for k in range(2)]
    decision = decide(good + bad)
    assert decision.e_value > decision.needed and not decision.promote
    assert [g.name for g in decision.gates if not g.passed] == ["EXX, season summer"]


def test_a_season_in_which_the_champion_is_better_keeps_the_champion() -> None:
    rng = np.random.default_rng(13)
    good = [score(k, 16.0, 1.0) for k in range(40)]
    bad = [
        score(100 + k, 4.0 * rng.chisquare(20) / 20, 9.0 * rng.chisquare(20) / 20, season="summer") for k in range(8)
    ]
    assert not decide(good + bad).promote


def test_any_other_gate_keeps_the_champion() -> None:
    good = [score(k, 16.0, 1.0) for k in range(40)]
    assert decide(good).promote
    assert not decide(good, [Gate("inputs", False, "newly required: T_9")]).promote


class Mean:
    """A family whose model is the mean of the rows that fit it."""

    def validate_fold(self, recording: Recording, fold: Fold) -> dict[str, HeldOut]:
        y, rows = recording.array("EXX"), np.flatnonzero(fold.test)
        left = y[rows] - y[fold.train].mean()
        return {"EXX": HeldOut(fold.label, rows, y[rows], left, np.zeros(rows.size), 0.0)}


def test_a_run_that_arrives_twice_is_scored_once_whatever_it_is_called() -> None:
    """Copied with another label and an hour later; and a copy of a run that fitted the champion."""
    rng = np.random.default_rng(5)
    days = {f"day {k}": rng.normal(size=10) for k in range(6)}
    days |= {"day 4 again": days["day 4"], "day 9": days["day 1"]}
    parts = [
        pd.DataFrame({"run": n, "t": 3600.0 * k + np.arange(10.0), "EXX": y}) for k, (n, y) in enumerate(days.items())
    ]
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {"EXX": Column(role="error", component="EXX", unit="um")}
    recording = Recording(Manifest(recording=1, tables=("t.csv",), columns=kinds), pd.concat(parts, ignore_index=True))
    names, contents = run_keys(recording), run_contents(recording)
    known = runs_among(recording, names[:3], contents[:3])
    champion = {"EXX": np.zeros(len(recording))}
    scores = score_new_runs(recording, Mean(), champion, known, frozenset())
    assert [s.run for s in scores] == ["day 3", "day 4", "day 5"]
    assert {s.content for s in scores} == set(contents[3:6])
    earlier = runs_among(recording, (s.key for s in scores), (s.content for s in scores))
    assert score_new_runs(recording, Mean(), champion, known, earlier) == []


def test_runs_under_new_names_are_those_that_they_were() -> None:
    """A log exported anew, in another time zone: what fitted the champion fits the challenger that is judged."""
    rng = np.random.default_rng(6)
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {"EXX": Column(role="error", component="EXX", unit="um")}
    manifest = Manifest(recording=1, tables=("t.csv",), columns=kinds)
    frame = pd.DataFrame({"run": np.repeat(list("abcd"), 10), "t": np.arange(40.0), "EXX": 5.0 + rng.normal(size=40)})
    before = Recording(manifest, frame.head(30))
    after = Recording(manifest, frame.assign(run="day " + frame["run"], t=frame["t"] - 3600.0))
    known = runs_among(after, run_keys(before), run_contents(before))
    (only,) = score_new_runs(after, Mean(), {"EXX": np.zeros(40)}, known, frozenset())
    assert only.run == "day d" and only.challenger < 3.0


def test_new_readings_under_an_old_name_are_seen() -> None:
    """Run 1 to 3 of every test, and no time: a later test is not new by its names, and its readings say that it is."""
    kinds = {"run": Column(role="run"), "EXX": Column(role="error", component="EXX", unit="um")}
    manifest = Manifest(recording=1, tables=("t.csv",), columns=kinds)
    frame = pd.DataFrame({"run": np.repeat(list("123"), 4), "EXX": np.arange(12.0)})
    old, later = Recording(manifest, frame), Recording(manifest, frame.assign(EXX=[*range(4), *range(50, 58)]))
    assert reused_names(old, later) == ["2", "3"]
    assert reused_names(old, old) == []
    (gate,) = _retrain_gates.any_new_run(["2", "3"], any_new=False)
    assert not gate.passed and gate.says.startswith("2, 3: called as runs that fitted the champion")
    assert _retrain_gates.any_new_run([], any_new=False) == []


def sensors(drifting: int | None, per_day: float, seed: int = 3) -> tuple[Recording, np.ndarray]:
    """Forty daily runs of four temperatures that move alike; from run 20 on, one of them drifts, K/day."""
    rng = np.random.default_rng(seed)
    day = np.repeat(np.arange(40), 24)
    hour = np.tile(np.arange(24.0), 40)
    room = 20 + 3 * np.sin(day / 6.0) + 2 * np.sin(hour / 24 * 2 * np.pi)
    heat = 6 * (hour > 8) * (day % 3 > 0)
    columns = [room, room + 0.6 * heat, room + 0.3 * heat, 0.8 * room + 0.5 * heat + 4]
    columns = [c + rng.normal(0, 0.1, c.size) + rng.normal(0, 0.05, 40)[day] for c in columns]
    if drifting is not None:
        columns[drifting] = columns[drifting] + per_day * np.maximum(day - 20, 0)
    names = [f"T_{k}" for k in range(4)]
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {n: Column(role="temperature", unit="degC") for n in names}
    frame = pd.DataFrame({"run": [f"day {d}" for d in day], "t": (24 * day + hour) * 3600.0})
    frame = frame.assign(**dict(zip(names, columns, strict=True)))
    return Recording(Manifest(recording=1, tables=("x.csv",), columns=kinds), frame), day < 20


@pytest.mark.parametrize("drifting", range(4))
def test_the_sensor_that_drifts_is_isolated_and_the_day_is_right(drifting: int) -> None:
    recording, reference = sensors(drifting, 0.3)
    first = sensor_drift(recording, reference)[0]
    assert first.isolated and first.column == f"T_{drifting}"
    assert 20 <= int(first.since.split()[1]) <= 24 and first.size > 0


def three_sensors(seed: int, drift_from: int, nights: int) -> tuple[Recording, np.ndarray]:
    """Nights of a spindle: front and rear bearing, air; the front's sensor drifts by 1 K a night."""
    rng = np.random.default_rng(seed)
    night = np.repeat(np.arange(nights), 12)
    air = 20 + 5 * np.sin(night / 58.0) + rng.normal(0, 0.7, nights)[night]
    heat = rng.uniform(4, 12, nights)[night] * np.tile(1 - np.exp(-np.arange(12) / 5.0), nights)
    rear = air + 0.6 * heat * rng.uniform(0.8, 1.2, nights)[night]
    shown = {"front": air + heat + np.maximum(night - drift_from, 0), "rear": rear, "air": air}
    kinds = {"run": Column(role="run")} | {n: Column(role="temperature", unit="degC") for n in shown}
    frame = pd.DataFrame({n: v + rng.normal(0, 0.05, v.size) for n, v in shown.items()})
    frame = frame.assign(run=[f"night {k:03}" for k in night])
    return Recording(Manifest(recording=1, tables=("x.csv",), columns=kinds), frame), night <= drift_from


def test_a_healthy_sensor_is_not_called_faulty_because_the_others_know_too_little_of_it() -> None:
    """Of three sensors the rear one was named on the first nights: without it the two others are silent, too."""
    flagged, named = [], []
    for seed in range(4):
        recording, reference = three_sensors(seed, 40, 56)
        nights = recording.run_codes()
        for last in (43, 44, 46, 55):
            rows = nights <= last
            drift = sensor_drift(recording.take(rows), reference[rows])
            flagged.append({d.column for d in drift if d.flagged})
            named.append([d.column for d in drift if d.isolated])
    assert all("front" in names for names in flagged if names) and sum(map(bool, flagged)) >= 12
    assert all(names in ([], ["front"]) for names in named) and named[3::4].count(["front"]) >= 3


def test_who_may_drift_is_reported_with_the_likeliest_first() -> None:
    assert drifting_sensors(["nut"]) == "nut drifts"
    assert drifting_sensors(["nut", "bed", "air"]).startswith("nut, bed or air drifts (the likeliest first")


@pytest.mark.parametrize(
    ("scale", "offset", "output"),
    [
        (1.8, 32.0, "degF instead of degC"),
        (1.0, 273.15, "K instead of degC"),
        (1 / 1.8, -32.0 / 1.8, "degC instead of degF"),
        (1.0, -273.15, "degC instead of K"),
        (1.0, 18.0, None),  # from winter to summer
        (1.0, 110.0, None),  # no scale
    ],
)
def test_another_scale_of_all_temperatures_is_named_with_its_first_run(
    scale: float, offset: float, output: str | None
) -> None:
    recording, reference = sensors(None, 0.0)
    late, names = recording.run_codes() >= 30, recording.names("temperature")
    if output in ("degC instead of degF", "degC instead of K"):
        unturned = {n: (recording.array(n) - offset) / scale for n in names}
        recording = recording.with_columns(unturned, {})
    turned = {n: np.where(late, scale * recording.array(n) + offset, recording.array(n)) for n in names}
    assert other_unit(recording.with_columns(turned, {}), reference) == (None if output is None else (output, "day 30"))
    one = recording.with_columns({names[0]: turned[names[0]]}, {})
    assert other_unit(one, reference) is None


def test_sensors_that_do_not_drift_raise_no_alarm() -> None:
    quiet = [sensor_drift(*sensors(None, 0.0, seed)) for seed in range(20)]
    assert sum(bool(entry) for entry in quiet) <= 1


@pytest.mark.parametrize("culprit", ["sensor", "machine"])
def test_a_response_that_moved_names_the_sensor_within_three_runs_only_where_the_sensor_moved_too(culprit: str) -> None:
    """0.25 K a day, which temperatures alone (0.06 K between runs) do not name so early."""
    named = []
    for seed in range(10):
        recording, reference = sensors(2 if culprit == "sensor" else None, 0.25, seed)
        early = recording.run_codes() < 24
        apparent = np.random.default_rng(seed).normal(0, 0.03, 24) + 0.25 * np.maximum(np.arange(24) - 20, 0)
        drift = sensor_drift(recording.take(early), reference[early], {"T_2": apparent})
        named += [d.column for d in drift if d.isolated]
    assert (named.count("T_2") >= 9) if culprit == "sensor" else (len(named) <= 1), named


def moved(column: str, by: float) -> tuple[Recording, np.ndarray]:
    """Forty days without drift, but that a temperature is another one from day 20 on."""
    recording, reference = sensors(None, 0.0)
    return recording.with_columns({column: recording.array(column) + np.where(reference, 0.0, by)}, {}), reference


def test_a_sensor_that_the_response_follows_reads_right() -> None:
    """New coolant: the bed is colder beside the same nut, and the deviation is what the model predicts by it."""
    recording, reference = moved("T_2", -1.0)
    (alone,) = (d for d in sensor_drift(recording, reference) if d.column == "T_2")
    followed, wrong = (
        np.random.default_rng(1).normal(0, 0.03, 40) + off for off in (0.0, -1.0 * (np.arange(40) >= 20))
    )
    (right,) = (d for d in sensor_drift(recording, reference, {"T_2": followed}) if d.column == "T_2")
    (faulty,) = (d for d in sensor_drift(recording, reference, {"T_2": wrong}) if d.column == "T_2")
    assert alone.flagged and not alone.healthy
    assert right.healthy and not right.flagged and not right.isolated
    assert faulty.isolated and not faulty.healthy


def test_a_response_that_shows_a_quarter_of_it_does_not_blame_the_sensor() -> None:
    """The model extrapolates to temperatures that it never saw together, and errs."""
    recording, reference = moved("T_2", -2.0)
    apparent = np.random.default_rng(1).normal(0, 0.2, 40) - 0.5 * (np.arange(40) >= 20)
    (drift,) = (d for d in sensor_drift(recording, reference, {"T_2": apparent}) if d.column == "T_2")
    assert drift.healthy and not drift.flagged


def test_of_two_sensors_that_disagree_none_is_flagged_and_a_response_confirms_them() -> None:
    recording, reference = moved("T_2", -2.0)
    kinds = {n: c for n, c in recording.manifest.columns.items() if n not in ("T_0", "T_3")}
    manifest = recording.manifest.model_copy(update={"columns": kinds})
    two = Recording(manifest, recording.frame[list(kinds)])
    drift = sensor_drift(two, reference)
    assert drift and not any(d.flagged or d.healthy for d in drift)
    followed = {n: np.random.default_rng(1).normal(0, 0.03, 40) for n in ("T_1", "T_2")}
    assert all(d.healthy for d in sensor_drift(two, reference, followed))


def test_cusum_finds_the_begin_of_a_shift_and_ignores_noise() -> None:
    rng = np.random.default_rng(1)
    noise = rng.normal(size=200)
    assert cusum(noise)[0] < 8.0
    statistic, begin = cusum(np.r_[noise[:100], noise[100:] - 2.0])
    assert statistic > 50 and abs(begin - 100) <= 5
