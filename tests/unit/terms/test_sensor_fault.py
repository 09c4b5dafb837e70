"""A faulty sensor: what the others say of it is worked out once, however many stretches are suspected."""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.terms import sensor_fault
from errpipe.terms.sensor_fault import SensorFault
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
