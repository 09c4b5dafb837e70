"""Thermal families where rows lie outside of what fitted: another block of a warm-up, another speed, another season."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.error_model import Validity
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.statistics import rms
from errpipe.models._thermal import _model as model_of
from errpipe.models._thermal import linear as gains_of
from errpipe.models.auto import Auto
from errpipe.models.lagged import Lagged
from errpipe.models.rises import Rises
from errpipe.thermal import competition, linear
from errpipe.thermal.arithmetic import limits, ridge_gains, since_start
from errpipe.thermal.interval import GAIN_SPREAD, GROWTH, growth_of_one_day, independent_runs
from tests.validation_document import held_out

STEP = 120.0  # s


def recording(frame: pd.DataFrame, more: dict[str, Column] | None = None) -> Recording:
    kinds = {"run": Column(role="run"), "t": Column(role="time", unit="s")}
    kinds |= {n: Column(role="temperature", unit="degC") for n in frame if n.startswith("T_")} | (more or {})
    kinds["E_Z"] = Column(role="error", component="E_Z", unit="um")
    return Recording(Manifest(recording=1, tables=("a.csv",), columns=kinds), frame)


def lag(u: np.ndarray, tau: float) -> np.ndarray:
    out = np.zeros(u.size)
    for k in range(1, u.size):
        out[k] = u[k - 1] + (out[k - 1] - u[k - 1]) * np.exp(-STEP / tau)
    return out


def test_the_first_block_of_a_warm_up_is_predicted_from_the_rest() -> None:
    """No fitted row is near the start's zero; a limit on what may be predicted must not keep it away from there."""
    rng = np.random.default_rng(1)
    t = STEP * np.arange(500)
    warm = 20 * (1 - np.exp(-t / 9000))
    frame = {
        "run": "a",
        "t": t,
        "T_1": 20 + warm + rng.normal(0, 0.02, t.size),
        "E_Z": warm + rng.normal(0, 0.1, t.size),
    }
    whole, rows = recording(pd.DataFrame(frame)), np.arange(t.size) >= 100
    left = whole.array("E_Z") - Rises(component="E_Z").train(whole, rows).values(whole)
    assert rms(whole.array("E_Z")[~rows]) > 7.0 and rms(left[~rows]) < 0.5
    low, high = limits(np.array([10.0, 12.0]))
    assert low < 0.0 and high > 12.0


def spindle_days(seed: int, speeds: tuple[float, ...]) -> Recording:
    """A shaft warms with the square of its speed; the only sensor is in the room."""
    rng, frames = np.random.default_rng(seed), []
    for k in range(6):
        speed = np.repeat(rng.choice(speeds, 8), 30)
        room = 20 + np.cumsum(rng.normal(0, 0.05, speed.size))
        growth = 40 * lag((speed / 8000) ** 2, 1800.0) - 2 * (room - room[0])
        frame = {"run": str(k), "t": STEP * np.arange(speed.size), "T_room": room, "S": speed}
        frames.append(pd.DataFrame(frame | {"E_Z": growth + rng.normal(0, 0.2, speed.size)}))
    return recording(pd.concat(frames, ignore_index=True), {"S": Column(role="spindle_speed", unit="rpm")})


def test_a_part_without_a_sensor_is_predicted_from_the_speed() -> None:
    fitted, judged = spindle_days(2, (0, 2000, 4000, 8000)), spindle_days(3, (0, -4000, 6000))
    model = Lagged(component="E_Z").train(fitted)
    y = since_start(judged.array("E_Z"), judged.run_codes(), 3)[0]
    left = y - since_start(model.values(judged), judged.run_codes(), 3)[0]
    assert rms(y) > 4.0 and rms(left) < 0.6


def test_the_interval_widens_where_runs_disagree_and_not_where_they_agree() -> None:
    """Two sensors that run apart in no fitted run by more than a little: the difference has an unknown gain."""
    rng, frames = np.random.default_rng(4), []
    for k in range(8):
        warm = 10 * (1 - np.exp(-STEP * np.arange(120) / rng.uniform(2000, 8000)))
        apart = 0.2 * np.cumsum(rng.normal(0, 0.1, 120))
        gain = 3.0 + rng.normal(0, 2.0)  # of the difference: each day its own
        frame = {"run": str(k), "t": STEP * np.arange(120), "T_1": 20 + warm, "T_2": 20 + warm + apart}
        frames.append(pd.DataFrame(frame | {"E_Z": 2 * warm + gain * apart + rng.normal(0, 0.2, 120)}))
    fitted = recording(pd.concat(frames, ignore_index=True))
    model = Auto(component="E_Z", among=("rises",)).train(fitted)
    warm = np.linspace(0, 20, 120)
    further = {"run": "x", "t": STEP * np.arange(120), "T_1": 20 + warm, "T_2": 20 + warm, "E_Z": 0.0}
    apart = further | {"T_2": 20 + 0.5 * warm}

    def half(frame: dict) -> float:
        output = model.predict(recording(pd.DataFrame(frame)))
        return float((output.upper - output.lower)[-1] / 2 / (1 + abs(output.predicted[-1]) / 50))

    assert half(apart) > 4 * half(further)


@pytest.mark.parametrize("second", [0, 1])
def test_the_interval_widens_where_families_disagree(second: int) -> None:
    """Two sensors move alike in every run, so fits without a run agree; each family reads another one of them.

    Where both read the same one nothing widens: a spread of nothing had weights beyond what a driver takes.
    """
    rng, frames = np.random.default_rng(5), []
    for k in range(8):
        warm = 10 * (1 - np.exp(-STEP * np.arange(120) / rng.uniform(2000, 8000)))
        frame = {"run": str(k), "t": STEP * np.arange(120), "T_1": 20 + warm, "T_2": 20 + warm}
        noisy = {name: frame[name] + rng.normal(0, 0.02, 120) for name in ("T_1", "T_2")}
        frames.append(pd.DataFrame(frame | noisy | {"E_Z": 2 * warm + rng.normal(0, 0.2, 120)}))
    family, problem = Rises(component="E_Z"), linear.problem(recording(pd.concat(frames)), "E_Z", None, 3)

    def reading(name: str, sensor: int, times: float = 1.0) -> competition.Entrant:
        def gains(groups: tuple[int, ...]) -> np.ndarray:
            design, response, _ = problem.stacked(groups, 2)
            return times * np.eye(2)[sensor] * (design[:, sensor] @ response) / np.sum(design[:, sensor] ** 2)

        return gains_of(name, name, problem, gains)

    ways = competition.groupings(problem.recording, problem.group, problem.groups, "season")
    entrants = [reading("one", 0), reading("other", second, 1.0 + 1e-9)]
    outcome = competition.compete(entrants, ways, problem.response, problem.rows, problem.group)
    model = model_of(family, problem, outcome)

    def half(t_2: np.ndarray) -> float:
        further = {"run": "x", "t": STEP * np.arange(120), "T_1": 20 + np.linspace(0, 20, 120), "T_2": t_2, "E_Z": 0.0}
        output = model.predict(recording(pd.DataFrame(further)))
        return float((output.upper - output.lower)[-1] / 2)

    apart = half(20 + np.linspace(0, 10, 120)) / half(20 + np.linspace(0, 20, 120))
    assert apart > 4 if second else abs(apart - 1.0) < 0.01


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_the_interval_has_the_scale_of_the_machine(size: float) -> None:
    """A machine of deviations a hundred times as large has intervals a hundred times as wide, and no wider."""
    rng = np.random.default_rng(6)
    frames = []
    for k in range(6):
        warm = 10.0 * (1.0 - np.exp(-STEP * np.arange(100) / 5400.0)) * rng.uniform(0.5, 1.0)
        frame = {"run": f"r{k}", "t": 86400.0 * k + STEP * np.arange(100), "T_a": 20.0 + warm}
        frames.append(pd.DataFrame(frame | {"E_Z": 4.0 * warm + rng.normal(0.0, 0.5, warm.size)}))
    days = pd.concat(frames, ignore_index=True)
    family = Rises(component="E_Z")
    one, many = (family.train(recording(f)).predict(recording(f)) for f in (days, days.assign(E_Z=size * days["E_Z"])))
    assert np.allclose(many.upper - many.lower, size * (one.upper - one.lower), rtol=1e-6)


def test_duty_cycles_that_do_not_predict_the_others_exclude_no_family() -> None:
    """All entrants are worse than nothing with a duty cycle left out, and good in every other way."""
    group = np.repeat(np.arange(8), 50)
    truth = np.tile(np.linspace(0, 20, 50), 8)

    def predict(groups):
        return truth if set(groups) & {0, 1} and set(groups) & {4, 5} else -truth

    rival = competition.Entrant("rival", "rival", predict, lambda groups: ())
    runs = competition.Grouping("run", tuple((g,) for g in range(8)))

    def weights(decides: bool) -> float:
        cycles = competition.Grouping("duty", ((0, 1, 2, 3), (4, 5, 6, 7)), ("A", "B"), decides)
        outcome = competition.compete([rival], (runs, cycles), truth, np.ones(400, bool), group)
        return sum(w for _, w in outcome.weights)

    assert weights(False) > 0.99 and weights(True) == 0.0


def test_of_one_run_what_is_right_ahead_is_taken_and_not_what_is_right_between() -> None:
    """One entrant is exact beside blocks that fitted it and wrong further off, the other nearly right everywhere."""
    group = np.repeat(np.arange(5), 100)
    truth = np.tile(np.linspace(0, 20, 100), 5)

    def between(groups):
        return np.where(np.isin(group, [g + k for g in groups for k in (-1, 0, 1)]), truth, -truth)

    entrants = [
        competition.Entrant("between", "between", between, lambda g: ()),
        competition.Entrant("ahead", "ahead", lambda g: 0.95 * truth, lambda g: ()),
    ]
    blocks = (competition.Grouping("run", tuple((g,) for g in range(5))),)

    def most(ahead: bool) -> str:
        outcome = competition.compete(entrants, blocks, truth, np.ones(500, bool), group, ahead)
        return max(outcome.weights, key=lambda pair: pair[1])[0].name

    assert most(False) == "between" and most(True) == "ahead"


def one_warm_up(seed: int, sensors: int) -> Recording:
    """Sensors that all show the growth, each wandering a little, on a warm-up that cools later."""
    rng = np.random.default_rng(seed)
    t = STEP * np.arange(600)
    warm = 20 * np.where(t < t[400], 1 - np.exp(-t / 9000), np.exp(-np.maximum(t - t[400], 0) / 9000))
    wander = np.cumsum(rng.normal(0, 0.03, (t.size, sensors)), axis=0)
    shown = np.outer(warm, rng.uniform(0.5, 1.5, sensors)) + wander
    frame = {f"T_{k}": 20 + shown[:, k] for k in range(sensors)}
    return recording(pd.DataFrame({"run": "a", "t": t} | frame | {"E_Z": warm + rng.normal(0, 0.05, t.size)}))


@pytest.mark.parametrize("sensors", [6, 12])
def test_of_one_run_sensors_that_move_alike_predict_the_other_half(sensors: int) -> None:
    """Of many sensors their mean, for so few blocks cannot tell their gains apart."""
    for seed in range(2):
        whole = one_warm_up(seed, sensors)
        rows = np.arange(len(whole)) < 300
        y = since_start(whole.array("E_Z"), whole.run_codes(), 3)[0]
        model = Rises(component="E_Z").train(whole, rows)
        assert rms((y - model.values(whole))[~rows]) < 0.05 * rms(y[~rows])
        assert sensors == 6 or {name for name, *_ in model.parts} == {"rises, mean of sensors"}


def test_what_was_proved_on_warming_is_predicted_of_cooling() -> None:
    """A frame that only shrank while it was fitted, and then grows as far."""
    rng = np.random.default_rng(3)
    t = STEP * np.arange(400)
    room = 20 - 10 * np.sin(2 * np.pi * t / t[-1])
    frame = {"run": "a", "t": t, "T_1": room, "E_Z": 10 * (room - 20) + rng.normal(0, 0.5, t.size)}
    whole, rows = recording(pd.DataFrame(frame)), np.arange(t.size) < 200
    left = whole.array("E_Z") - Rises(component="E_Z").train(whole, rows).values(whole)
    assert rms(left[~rows]) < 2.0


def test_the_error_of_a_runs_zero_moves_the_gain_less_than_it_would_in_plain_least_squares(monkeypatch) -> None:
    """Eight runs that are exact but for their first reading, from which all others count; 20 draws."""
    errors: dict[float, list[float]] = {}
    for share in (0.0, linear.ZERO_SHARE):
        monkeypatch.setattr(linear, "ZERO_SHARE", share)
        errors[share] = []
        for seed in range(20):
            rng, frames = np.random.default_rng(seed), []
            for k in range(8):
                warm = rng.uniform(2, 10) * (1 - np.exp(-STEP * np.arange(60) / rng.uniform(1000, 6000)))
                y = 2 * warm + rng.normal(0, 1.0) * (np.arange(60) == 0)
                frames.append(pd.DataFrame({"run": str(k), "t": STEP * np.arange(60), "T_1": 20 + warm, "E_Z": y}))
            problem = linear.problem(recording(pd.concat(frames, ignore_index=True)), "E_Z", None, 1)
            gain = ridge_gains(*problem.stacked(problem.groups, 1), 0.0)
            errors[share].append(float(gain[0]) - 2.0)
    plain, shared = (rms(np.array(e)) for e in errors.values())
    assert plain > 0.02 and shared < 0.8 * plain


def test_a_log_of_days_in_one_run_counts_as_its_days() -> None:
    """Two sensors that move alike, six and three days long: as sure of itself as days that are runs of their own."""
    rng, frames = np.random.default_rng(11), []
    for run, days in (("a", 6), ("b", 3)):
        t = 600.0 * np.arange(days * 144)
        warm = 5 * np.repeat(rng.uniform(0, 1, days), 144) * np.sin(np.pi * (t % 86400) / 86400)
        frame = {"run": run, "t": t, "T_1": 20 + warm, "T_2": 20 + warm + rng.normal(0, 0.1, t.size)}
        frames.append(pd.DataFrame(frame | {"E_Z": 3 * warm + rng.normal(0, 0.5, t.size)}))
    log = recording(pd.concat(frames, ignore_index=True))
    everything = np.ones(len(log), dtype=bool)
    assert independent_runs(log, everything) == 5 + 2  # whole days between the first and the last reading
    problem = linear.problem(log, "E_Z", None, 3)
    assert not problem.within_one_day and problem.own == len(log) < len(problem.recording)
    assert problem.run_count == 5 + 2
    output = Auto(component="E_Z", among=("rises",)).train(log).predict(log)
    left = since_start(log.array("E_Z"), log.run_codes(), 3)[0] - output.predicted
    assert np.mean(0.5 * (output.upper - output.lower)) < 1.7 * np.quantile(np.abs(left), 0.9)


def hall_log(seed: int, days: int, started: float) -> tuple[Recording, np.ndarray]:
    """A gantry in a hall, logged every 10 min in one run; a bed that no sensor sees follows the hall by 10 h.

    started: K by which the bed was warmer than the hall at the first reading. Returns the deviation without noise, too.
    """
    rng, step = np.random.default_rng(seed), 600.0
    t = step * np.arange(days * 144)
    slow = np.zeros(t.size)
    for k in range(1, t.size):
        slow[k] = slow[k - 1] * np.exp(-step / 20000.0) + rng.normal(0, 0.3)
    hall = 18 + 2 * np.sin(2 * np.pi * t / 86400.0) + slow
    frame, bed, column = {"run": "a", "t": t, "T_hall": hall}, np.empty(t.size), np.empty(t.size)
    bed[0] = column[0] = hall[0] + started
    for k in range(1, t.size):
        bed[k] = hall[k] + (bed[k - 1] - hall[k]) * np.exp(-step / 36000.0)
        column[k] = hall[k] + (column[k - 1] - hall[k]) * np.exp(-step / 9000.0)
    truth = 8 * (bed - bed[0]) - 3 * (column - column[0])
    frame |= {"T_column": column + rng.normal(0, 0.05, t.size), "T_bed": bed + rng.normal(0, 0.05, t.size)}
    return recording(pd.DataFrame(frame | {"E_Z": truth + rng.normal(0, 0.5, t.size)})), truth


def test_a_log_of_days_in_one_run_teaches_what_follows_another_start() -> None:
    """Its only start tells nothing of slow lags behind the next one: it is read again from every block on."""
    log, _ = hall_log(3, 8, 0.0)
    model = Auto(component="E_Z", among=("lagged", "rises")).train(log)
    for seed in (4, 5):
        later, truth = hall_log(seed, 6, 6.0)
        assert rms(truth - model.values(later)) < 0.3 * rms(truth)  # 1.3 from one start
    assert model.report["rows"] == len(log)


def test_a_speed_alone_is_enough() -> None:
    """Without a temperature the heat of the spindle, through lags, is fitted; a table needs its speed."""
    days = spindle_days(1, (0.0, 4000.0, 8000.0))
    columns = {n: c for n, c in days.manifest.columns.items() if c.role != "temperature"}
    manifest = days.manifest.model_copy(update={"columns": columns})
    bare = Recording(manifest, days.frame[list(columns)])
    run = bare.run_codes()
    model = Auto(component="E_Z").train(bare, run < 4)
    since = since_start(bare.array("E_Z"), run, 3)[0][run >= 4]
    assert rms(since - model.values(bare)[run >= 4]) < 0.5 * rms(since)
    assert set(model.validity.ranges) == {bare.name("spindle_speed")}


def days(count: int, seed: int, gains: tuple[float, ...] = (2.0,)) -> pd.DataFrame:
    """Days of machines that take turns, each with a gain of its own, um/K, on what its first sensor shows."""
    rng, parts = np.random.default_rng(seed), []
    for k in range(count):
        t = STEP * np.arange(120)
        warm = rng.uniform(5, 15) * (1 - np.exp(-t / rng.uniform(3000, 9000)))
        room = 20 + np.cumsum(rng.normal(0, 0.05, t.size))
        growth = gains[k % len(gains)] * warm + rng.normal(0, 0.2, t.size)
        machine = str(k % len(gains))
        parts.append(pd.DataFrame({"run": f"day {k}", "machine": machine, "t": t + 86400.0 * k, "T_1": room + warm}))
        parts[-1] = parts[-1].assign(T_2=room + rng.normal(0, 0.05, t.size), E_Z=growth)
    return pd.concat(parts, ignore_index=True)


def test_a_sensor_that_died_is_left_out_and_days_behind_it_judge() -> None:
    frame = days(6, 1)
    died = recording(frame.assign(T_2=frame["T_2"].where(np.arange(len(frame)) < 300)).drop(columns="machine"))
    family = Rises(component="E_Z")
    fitted = family.fit(died)
    assert "without T_2" in fitted.summary["E_Z"] and list(fitted.model.validity.ranges) == ["T_1"]
    (figures,) = held_out(died, family)["components"]
    assert len(figures["groups"]) == 6 and figures["rms_after"] < 0.1 * figures["rms_before"]


def test_a_day_without_a_sensor_that_lives_judges_nothing() -> None:
    frame = days(6, 2)
    gone = recording(frame.assign(T_2=frame["T_2"].where(frame["run"] != "day 2")).drop(columns="machine"))
    (figures,) = held_out(gone, Rises(component="E_Z"))["components"]
    assert [g["label"] for g in figures["groups"]] == [f"day {k}" for k in (0, 1, 3, 4, 5)]


def test_rows_behind_a_sensor_that_fell_silent_in_a_day_judge_nothing(monkeypatch) -> None:
    """Whatever the model makes of them: a lag goes on from what it was."""
    frame = days(6, 4)
    seen = (frame["run"] != "day 2") | (frame.groupby("run").cumcount() < 40)
    gone = recording(frame.assign(T_1=frame["T_1"].where(seen)).drop(columns="machine"))
    family, output = Lagged(component="E_Z"), SimpleNamespace(values=lambda r: np.zeros(len(r)), validity=Validity())
    monkeypatch.setattr(Lagged, "train", lambda self, recording, rows: output)
    (figures,) = held_out(gone, family)["components"]
    rows = {g["label"]: g["rows"] for g in figures["groups"]}
    assert rows == {f"day {k}": 120 for k in range(6)} | {"day 2": 43}  # three readings are held


def test_machines_that_differ_are_reported_to_need_a_recording_each() -> None:
    unlike, alike = (days(8, 3, gains) for gains in ((1.0, 6.0), (2.0, 2.0)))
    family, machines = Rises(component="E_Z"), {"machine": Column(role="group", of="machine")}
    assert "recording each" in family.fit(recording(unlike, machines)).summary["E_Z"]
    assert "recording each" not in family.fit(recording(alike, machines)).summary["E_Z"]


def test_one_day_alone_presumes_that_the_gain_changes_from_day_to_day() -> None:
    """Before: 57 % of the rows of later days inside the interval where the gain changes by a tenth; now 70 %."""
    assert growth_of_one_day(0.5, 0.9) == pytest.approx(1.645 * GAIN_SPREAD / 0.5, rel=1e-3)
    assert growth_of_one_day(50.0, 0.9) == growth_of_one_day(0.0, 0.9) == GROWTH

    def day(run: str, begins: float) -> pd.DataFrame:
        t = STEP * np.arange(240)
        warm = 10.0 * (1.0 - np.exp(-t / 5400.0)) + np.sin(t / 2000.0)
        noise = np.random.default_rng(0).normal(0.0, 0.2, t.size)
        return pd.DataFrame({"run": run, "t": t + begins, "T_a": 20.0 + warm, "E_Z": 4.0 * warm + noise})

    days = pd.concat([day(f"r{k}", 86400.0 * k) for k in range(4)], ignore_index=True)
    growth = [Auto(component="E_Z").train(recording(d)).component_model().growth90 for d in (day("r0", 0.0), days)]
    assert growth[0] > 2.0 * GROWTH and growth[1] == 0.0  # days left out show how their errors are spread
