"""Sizes where departures from the textbook form carry the effect: those of the form that comes nearest."""

import numpy as np

from errpipe.diagnosis import diagnose
from errpipe.diagnosis.units import rounded
from errpipe.kernels.responses import lag

from .machines import recording, trace


def test_the_size_of_a_lag_that_departures_play_is_that_of_the_lag():
    """Valves switch between two rows, noise is small: lags of a third and of three times tau mend the half row."""
    rng = np.random.default_rng(5)
    t = np.arange(400) * 92.0
    flows = (np.searchsorted(np.sort(rng.uniform(0, t[-1], 7)), t) % 2).astype(float)
    between = (flows + np.r_[0.0, flows[:-1]]) / 2
    warmed = -5.9 * lag(np.zeros(400, dtype=int), t, between, 612.0, 612.0, False)
    columns = {"t": t, "flows": flows, "E_X": warmed + 0.06 * rng.standard_normal(400), "E_X_sim": np.zeros(400)}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "flows": {"role": "coolant"},
        "E_X": {"role": "error", "component": "E_X", "unit": "um"},
        "E_X_sim": {"role": "simulated", "component": "E_X", "unit": "um"},
    }
    found = diagnose(recording(columns, kinds))[0].responses[0].findings
    (first, *_) = [f for f in found if f.effect == "coolant_effect"]
    (shift,) = [p for p in first.parameters if p.name == "shift"]
    assert shift.ci95[0] <= -5.9 <= shift.ci95[1]


def test_an_axis_that_tilts_is_seen_in_its_own_deviation_and_its_angle_has_a_size():
    """Two of five runs show the angle, and where it is zero: each left out alone the other tells both."""
    rng, n = np.random.default_rng(8), 90
    x, height = rng.uniform(-400.0, 0.0, n), np.repeat([160.0, 0.0, 0.0, 0.0, 40.0], n // 5)
    hidden = 0.05 * height * (x + 400.0) / 400.0
    columns = {"run": np.repeat(list("abcde"), n // 5), "t": 90.0 * np.arange(n), "z": x, "x": height}
    kinds = {"run": {"role": "run"}, "t": {"role": "time", "unit": "s"}}
    kinds |= {n: {"role": "position", "axis": n.upper(), "unit": "mm"} for n in "zx"}
    columns |= {"E": hidden + 0.1 * np.std(hidden) * rng.standard_normal(n), "S": np.zeros(n)}
    kinds |= {"E": {"role": "error", "component": "EZZ", "unit": "um"}}
    kinds |= {"S": {"role": "simulated", "component": "EZZ", "unit": "um"}}
    (response,) = diagnose(recording(columns, kinds))[0].responses
    assert response.findings[0].effect == "angular_abbe"
    angle = response.findings[0].parameters[0]
    assert 0.0 < angle.ci95[0] <= 25.0 <= angle.ci95[1]


def test_the_size_of_falling_friction_is_that_at_creep_whatever_its_law():
    """It falls with the speed, not with its square (Tustin's law): no Gaussian curve has that size at creep."""
    made = trace(hidden=lambda row: 30.0 * np.sign(row["v"]) * np.exp(-np.abs(row["v"]) / 12.0))
    (first, *_) = diagnose(made)[0].responses[0].findings
    assert first.effect == "stribeck_friction"
    (extra,) = [p for p in first.parameters if p.name == "extra"]
    assert extra.ci95[0] <= 30.0 <= extra.ci95[1] < 45.0
    assert "x at 1, 3, 10, 30 and 100 % of 2" in first.would_separate and " mm/s, in both" in first.would_separate


def test_numbers_in_sentences_have_no_exponent_up_to_a_million():
    assert [rounded(v) for v in (5768.6, 0.0123, -28100.0, 2.5e7)] == ["5770", "0.0123", "-28100", "2.5e+07"]
