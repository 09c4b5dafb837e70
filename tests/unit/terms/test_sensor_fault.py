"""A faulty sensor: what the others say of it is worked out once, however many stretches are suspected."""

from __future__ import annotations

import numpy as np

from errpipe.diagnosis import hypotheses
from errpipe.domain.recording import Recording
from errpipe.terms import sensor_fault
from errpipe.terms.sensor_fault import SensorFault, reconstructed, suspicious
from tests.unit.diagnosis.machines import recording

ROWS = 200


def _recording() -> Recording:
    t = np.arange(ROWS) * 60.0
    warm = 20 + 3 * (1 - np.exp(-t / 4000))
    columns = {"t": t, "a": warm, "b": 2 * warm - 20, "c": warm + np.sin(t / 900)}
    kinds = {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}}
    return recording(columns, kinds)


def test_lags_of_the_other_sensors_are_worked_out_once_for_all_suspected_stretches(monkeypatch) -> None:
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


def test_a_sensor_that_reads_nothing_is_seen_to_have_failed() -> None:
    made = _recording()
    read = np.where((np.arange(ROWS) > 80) & (np.arange(ROWS) < 140), np.nan, made.array("b"))
    made = recording(
        {n: made.array(n) for n in "tac"} | {"b": read},
        {n: {"role": "temperature", "unit": "degC"} for n in "abc"} | {"t": {"role": "time", "unit": "s"}},
    )
    odds = {(h.sensor, h.first, h.last): h.log_prior_odds() for h in SensorFault.bind(made, "EXX")}
    assert odds.pop(("b", 81, 139)) == 0.0
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
    assert len(odds) > 3 and odds.pop(("b", 81)) == 0.0
    assert all(o <= SensorFault.prior_log_odds - np.log(len(odds)) for o in odds.values())


def test_what_it_should_have_read_is_no_departure(monkeypatch) -> None:
    """Drawn from other sensors it has any shape: all columns are its form."""
    monkeypatch.setattr(hypotheses, "TERMS", (SensorFault,))
    made = _with_failures()
    library = hypotheses.build(made, "E_Z", np.arange(ROWS), made)
    assert all(library.textbook(i) == library.places[i].size > 1 for i in range(len(library.hypotheses)))
