"""Effects that act for a while or on a stretch, sensors that the simulation does not read, forms real parts have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from errpipe.diagnosis import holdout, judge, model, partial, prepare, report, unnamed
from errpipe.diagnosis.hypotheses import columns_of
from errpipe.diagnosis.partial import may_act_in_some_groups, partitions
from errpipe.terms import NEVER

from .machines import recording

RUN_AND_TIME = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}


def judged(columns, kinds, component, error, simulated, unit="um"):
    kinds = RUN_AND_TIME | kinds
    kinds |= {"y_read": {"role": "error", "component": component, "unit": unit}}
    kinds |= {"y_sim": {"role": "simulated", "component": component, "unit": unit}}
    raw = recording(columns | {"y_read": np.round(error, 4), "y_sim": np.round(simulated, 4)}, kinds)
    (pair,), _ = prepare.pairs(raw)
    return judge.diagnose(raw, prepare.followed(raw, prepare.condition(raw), pair), pair)


def names(case):
    return [f.hypothesis.effect for f in case.explanation.accepted]


def positioning(seed: int = 0, runs: int = 7):
    rng = np.random.default_rng(seed)
    places = np.r_[np.linspace(10, 490, 13), np.linspace(490, 10, 13)]
    x, run = np.tile(places, 2 * runs), np.repeat(np.arange(runs), 52)
    t = np.arange(x.size) * 8.0 + run * 1500.0
    nut = 20 + np.array([0.0, 1.5, 3.5, 3.2, 5.0, 6.1, 7.4])[run] + 0.5 * np.sin(t / 900)
    columns = {"run": run.astype(str), "t": t, "x": x, "dir": np.tile(np.repeat([1.0, -1.0], 13), 2 * runs), "T": nut}
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}, "dir": {"role": "direction", "axis": "X"}}
    kinds |= {"T": {"role": "temperature", "unit": "degC", "location": "nut"}}
    return columns, kinds, rng.standard_normal(x.size)


def test_an_effect_acts_for_a_while_that_no_run_begins_or_ends():
    columns, kinds, noise = positioning()
    simulated, t = 20e-3 * columns["x"], columns["t"]
    inside = (t > np.quantile(t, 0.36)) & (t < np.quantile(t, 0.79))
    case = judged(columns, kinds, "EXX", simulated - 3.0 * columns["dir"] * inside + 0.5 * noise, simulated)
    kept = {g.kind: g for g in partitions(case.recording, case.pair.rows)}
    assert set(kept) == {"runs", "x", "t"}
    assert np.ptp(np.bincount(kept["t"].code)) < 0.1 * t.size / 14  # as many rows in each


def test_a_few_rows_at_an_end_are_events_and_no_part():
    """Neither those rows alone nor the others without them."""
    x = np.linspace(0.0, 1.0, 1400)
    along = partial.Groups.along("x", x, np.linspace(0.0, 1.0, 15), True, 14)
    widths = {len(union) for union in along.choices()}
    assert (min(widths), max(widths)) == (3, 11)  # of 14: at least 16 % of the rows inside, and outside


@pytest.mark.parametrize(("departing", "in_part"), [(partial.DEPARTING, True), (50.0, False)])
def test_of_two_runs_one_may_lack_an_effect(monkeypatch, departing, in_part):
    """If the part is likelier than an effect on all rows that may depart from its textbook form."""
    columns, kinds, noise = positioning(runs=2)
    simulated, second = 20e-3 * columns["x"], columns["run"] == "1"
    monkeypatch.setattr(partial, "DEPARTING", departing)
    case = judged(columns, kinds, "EXX", simulated - 3.0 * columns["dir"] * second + 0.5 * noise, simulated)
    found = {(a.hypothesis.effect, a.hypothesis.mask) for a in case.explanation.accepted}
    assert (("backlash", ("runs", ("1",))) in found) == in_part


def test_indistinguishable_partial_names_share_the_confidence_of_their_class(monkeypatch):
    columns, kinds, noise = positioning()
    simulated, t = 20e-3 * columns["x"], columns["t"]
    inside = (t > np.quantile(t, 0.36)) & (t < np.quantile(t, 0.79))
    case = judged(columns, kinds, "EXX", simulated + 1.5 * (columns["T"] - 20) * inside + 0.5 * noise, simulated)
    known = [report.indicators_of(case, 0, holdout.held_out(case))]
    limits = {"never": 0.0, "always": 50.0}
    made = model.fit_finding(case, 0)
    said = {}
    for what, limit in limits.items():
        monkeypatch.setattr(report, "TIED", limit)
        said[what] = report.finding(case, 0, made, known)
    alone, shared = said["never"], said["always"]
    assert alone.where and 0 <= alone.rivals[0].lost_by < alone.rivals[0].CLOSE
    share = 1 + sum(np.exp(-r.lost_by) for r in alone.rivals if r.lost_by >= 0)
    assert abs(shared.confidence - min(alone.confidence, alone.confidence_of_class / share)) < 0.01
    assert shared.confidence < alone.confidence - 0.02


def test_a_body_that_warms_may_act_on_a_stretch_but_what_goes_with_time_not():
    columns, kinds, noise = positioning()
    library = judged(columns, kinds, "EXX", 0.5 * noise, 20e-3 * columns["x"]).library
    warm = next(h for h in library.hypotheses if h.effect == "thermal_drift")
    assert may_act_in_some_groups(warm, "x", "t")
    assert not may_act_in_some_groups(next(h for h in library.hypotheses if h.effect == "sensor_drift"), "x", "t")


def test_no_sensor_misleads_a_simulation_that_reads_none():
    columns, kinds, noise = positioning()
    columns["T"][200:280] += 4.0
    of_place = 20e-3 * columns["x"] - 2.0 * columns["dir"]
    of_sensor = 12e-3 * columns["x"] * (columns["T"] - 20)
    for simulated, excluded in ((of_place, True), (of_place + of_sensor, False)):
        case = judged(columns, kinds, "EXX", simulated + 0.5 * noise, simulated)
        odds = [p for p, h in zip(case.prior, case.library.hypotheses, strict=False) if h.effect == "sensor_fault"]
        assert odds and (max(odds) < 0.5 * NEVER) == excluded


def test_a_part_must_exceed_a_failure_that_the_readings_show():
    columns, kinds, noise = positioning()
    simulated = 20e-3 * columns["x"] + 12e-3 * columns["x"] * (columns["T"] - 20)
    columns["T"][200:280] = np.nan
    inside = (columns["t"] > np.quantile(columns["t"], 0.36)) & (columns["t"] < np.quantile(columns["t"], 0.79))
    case = judged(columns, kinds, "EXX", simulated - 3.0 * columns["dir"] * inside + 0.5 * noise, simulated)
    search, every = case.search, case.library.hypotheses
    gain = np.where([bool(h.mask) for h in every], 0.0, search.score([]).gain)
    shown = [h.effect == "sensor_fault" and h.terms[0].log_prior_odds() > 0 for h in every]
    assert any(shown)
    for brought, added in ((1e4, False), (0.0, True)):
        alone = np.where(shown, brought, gain) + search.prior
        assert partial.add_parts(search, case.recording, case.pair.rows, alone) == added


def test_an_axis_that_cycles_between_readings_is_heated_by_its_feed():
    rng = np.random.default_rng(3)
    n, dt = 600, 15.0
    t, feed = np.arange(n) * dt, np.repeat(rng.choice([0, 6000, 12000, 24000], 12), 50).astype(float)
    x = np.tile(np.linspace(0, 600, 10), n // 10)
    warm = np.zeros(n)
    for i in range(1, n):
        warm[i] = warm[i - 1] + (1 - np.exp(-dt / 2200)) * (feed[i] / 24000 - warm[i - 1])
    bed = 20 + np.sin(t / 6000)
    simulated = 10e-3 * x * (bed - 20)
    error = simulated + 40e-3 * x * warm + 1.2 * rng.standard_normal(n)
    columns = {"run": np.repeat("1", n), "t": t, "x": x, "feed": feed, "T": bed}
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    kinds |= {"feed": {"role": "feed", "axis": "X", "unit": "mm/min"}}
    kinds |= {"T": {"role": "temperature", "unit": "degC", "location": "bed"}}
    case = judged(columns, kinds, "EXX", error, simulated)
    assert names(case) == ["feed_heating"]
    assert case.explanation.accepted[0].hypothesis.terms[0].cycled


def left_by_form(case, effect, signal):
    """rms that form and departures of an effect leave of a signal, over its own; of its best hypothesis."""
    out = []
    for h in case.library.hypotheses:
        if h.effect == effect:
            core, slack, _ = columns_of(h, case.recording)
            columns = np.column_stack([core, slack])
            out.append(np.std(signal - columns @ np.linalg.lstsq(columns, signal, rcond=None)[0]))
    return min(out) / np.std(signal)


def test_a_bow_on_a_circle_is_counted_from_any_centre():
    rng = np.random.default_rng(0)
    turn = np.concatenate([way * np.linspace(0, 2 * np.pi, 180, endpoint=False) for way in (1, -1, 1, -1)])
    run = np.repeat(np.arange(4), 180)
    x, y = 240 * np.cos(turn), 240 * np.sin(turn)
    columns = {"run": run.astype(str), "t": np.arange(turn.size) * 0.33, "x": x, "y": y}
    kinds = {a: {"role": "position", "axis": a.upper(), "unit": "mm"} for a in "xy"}
    bow, simulated = np.sin(3.6 * x / 240 + 0.4) * np.sin(turn), 4.0 * np.sin(2 * turn)
    case = judged(columns, kinds, "E_R", simulated + 5 * bow + 0.7 * rng.standard_normal(turn.size), simulated)
    assert names(case) == ["straightness"]
    assert left_by_form(case, "straightness", bow) < 0.01  # 0.10 where the centre is taken for known


@pytest.mark.parametrize(
    ("line", "angle", "named"),
    [*(pytest.param(line, 0.0, 1, marks=pytest.mark.slow) for line in (1.0, 0.0)), (0.4, 0.0, 1), (1.0, -40.0, 2)],
)
def test_the_slope_of_a_bow_on_a_circle_is_a_squareness_beyond_any_reference_line(line, angle, named):
    """The cubic part may be counted from the line through its ends, that of least squares, or the middle's."""
    rng = np.random.default_rng(2)
    turn = np.concatenate([way * np.linspace(0, 2 * np.pi, 180, endpoint=False) for way in (1, -1, 1, -1)])
    x, y = 100 * np.cos(turn), 100 * np.sin(turn)
    columns = {"run": np.repeat([*"1234"], 180), "t": np.arange(turn.size) * 0.33, "x": x, "y": y}
    kinds = {a: {"role": "position", "axis": a.upper(), "unit": "mm"} for a in "xy"}
    u, simulated = x / 100, 4.0 * np.cos(2 * turn)
    hidden = 6.0 * (u**2 + 0.5 * (u**3 - line * u)) * np.sin(turn) + angle * x * y / 1e5
    case = judged(columns, kinds, "E_R", simulated + hidden + 0.3 * rng.standard_normal(turn.size), simulated)
    assert sorted(names(case)) == ["squareness", "straightness"][2 - named :]


def test_friction_that_falls_more_slowly_than_stribecks_is_still_his():
    rng = np.random.default_rng(1)
    speed = np.repeat(rng.permutation([0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0] * 3), 40)
    v = speed * np.tile(np.repeat([1.0, -1.0], 40), speed.size // 80)
    t = np.arange(v.size) * 0.2
    columns = {"run": np.repeat("1", v.size), "t": t, "x": 500 + np.cumsum(v) * 0.2, "v": v}
    kinds = {"x": {"role": "position", "axis": "X", "unit": "mm"}}
    kinds |= {"v": {"role": "velocity", "axis": "X", "unit": "mm/s"}}
    simulated, falling = 60.0 * np.sign(v) + 0.8 * v, np.sign(v) * np.exp(-np.abs(v) / 4.0)
    case = judged(columns, kinds, "F_X", simulated + 40 * falling + 5 * rng.standard_normal(v.size), simulated, "N")
    assert names(case) == ["stribeck_friction"]
    assert left_by_form(case, "stribeck_friction", falling) < 0.05  # 0.10 by the square alone


def test_the_ends_of_a_part_are_found_between_the_places_that_are_tried_first():
    columns, kinds, noise = positioning(runs=5)
    del columns["T"], kinds["T"]
    simulated, t = 20e-3 * columns["x"], columns["t"]
    low, high = (float(np.quantile(t, q)) for q in (0.322, 0.535))
    inside = (t >= low) & (t <= high)
    case = judged(columns, kinds, "EXX", simulated - 3.0 * columns["dir"] * inside + 0.5 * noise, simulated)
    (found,) = case.explanation.accepted
    assert found.hypothesis.effect in ("backlash", "friction_hysteresis")
    kind, column, *ends = found.hypothesis.mask
    assert (kind, column) == ("range", "t")
    assert np.mean(((t >= ends[0]) & (t <= ends[1])) != inside) < 0.015  # of the rows; fourteenths miss by 0.03 at best


def test_a_guideway_of_any_shape_acts_in_some_runs():
    rng = np.random.default_rng(0)
    turn = np.concatenate([way * np.linspace(0, 2 * np.pi, 180, endpoint=False) for way in (1, -1) * 3])
    run = np.repeat(np.arange(6), 180)
    x, y = 240 * np.cos(turn), 240 * np.sin(turn)
    columns = {"run": run.astype(str), "t": np.arange(turn.size) * 0.33, "x": x, "y": y}
    kinds = {a: {"role": "position", "axis": a.upper(), "unit": "mm"} for a in "xy"}
    curve, simulated = np.sin(7.5 * x / 240 + 0.4) * np.sin(turn), 4.0 * np.sin(2 * turn)
    error = simulated + 5 * curve * (run >= 4) + 0.7 * rng.standard_normal(turn.size)
    (found,) = judged(columns, kinds, "E_R", error, simulated).explanation.accepted
    assert (found.hypothesis.effect, found.hypothesis.mask) == ("straightness", ("runs", ("4", "5")))


def test_a_bow_in_some_runs_is_counted_from_any_height():
    """Each run bears another mass on the table, which in these runs plays bow and height together."""
    rng = np.random.default_rng(2)
    run, u = np.repeat(np.arange(5), 144), rng.uniform(-1, 1, 5 * 144)
    columns = {"run": (run + 1).astype(str), "t": np.arange(run.size) * 20.0, "x": rng.uniform(0, 500, run.size)}
    columns |= {"y": 250 * (1 + u), "m": np.array([0.0, 145.0, 196.0, 140.0, 107.0])[run]}
    kinds = {a: {"role": "position", "axis": a.upper(), "unit": "mm"} for a in "xy"}
    kinds |= {"m": {"role": "load", "unit": "kg"}}
    simulated, bow = 20e-3 * columns["x"], 8.0 * (1 - u**2 + 0.3 * (u**3 - u)) * (run >= 3)
    case = judged(columns, kinds, "E_X", simulated + bow + 2.5 * rng.standard_normal(run.size), simulated)
    (found,) = case.explanation.accepted
    assert (found.hypothesis.effect, found.hypothesis.mask) == ("straightness", ("runs", ("4", "5")))


def test_a_body_that_acts_for_a_while_is_counted_from_any_temperature():
    columns, kinds, noise = positioning(runs=3)
    case = judged(columns, kinds, "EXX", 0.5 * noise, 20e-3 * columns["x"])
    low, high = (float(np.quantile(columns["t"], q)) for q in (0.3, 0.7))
    inside = (columns["t"] >= low) & (columns["t"] <= high)
    signal = 3.0 * (case.recording.array("T") - 23.7) * inside
    for effect, fits in (("thermal_drift", True), ("scale_expansion", False)):  # which has its reference along x
        whole = next(h for h in case.library.hypotheses if h.effect == effect)
        core, slack, _ = columns_of(replace(whole, mask=("range", "t", low, high)), case.recording)
        form = np.column_stack([core, slack[:, 0]])
        left = signal - form @ np.linalg.lstsq(form, signal, rcond=None)[0]
        assert (np.std(left) < 1e-6 * np.std(signal)) == fits


def test_the_temperature_from_which_a_part_counts_is_no_other_mechanism():
    """Its level there belongs to its form, on held-out rows as well."""
    columns, kinds, noise = positioning(runs=3)
    inside = (columns["t"] >= np.quantile(columns["t"], 0.3)) & (columns["t"] <= np.quantile(columns["t"], 0.7))
    hidden = 1.5 * (columns["T"] - np.mean(columns["T"]) - 6.0) * inside
    case = judged(columns, kinds, "EXX", 20e-3 * columns["x"] + hidden + 0.5 * noise, 20e-3 * columns["x"])
    assert names(case) == ["thermal_drift"] and case.explanation.accepted[0].hypothesis.mask[0] == "range"
    held = holdout.held_out(case)
    assert held.textbook_share() > 0.9 and not unnamed.departures_predict_held_out(case, held)


def test_tools_of_which_few_wear_are_no_other_mechanism():
    rng = np.random.default_rng(4)
    run, length = np.repeat(np.arange(6), 50), np.tile(np.linspace(0, 900, 50), 6)
    columns = {"run": run.astype(str), "t": np.arange(run.size) * 20.0 + run * 600.0, "s": length}
    columns["F"] = 300 + 60 * rng.standard_normal(run.size)
    kinds = {"s": {"role": "cut_length", "unit": "m"}, "F": {"role": "force", "unit": "N", "component": "F_Y"}}
    simulated, worn = 0.02 * columns["F"], 8.0 * np.sqrt(length / 1000) * np.isin(run, (0, 3))
    case = judged(columns, kinds, "E_D", simulated + worn + 0.7 * rng.standard_normal(run.size), simulated)
    assert names(case) == ["tool_wear"]
    assert not unnamed.departures_predict_held_out(case, holdout.held_out(case))


@pytest.mark.parametrize("level", [True, False])
def test_a_name_on_a_stretch_that_is_only_its_level_comes_after_unknown(level):
    """A joint between two scales shifts all positions beyond it; play there is no such level."""
    columns, kinds, noise = positioning(runs=4)
    x = columns["x"]
    hidden = 5.0 * (x > 320) if level else 3.0 * columns["dir"] * (x > 320)
    case = judged(columns, kinds, "EXX", 20e-3 * x + hidden + 0.5 * noise, 20e-3 * x)
    assert case.explanation.accepted[0].hypothesis.mask
    assert unnamed.is_a_level(case) == level
    (response, *_) = report.response(case)
    assert (response.verdict == "unexplained") == level
    assert not level or max(f.confidence for f in response.findings[1:] if f.effect != "recalibration") <= 0.4
