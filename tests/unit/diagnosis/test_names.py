"""From a known truth: the name, the drivers and the size come back, and a perfect simulation raises no alarm."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose
from errpipe.kernels import responses

from .machines import axis, recording, spindle, trace


def growth(columns):
    n = columns["t"].size
    run = np.zeros(n, dtype=np.int64)
    return 12 * responses.lag(run, columns["t"], (columns["rpm"] / 12000) ** 1.4, 1800.0, 1800.0, False)


HIDDEN = {
    "backlash": (axis, lambda c: -3.0 * c["dir"], "lost_motion", 6.0),
    "pitch_cyclic": (axis, lambda c: 1.5 * np.sin(2 * np.pi * c["x"] / 10.0), "sine", 1.5),
    "scale_expansion": (axis, lambda c: 11.0 * c["x"] * 1e-3 * (c["T_nut"] - 20), "coefficient", 11.0),
    "sensor_drift": (axis, lambda c: 3.0 * c["t"] / 3600, "rate", 3.0),
    "spindle_growth": (spindle, growth, "tau", 1800.0),
    "centrifugal_growth": (spindle, lambda c: -4.0 * (c["rpm"] / 12000) ** 2, "shift", 4.0),
    "coulomb_friction": (trace, lambda c: 8.0 * np.sign(c["v"]), "force", 8.0),
    "viscous_friction": (trace, lambda c: 0.1 * c["v"], "damping", 100.0),
}


@pytest.mark.parametrize("effect", HIDDEN)
def test_a_hidden_effect_is_named_with_its_size(effect):
    make, hidden, parameter, size = HIDDEN[effect]
    response = diagnose(make(3, hidden=hidden))[0].responses[0]
    assert response.verdict == "missing_physics"
    first = response.findings[0]
    assert effect in (first.effect, *first.indistinguishable_from)
    assert first.confidence > 0.5
    if first.effect == effect:
        match = next(p for p in first.parameters if p.name == parameter)
        low, high = sorted(map(abs, match.ci95))
        assert low * 0.98 <= size <= high * 1.02
    assert response.holdout.rms_after_um < 0.5 * response.holdout.rms_before_um or effect == "sensor_drift"


@pytest.mark.parametrize("turn", [0.7, *(pytest.param(t, marks=pytest.mark.slow) for t in (0.0, 2.0))])
def test_a_wave_has_an_amplitude_whatever_its_phase(turn):
    made = axis(8, hidden=lambda c: 1.5 * np.sin(2 * np.pi * c["x"] / 10.0 + turn))
    first = diagnose(made)[0].responses[0].findings[0]
    (output,) = (p for p in first.parameters if p.name == "amplitude")
    assert first.effect == "pitch_cyclic" and output.unit == "um"
    assert output.ci95[0] <= 1.5 <= output.ci95[1] and output.ci95[1] - output.ci95[0] < 0.6


@pytest.mark.parametrize("uneven", [0.0, 0.3])
def test_the_interval_of_a_size_that_varies_is_as_wide_as_it_varies(uneven):
    """Lost motion of 6 um that grows by a third with the day: many rows do not make its mean any surer."""
    day = lambda c: 1 + uneven * (2 * c["t"] / c["t"][-1] - 1)  # noqa: E731
    first = diagnose(axis(3, hidden=lambda c: -3.0 * c["dir"] * day(c), noise=0.2))[0].responses[0].findings[0]
    (output,) = (p for p in first.parameters if p.unit == "um")
    low, high = sorted(map(abs, output.ci95))
    assert first.effect == "backlash" and low <= 6.0 <= high
    assert (high - low > 0.9) == (uneven > 0)


def test_the_depth_of_a_worn_stretch_is_that_of_its_deepest_place():
    """A trough with steep sides, unlike the bell that is fitted to it: 6 um deep all the same."""
    made = axis(9, hidden=lambda c: -6.0 / (1 + ((c["x"] - 330.0) / 45.0) ** 6))
    first = diagnose(made)[0].responses[0].findings[0]
    (depth,) = (p for p in first.parameters if p.name == "depth")
    assert first.effect == "local_wear"
    assert depth.ci95[0] <= -6.0 <= depth.ci95[1] and depth.ci95[1] < -4.0


@pytest.mark.parametrize("make", [axis, spindle, trace])
@pytest.mark.parametrize("seed", [0, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 2))])
def test_a_perfect_simulation_raises_no_alarm(make, seed):
    response = diagnose(make(seed))[0].responses[0]
    assert response.verdict == "no_mismatch"
    assert not response.findings


def test_wrong_gains_are_a_recalibration_and_nothing_is_missing():
    response = diagnose(axis(4, gains=(1.12, 0.9)))[0].responses[0]
    assert response.verdict == "recalibrate"
    assert [f.effect for f in response.findings] == ["recalibration"]
    assert response.rms_after_um == pytest.approx(0.5, rel=0.1)


def test_two_effects_at_once_are_both_found():
    both = axis(5, hidden=lambda c: -3.0 * c["dir"] + 1.5 * np.sin(2 * np.pi * c["x"] / 10.0))
    matches = [f.effect for f in diagnose(both)[0].responses[0].findings]
    assert {"backlash", "pitch_cyclic"} <= set(matches)


def test_an_effect_that_acts_in_two_runs_is_located():
    part = axis(6, hidden=lambda c: -4.0 * c["dir"] * (np.arange(c["t"].size) >= 4 * c["t"].size // 6))
    first = diagnose(part)[0].responses[0].findings[0]
    assert first.effect in ("backlash", "friction_hysteresis")
    assert set(first.where.runs) == {"5", "6"}


def test_what_no_effect_carries_is_not_given_a_name_with_confidence():
    def doors(columns):
        t = columns["t"]
        start = np.array([3000.0, 8000.0, 16000.0, 24000.0, 30000.0])
        return sum(-6 * np.exp(-np.clip(t - s, 0, None) / 900) * (t > s) for s in start)

    response = diagnose(spindle(7, hidden=doors))[0].responses[0]
    assert response.verdict in ("unexplained", "missing_physics")
    assert response.verdict == "unexplained" or response.findings[0].effect == "unknown"
    assert all(f.confidence < 0.8 for f in response.findings if f.effect not in ("unknown", "recalibration"))


@pytest.mark.slow
def test_coolant_that_acts_between_two_rows_is_named():
    """Rows every three minutes, a time constant of some seconds: no lag to be seen, and no reason to rule it out."""
    rng = np.random.default_rng(3)
    t, flows = 180.0 * np.arange(320), np.repeat(rng.integers(0, 2, 40), 8)
    room = 20 + 1.5 * np.sin(t / 9000)
    columns = {"t": t, "flows": flows, "T_room": room, "S": 2 * (room - 20)}
    columns["E"] = columns["S"] + 6.0 * flows + 1.5 * rng.normal(size=t.size)
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "flows": {"role": "coolant"},
        "T_room": {"role": "temperature", "unit": "degC", "location": "room"},
        "E": {"role": "error", "component": "E_X", "unit": "um"},
        "S": {"role": "simulated", "component": "E_X", "unit": "um"},
    }
    first = diagnose(recording(columns, kinds))[0].responses[0].findings[0]
    assert first.effect == "coolant_effect" and first.confidence > 0.6
    (shift,) = (p for p in first.parameters if p.name == "shift")
    assert shift.ci95[0] < 6.0 < shift.ci95[1]


def test_equal_input_gives_equal_findings():
    case = axis(3, hidden=lambda c: -3.0 * c["dir"])
    assert diagnose(case)[0].document() == diagnose(case)[0].document()


def test_outliers_do_not_become_physics():
    case = axis(8)
    frame = case.frame.copy()
    frame.loc[[20, 130, 260, 400], "EXX"] += 40.0
    response = diagnose(type(case)(case.manifest, frame))[0].responses[0]
    assert response.verdict == "no_mismatch"


def test_wear_has_no_rival_in_its_own_curve():
    """A curve over the length cut is wear, too; over another input it is a rival."""
    from types import SimpleNamespace

    from errpipe.diagnosis import report

    kinds = [SimpleNamespace(drivers=(d,), of_inputs=True, freedom=d) for d in ("cut", "rpm")]
    gains = {"cut": 232.0, "rpm": 41.0}
    scene = SimpleNamespace(gains=lambda sets, freedoms, rows: np.array([gains[f] for f in freedoms]))
    search = SimpleNamespace(scene=lambda chosen: scene, rows=None)
    case = SimpleNamespace(free_shapes=kinds, places=[0, 1], search=search)
    for form, expected in (("any rate", 41.0), ("textbook", 232.0)):
        name = SimpleNamespace(drivers=("cut",), terms=(SimpleNamespace(form=form),))
        assert report._best_shape(case, [], name) == expected
