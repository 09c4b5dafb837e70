"""Sensors that are read less often than the response, as many loggers read them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.drivers.between_readings import between_readings

from .machines import recording

KINDS = {
    "t": {"role": "time", "unit": "s"},
    "T": {"role": "temperature", "unit": "degC", "location": "tube"},
    "E_Z": {"role": "error", "component": "E_Z", "unit": "um"},
    "S": {"role": "simulated", "component": "E_Z", "unit": "um"},
}


def tube(seed: int = 2):
    """A tube that drifts by 3 um/K; a reading of its temperature in every row."""
    rng, t = np.random.default_rng(seed), 60.0 * np.arange(420)
    warm = 20 + 4 * (1 - np.exp(-t / 6000)) + np.sin(t / 3000)
    noise = 0.3 * rng.normal(size=t.size)
    return recording({"t": t, "T": np.round(warm, 2), "E_Z": 3 * (warm - 20) + noise, "S": 0.0 * t + t / 1e4}, KINDS)


def now_and_then(made, how: str):
    """The same with a reading in every sixth row; between them cells are empty or hold it."""
    read = made.frame["T"].where(np.arange(len(made)) % 6 == 0)
    return replace(made, frame=made.frame.assign(T=read.ffill() if how == "held" else read))


@pytest.mark.parametrize("how", ["empty", "held"])
def test_a_sensor_that_is_read_now_and_then_drives_what_it_drives(how):
    made = tube()
    assert between_readings(now_and_then(made, how)).array("T") == pytest.approx(made.array("T"), abs=0.1)
    said = diagnose(now_and_then(made, how))[0].responses[0].findings[0]
    assert said.effect == "thermal_drift" and said.drivers == ("T",) and said.confidence > 0.7
    assert said.parameters[0].value == pytest.approx(3.0, rel=0.1)


@pytest.mark.parametrize("fault", ["whole", "dead", "stuck", "coarse", "silent"])
def test_failures_of_a_sensor_stay_as_they_are(fault):
    made = tube()
    read = made.array("T").copy()
    if fault == "dead":
        read[200:300] = np.nan
    if fault == "silent":
        read[120:] = np.nan
    if fault == "stuck":
        read[200:300] = read[200]
    if fault == "coarse":
        read = np.round(read * 2) / 2
    made = replace(made, frame=made.frame.assign(T=read))
    assert np.array_equal(between_readings(made).array("T"), read, equal_nan=True)
