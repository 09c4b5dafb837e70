"""A faulty sensor: its estimate from the others is computed once, however many stretches are flagged."""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import hypotheses
from errpipe.domain.recording import Recording
from errpipe.kernels.responses import lag
from errpipe.terms import sensor_fault
from errpipe.terms.sensor_fault import LOG_ODDS_IF_VISIBLE, SensorFault, reconstructed, step_between, steps, suspicious
from tests.unit.diagnosis.machines import recording

ROWS = 200


def _recording() -> Recording:
    t = np.arange(ROWS) * 60.0
    warm = 20 + 3 * (1 - np.exp(-t / 4000))
    columns = {"t": t, "a": warm, "b": 2 * warm - 20, "c": warm + np.sin(t / 900)}
    kinds = {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}}
    return recording(columns, kinds)


def test_lags_of_the_other_sensors_are_computed_once_for_all_flagged_stretches(monkeypatch) -> None:
    calls, lag = [], sensor_fault.lag
    monkeypatch.setattr(sensor_fault, "lag", lambda *a: calls.append(a[3]) or lag(*a))
    made = _recording()
    bases = [SensorFault(sensor="a", first=f, last=f + 20).basis(made) for f in (50, 90, 130)]
    assert len(calls) == 4  # two other sensors, each with two time constants
    alone = [SensorFault(sensor="a", first=f, last=f + 20).basis(_recording()) for f in (50, 90, 130)]
    assert [b.tobytes() for b in bases] == [b.tobytes() for b in alone]
    rows = np.arange(ROWS)
    assert all(not b[(rows < f) | (rows > f + 20)].any() for b, f in zip(bases, (50, 90, 130), strict=True))


def test_a_reading_is_drawn_on_between_the_readings_on_either_side() -> None:
    """A body of its own, warmed by what no other sensor sees, is off by little at the ends of the gap."""
    made = _recording()
    own = made.array("a") + 1e-4 * made.time()
    made = recording(
        {n: made.array(n) for n in "tbc"} | {"a": own},
        {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}},
    )
    drawn = reconstructed(made, "a", 80, 140)
    assert np.abs(drawn - own)[[80, 140]].max() < 0.02 < np.std(own)


def test_a_stretch_that_stands_still_until_it_jumps_ends_at_the_jump() -> None:
    still = np.where(np.arange(140) % 10 == 5, 17.6, 17.7)
    read = np.r_[np.round(18.6 - 0.01 * np.arange(80), 1), still, np.full(200, 15.9)]
    ((first, last),) = [ab for ab in suspicious(read, 180.0 * np.arange(read.size)) if ab[1] == 219]
    assert 60 <= first <= 90 and last == 219


def test_one_of_two_equal_jumps_may_be_at_a_switch() -> None:
    t, read = _warming(400, 0.02)
    switched = np.isin(np.arange(400), range(99, 104))
    for back, seen in ((2.5, True), (1.5, False)):
        off = 2.5 * ((t > 6000) & (t < 15000)) + (2.5 - back) * (t >= 15000)
        assert suspicious(read + off, t, switched)[101, 249] == seen
    assert not suspicious(read + off, t, switched | np.isin(np.arange(400), range(247, 253)))[101, 249]


def test_a_reading_held_far_longer_than_any_other_is_seen_to_have_failed() -> None:
    """A coarse display often repeats itself, readings are missing in between, and a body at rest leaves slowly."""
    rows = np.arange(600)
    read = np.round(20.0 + 3.0 * np.sin(rows / 90.0), 1)
    for leap, seen in ((0.1, False), (0.5, True)):
        held = np.where(rows < 60, read, np.where(rows < 310, read[60], read[60] + leap + read - read[310]))
        held[[110, 111, 200]] = np.nan
        assert suspicious(held, 180.0 * rows).get((60, 309), False) == seen
    often = np.where((rows >= 400) & (rows < 500), held[400], held)
    assert not suspicious(often, 180.0 * rows).get((60, 309), False)


def test_a_reading_that_freezes_and_resumes_without_a_jump_is_seen_to_have_failed() -> None:
    """Its last readings before and the first after are near the frozen one; other sensors are never still."""
    read = np.round(20.0 + 3.0 * np.sin(np.arange(300) / 40.0), 2)
    read[126:252] = read[126]  # half a wave later it is back at the same reading
    read[252:256] = read[126] + 0.01 * np.arange(1, 5)
    found = suspicious(read, 180.0 * np.arange(read.size))
    assert any(seen and abs(first - 126) <= 2 and abs(last - 251) <= 2 for (first, last), seen in found.items())


def test_a_sensor_that_reads_nothing_is_seen_to_have_failed() -> None:
    made = _recording()
    read = np.where((np.arange(ROWS) > 80) & (np.arange(ROWS) < 140), np.nan, made.array("b"))
    made = recording(
        {n: made.array(n) for n in "tac"} | {"b": read},
        {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}},
    )
    odds = {(h.sensor, h.first, h.last): h.log_prior_odds() for h in SensorFault.bind(made, "EXX")}
    assert odds.pop(("b", 81, 139)) == LOG_ODDS_IF_VISIBLE
    assert all(o == SensorFault.prior_log_odds for o in odds.values())


def _with_failures() -> Recording:
    """Sensor b reads nothing for a while, sensor c jumps three times."""
    made, rows = _recording(), np.arange(ROWS)
    silent = np.where((rows > 80) & (rows < 140), np.nan, made.array("b"))
    jumping = made.array("c") + 5.0 * ((rows > 30) & (rows < 70)) - 4.0 * (rows > 150)
    return recording(
        {n: made.array(n) for n in "ta"} | {"b": silent, "c": jumping},
        {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}},
    )


def test_a_failure_that_is_seen_shares_its_odds_with_no_jump_of_another_sensor(monkeypatch) -> None:
    made = _with_failures()
    monkeypatch.setattr(hypotheses, "TERMS", (SensorFault,))
    odds = {(h.terms[0].sensor, h.terms[0].first): h.prior for h in hypotheses.enumerate_all(made, "E_Z", made, None)}
    assert len(odds) > 3 and odds.pop(("b", 81)) == LOG_ODDS_IF_VISIBLE
    assert all(o <= SensorFault.prior_log_odds - np.log(len(odds)) for o in odds.values())


def test_what_it_should_have_read_is_no_departure(monkeypatch) -> None:
    """Drawn from other sensors it has any shape: all columns are its form."""
    monkeypatch.setattr(hypotheses, "TERMS", (SensorFault,))
    made = _with_failures()
    library = hypotheses.build(made, "E_Z", np.arange(ROWS), made)
    assert all(library.textbook(i) == library.places[i].size > 1 for i in range(len(library.hypotheses)))


def _warming(rows: int, noise: float, seed: int = 5) -> tuple[np.ndarray, np.ndarray]:
    """Times and readings of a body that warms by 15 K."""
    t = 60.0 * np.arange(rows)
    return t, 20 + 15 * (1 - np.exp(-t / 3000)) + np.random.default_rng(seed).normal(0, noise, rows)


def test_a_jump_is_seen_whatever_its_size_with_the_noise() -> None:
    t, read = _warming(400, 0.02)
    for step in (0.25, 2.5):
        assert suspicious(read + step * ((t > 6000) & (t < 15000)), t)[101, 249]
    assert not any(suspicious(read, t).values())


def test_a_jump_of_a_body_that_warms_has_the_size_of_the_jump() -> None:
    t, read = _warming(200, 0.01)
    read[20:60] -= 1.2
    read[[19, 61]] = np.nan
    assert abs(step_between(*steps(read, t), 20, 59) + 1.2) < 0.1


def test_readings_that_come_slower_and_pauses_are_no_jumps() -> None:
    often = np.cumsum(np.r_[np.full(150, 4.0), np.full(100, 60.0), np.full(150, 4.0)])
    warm = 20 + 15 * (1 - np.exp(-np.maximum(often - 600, 0) / 3000)) + np.random.default_rng(6).normal(0, 0.03, 400)
    assert not any(suspicious(warm, often).values())
    cold = np.where(np.arange(400) < 200, warm, warm - 5)
    assert not any(suspicious(cold, often + 50000.0 * (np.arange(400) >= 200)).values())


def test_a_failure_that_ends_next_to_a_pause_is_seen() -> None:
    """A body that cooled in the pause jumps there, too: lines through that jump would miss the one beside it."""
    rows, (t, read) = np.arange(400), _warming(400, 0.02)
    warm = np.r_[read[:200], read[:200] - 1.0]
    t = t + 50000.0 * (rows >= 200)
    for first, last in ((120, 195), (204, 300), (120, 300)):
        off = warm + 2.5 * ((rows >= first) & (rows <= last))
        assert suspicious(off, t).get((first, last), False), (first, last)


def test_from_a_pause_to_the_end_a_sensor_is_off_only_if_that_is_the_lesser_part() -> None:
    rows, (t, read) = np.arange(400), _warming(400, 0.02)
    for first in (120, 280):
        at = t + 50000.0 * (rows >= first)
        assert ((first, 399) in suspicious(read + 3.0 * (rows >= first), at)) == (first == 280)


def test_a_sensor_that_stood_still_from_a_slow_time_on_is_seen_by_its_jump() -> None:
    rows, t, noise = np.arange(400), 60.0 * np.arange(400), np.random.default_rng(7).normal(0, 0.02, 400)
    stood = np.where((rows >= 180) & (rows < 330), 180, rows)
    read = 22 - 0.4 * np.cos(stood / 70) + noise
    ((first, last),) = [ab for ab, seen in suspicious(read, t).items() if seen]
    assert abs(first - 180) < 25 and last == 329


def test_a_sensor_that_jumps_again_and_again_is_not_seen_to_fail() -> None:
    t, read = _warming(500, 0.02)
    for k in range(3):
        read += 1.0 * ((t > 6000 * (k + 1)) & (t < 6000 * (k + 1) + 3000))
    assert len(suspicious(read, t)) > 5 and not any(suspicious(read, t).values())


def test_sensors_that_jump_at_once_did_not_fail() -> None:
    t, read = _warming(ROWS, 0.02)
    off = 2.0 * ((t > 6000) & (t < 9000))
    kinds = {n: {"role": "temperature", "unit": "degC"} for n in "ab"} | {"t": {"role": "time", "unit": "s"}}
    for other, seen in ((read, True), (read + off, False)):
        made = recording({"t": t, "a": read + off, "b": other}, kinds)
        assert (max(h.log_prior_odds() for h in SensorFault.bind(made, "EXX")) == LOG_ODDS_IF_VISIBLE) == seen


def test_what_goes_with_the_spindle_is_not_seen_to_be_a_failure() -> None:
    t, rows = _warming(ROWS, 0.01)[0], np.arange(ROWS)
    on = (rows >= 60) & (rows < 120)
    noise = np.random.default_rng(8).normal(0, 0.02, ROWS)
    columns = {"t": t, "a": 20 + 3.0 * on + noise, "b": 20 + rows / 100, "n": 3000.0 * on}
    kinds = {n: {"role": "temperature", "unit": "degC"} for n in "ab"} | {"t": {"role": "time", "unit": "s"}}
    for n, seen in (("n", False), ("a", True)):
        role = {"role": "spindle_speed", "unit": "rpm"} if n == "n" else {"role": "ignore"}
        made = recording(columns | {"n": columns["n"]}, kinds | {"n": role})
        odds = {(h.first, h.last): h.log_prior_odds() for h in SensorFault.bind(made, "EXX") if h.sensor == "a"}
        assert (odds[60, 119] == LOG_ODDS_IF_VISIBLE) == seen


def test_what_the_simulation_takes_for_a_missing_reading_is_open() -> None:
    """The last value, the first one after a pause, or a default: an unknown level; a value that is read is known."""
    made = _with_failures()
    (missing,) = [f for f in SensorFault.bind(made, "E_Z") if (f.sensor, f.first, f.last) == ("b", 81, 139)]
    known = SensorFault(sensor="b", first=81, last=139)
    base = np.zeros((ROWS, 1))
    (_, unknown_level), (_, slope), *_ = missing.slack(made, base)
    (_, level), *_ = known.slack(made, base)
    assert unknown_level >= 1.0 and level == slope == sensor_fault.DRAWN


def test_what_coolant_cools_is_drawn_from_its_valve() -> None:
    t = np.arange(ROWS) * 60.0
    valve = (np.arange(ROWS) // 23 % 2).astype(float)
    cooled = 25 - 4 * lag(np.zeros(ROWS, dtype=int), t, valve, 900.0, 900.0, True)
    kinds = {n: {"role": "temperature", "unit": "degC"} for n in "ab"} | {"t": {"role": "time", "unit": "s"}}
    made = recording(
        {"t": t, "a": cooled, "b": 20 + np.sin(t / 5000), "valve": valve}, kinds | {"valve": {"role": "coolant"}}
    )
    assert np.abs(reconstructed(made, "a", 80, 140) - cooled)[80:141].max() < 0.25 * np.ptp(cooled)
