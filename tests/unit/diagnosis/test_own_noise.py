"""Noise with a memory, tails, steps or a coarse display is no mechanism, and does not hide one; unusual cases."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from errpipe.diagnosis import coloured, diagnose, own_noise
from trials import noise

from .machines import recording

SEED = 5


def slow(*values):
    """A case like a fast one: the same steps of the diagnosis on another machine or kind of noise."""
    return pytest.param(*values, marks=pytest.mark.slow)


NULLS = [("axis", "jumps"), ("spindle", "random walk"), ("axis", noise.COARSE)]
NULLS += [slow("axis", "AR(1) 0.99"), slow("spindle", "1/f"), slow("spindle", "AR(1) 0.999")]
NULLS += [slow("axis", "Student t, 2 dof"), slow("trace", "AR(1) 0.99")]
EFFECTS = [("axis", "AR(1) 0.9"), ("spindle", "Student t, 2 dof"), slow("axis", "random walk")]
EFFECTS += [slow("spindle", "AR(1) 0.99"), slow("trace", "random walk"), slow("spindle", noise.COARSE)]


@pytest.mark.parametrize(("machine", "kind"), NULLS)
def test_noise_raises_no_alarm(machine, kind):
    case, names = noise.case(SEED, machine, kind, hidden=False)
    assert noise.judged(names, noise.said(case))["right"]


@pytest.mark.parametrize(("machine", "kind"), EFFECTS)
def test_noise_does_not_hide_an_effect(machine, kind):
    case, names = noise.case(SEED, machine, kind, hidden=True)
    assert noise.judged(names, noise.said(case)) == {"right": True, "sure_and_wrong": False}


@pytest.mark.slow
def test_a_gauge_that_jumps_now_and_then_is_no_drift():
    case, _ = noise.case(39304, "trace", "jumps", hidden=False)
    assert max((confidence for _, confidence in noise.said(case)), default=0.0) <= 0.45


@pytest.mark.parametrize(("instead", "beside", "only"), [(14.0, 5.0, False), (14.0, 20.0, True), (12.0, 20.0, False)])
def test_steps_take_the_place_of_names_that_leave_steps(monkeypatch, instead, beside, only):
    """A lag that a spindle drives from speed to speed is nearly a few steps, and leaves none."""
    left_out = SimpleNamespace(columns=lambda chosen: chosen)
    case = SimpleNamespace(chosen=lambda: [(0, 1.0)], taken_back=False, y=None, run=None, judged=lambda: left_out)
    monkeypatch.setattr(own_noise, "residual", lambda case, chosen: None)
    monkeypatch.setattr(own_noise.coloured, "autoregression", lambda left, run: None)
    monkeypatch.setattr(own_noise, "_gain_of_names", lambda case, bare: 12.7)
    monkeypatch.setattr(own_noise, "with_steps", lambda y, columns, most: [beside if columns else instead])
    monkeypatch.setattr(own_noise, "linear_gain", lambda case, noise, rest, freedom: rest)
    assert own_noise.only_steps(case) == only  # type: ignore[arg-type]


@pytest.mark.parametrize(("keep", "white"), [(0.9, 0.0), (0.99, 0.3), (0.0, 1.0)])
def test_the_colour_of_noise_is_found(keep, white):
    rng = np.random.default_rng(3)
    slow = noise.first_order(rng, 2000, keep)
    values = np.sqrt(1 - white) * slow / slow.std() + np.sqrt(white) * rng.standard_normal(2000)
    run = np.zeros(2000, dtype=int)
    colour = coloured.fitted(values, run)
    assert coloured.correlation_time(coloured.whiten(values, run, colour), run) < 1.5
    if white < 1:
        assert 0.4 < colour.memory * -np.log(keep) < 2.5 and colour.share == pytest.approx(1 - white, abs=0.15)


def test_a_colour_is_taken_back_exactly():
    rng = np.random.default_rng(4)
    values, run = rng.standard_normal((50, 3)), np.repeat([0, 1], 25)
    slow = coloured.Colour(40.0, 0.97)
    there = coloured.whiten(values, run, slow)
    assert np.allclose(coloured.recolour(there, run, slow, coloured.USUAL), coloured.whiten(values, run))


def log(lost_motion: float, sign: float = 1.0):
    """100 s at 20 Hz of an axis of which positions alone are recorded, beside a body that follows 40 s late."""
    rng = np.random.default_rng(2)
    t = 0.05 * np.arange(2000)
    x = 50 + 40 * np.sin(2 * np.pi * t / 8)
    body = 20 + 6 * (1 - np.exp(-np.clip(t - 15, 0, None) / 3)) - 4 * (1 - np.exp(-np.clip(t - 60, 0, None) / 3))
    side = np.where(np.gradient(x) < 0, 1.0, -1.0)
    known = 0.1 * x + 3 * np.sin(x / 9)
    error = known + 3 * (noise.late(t, body, 40.0) - 20) + lost_motion / 2 * side + 0.3 * rng.standard_normal(t.size)
    columns = {"t": t, "x": x, "T": body + 0.02 * rng.standard_normal(t.size), "E": sign * error, "S": known}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "T": {"role": "temperature", "unit": "degC", "location": "bed"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    return recording(columns, kinds)


@pytest.mark.slow
def test_a_slow_lag_and_lost_motion_are_both_found_from_positions_alone():
    (response,) = diagnose(log(2.0))[0].responses
    by_name = {f.effect: f for f in response.findings if f.effect != "recalibration"}
    assert set(by_name) == {"thermal_lag", "backlash"} and all(f.confidence >= 0.6 for f in by_name.values())
    tau = next(p for p in by_name["thermal_lag"].parameters if p.name == "tau")
    assert tau.ci95[0] <= 40.0 <= tau.ci95[1] < 80.0
    assert by_name["backlash"].drivers == ("x",)  # the column that the recording has


@pytest.mark.parametrize(("size", "period"), [slow(60.0, 3100.0), (30.0, 1500.0)])
def test_a_slow_mechanism_without_a_name_is_no_noise(size, period):
    """Guideway film over the oil's pressure: as a random walk it was noise, and only gains were recalibrated."""
    rng = np.random.default_rng(6)
    t = 10.0 * np.arange(600)
    x, scale = 500 + 480 * np.sin(2 * np.pi * t / 290), 20 + 1.5 * np.sin(2 * np.pi * t / 900 + 1)
    oil = 120 - 25 * (1 - np.exp(-t / 5000)) + 6 * np.sin(2 * np.pi * t / period)
    known = 0.012 * x * (scale - 20) + 2 * np.sin(x / 90)
    error = 1.04 * known + size * ((120 / oil) ** (1 / 3) - 1) + 0.4 * rng.standard_normal(t.size)
    columns = {"t": t, "x": x, "P": oil.round(1), "T": scale.round(2), "E": error.round(1), "S": known}
    kinds = {
        "t": {"role": "time", "unit": "s"},
        "x": {"role": "position", "axis": "X", "unit": "mm"},
        "P": {"role": "pressure", "unit": "bar", "location": "oil supply"},
        "T": {"role": "temperature", "unit": "degC", "location": "scale"},
        "E": {"role": "error", "component": "EXX", "unit": "um"},
        "S": {"role": "simulated", "component": "EXX", "unit": "um"},
    }
    (response,) = diagnose(recording(columns, kinds))[0].responses
    first = response.findings[0]
    assert (first.effect, first.drivers) == ("unknown", ("P",)) and first.confidence >= 0.7


def test_a_reversed_sign_is_a_recalibration_and_is_reported():
    case, _ = noise.case(SEED, "spindle", "white", hidden=False)
    turned = type(case)(case.manifest, case.frame.assign(E=-case.frame["E"]))
    (response,) = diagnose(turned)[0].responses
    assert response.verdict == "recalibrate" and "opposite signs" in response.says
    gains = [p.value for f in response.findings for p in f.parameters if p.name.startswith("gain of ")]
    assert gains and all(-2.1 < gain < -1.9 for gain in gains)
    assert response.holdout.rms_after_um < 0.3 * response.holdout.rms_before_um


def narrow(rng, n: int, pole: float = 0.97, turn: float = 2.1):
    """Noise with a resonance: its spectrum is high around one frequency."""
    out = np.zeros(n + 200)
    for i, push in enumerate(rng.standard_normal(n + 200)):
        out[i] = 2 * pole * np.cos(turn) * out[i - 1] - pole**2 * out[i - 2] + push
    return out[200:] / out[200:].std()


@pytest.mark.parametrize("kind", [slow("AR(1) 0.9"), "AR(1) 0.99", slow("random walk"), "1/f", slow("white")])
def test_noise_that_wanders_is_a_linear_process(kind):
    run = np.zeros(600, dtype=int)
    quiet = [coloured.is_linear_noise(noise.KINDS[kind](np.random.default_rng(k), 600), run) for k in range(20)]
    assert sum(quiet) >= 17


def test_events_and_rhythms_are_no_linear_process():
    rng, run, i = np.random.default_rng(6), np.zeros(900, dtype=int), np.arange(900)
    decays = sum(np.where(i >= a, 12.0 * np.exp(-(i - a) / 15.0), 0.0) for a in (90, 350, 410, 700))
    beat = 3.0 * np.sin(2 * np.pi * i / 60 + 2.0 * np.sin(i / 300))
    steps = sum(np.where((i >= a) & (i < a + 40), 3.5, 0.0) for a in (120, 500, 760))  # hidden from row to row
    assert not coloured.autoregression(steps + rng.standard_normal(900), run).has_heavy_tails()
    for structure in (decays, beat, steps):
        assert not coloured.is_linear_noise(structure + rng.standard_normal(900), run)


@pytest.mark.parametrize(("size", "late"), [(5.0, 8.0), (8.0, 15.0)])
def test_what_opens_and_closes_late_is_no_linear_process(size, late):
    """Doors: from row to row noise hides them, means over rows are skewed (copies of the same spectrum are not)."""
    run, i = np.zeros(900, dtype=int), np.arange(900)
    opened = np.zeros(900)
    for first, last in ((60, 80), (240, 252), (300, 330), (610, 625), (800, 815)):
        rising, falling = (np.where(i >= a, 1.0 - np.exp(-(i - a) / late), 0.0) for a in (first, last))
        opened += size * (rising - falling)
    for seed in range(3):
        noisy = opened + np.random.default_rng(seed).standard_normal(900)
        assert not coloured.autoregression(noisy, run).has_heavy_tails()
        assert coloured.is_nonlinear(noisy, run)
    assert not any(coloured.is_nonlinear(c, run) for c in coloured.surrogates(noisy, 5, np.random.default_rng(1)))
    turned = np.repeat(np.arange(90), 10)  # runs of 10 rows; runs of one hold no means
    assert not coloured.is_nonlinear(np.random.default_rng(0).standard_normal(900), turned)
    assert not coloured.is_nonlinear(noisy, np.arange(900))
    assert not coloured.is_nonlinear(np.random.default_rng(0).standard_normal(9000), np.repeat(np.arange(4500), 2))


@pytest.mark.slow
def test_a_wave_of_noise_whose_spectrum_is_high_there_is_no_finding():
    rng = np.random.default_rng(11)
    i = np.arange(1500)
    x, noisy = 0.02 * i, narrow(rng, i.size)
    for hidden, wanted in ((0.0, []), (2.0 * np.sin(2 * np.pi * x / 1.7), ["pitch_cyclic"])):
        columns = {"t": 0.5 * i, "x": x, "E": 0.3 * x + hidden + noisy, "S": 0.3 * x}
        kinds = {"t": {"role": "time", "unit": "s"}, "x": {"role": "position", "axis": "X", "unit": "mm"}}
        for name, role in (("E", "error"), ("S", "simulated")):
            kinds[name] = {"role": role, "component": "EXX", "unit": "um"}
        (response,) = diagnose(recording(columns, kinds))[0].responses
        assert [f.effect for f in response.findings if f.effect != "recalibration"] == wanted
        assert 0.0 < response.significance.limit95 < np.inf  # of the whole search, also where names were taken back


@pytest.mark.parametrize("rows", [1, 2, 3, 4, 5, 7, 12])
@pytest.mark.parametrize("single", [False, True])
def test_tiny_recordings_and_runs_of_a_single_row_hold_no_events(rows, single):
    left = np.random.default_rng(rows).standard_normal(rows)
    run = np.arange(rows) if single else np.zeros(rows, dtype=int)
    made = coloured.autoregression(left, run)
    assert np.isfinite(made.evidence) and made.innovations.size == (0 if single else max(rows - max(rows // 4, 1), 0))
    assert coloured.is_linear_noise(left, run)
