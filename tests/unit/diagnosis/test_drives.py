"""What simulations of a drive force leave out: inertia, limits, play, friction that grows along the travel."""

from __future__ import annotations

import numpy as np
import pytest

from errpipe.diagnosis import diagnose

from .machines import trace


def answer(change):
    """The first finding and its parameters once `change` was made to the columns of an axis under way."""
    known = trace(1)
    response = diagnose(type(known)(known.manifest, change(known.frame.copy())))[0].responses[0]
    finding = response.findings[0]
    return finding.effect, {p.name: p for p in finding.parameters}, response.holdout.rms_after_um


def no_mass(frame):
    return frame.assign(F_X=frame.F_X + 0.05 * frame.v, F_X_sim=0.05 * frame.v)


def limited(frame):
    return frame.assign(F_X=frame.F_X + frame.F_X_sim.clip(-18, 18) - frame.F_X_sim)


def play(frame):
    return frame.assign(F_X=frame.F_X - frame.F_X_sim.clip(-4, 4))


def tight_end(frame):
    return frame.assign(F_X=frame.F_X + 15 * np.sign(frame.v) * (1 + 0.7 * (frame.x - 200) / 150))


def growing(frame):
    """Guides out of parallel: as simulated in the middle, 24 N more from end to end."""
    return frame.assign(F_X=frame.F_X + 24 * np.sign(frame.v) * ((frame.x - frame.x.min()) / np.ptp(frame.x) - 0.5))


def since_turn(frame):
    """Time since the last reversal in s, long before the first."""
    t, side = frame.t.to_numpy(), np.sign(frame.v.to_numpy())
    turns = np.flatnonzero(np.diff(side) != 0) + 1
    last = np.searchsorted(turns, np.arange(t.size), side="right") - 1
    return np.where(last >= 0, t - t[turns[last]], 1e3)


def sticks(frame):
    """Each reversal breaks away with 25 N more, gone within a tenth of a second."""
    return frame.assign(F_X=frame.F_X + 25 * np.sign(frame.v) * np.exp(-since_turn(frame) / 0.05))


def breaks_away_late(frame):
    """A spike that takes 80 ms to rise."""
    since = since_turn(frame)
    return frame.assign(F_X=frame.F_X + 25 * np.sign(frame.v) * since / 0.08 * np.exp(1 - since / 0.08))


CASES = {
    "moving_mass": (no_mass, "mass", 80.0),
    "saturation": (limited, "limit", 18.0),
    "dead_zone": (play, "threshold", 4.0),
    "friction_gradient": (growing, "growth", 24.0),
    "reversal_spike": (sticks, "height", -25.0),
    "coulomb_friction": (tight_end, "force", 15.0),
}


SLOW = ("saturation", "friction_gradient", "coulomb_friction")  # the others show the same of a force in a second each


@pytest.mark.parametrize("effect", [pytest.param(c, marks=[pytest.mark.slow] if c in SLOW else []) for c in CASES])
def test_named_with_its_size_down_to_the_noise(effect: str) -> None:
    change, name, size = CASES[effect]
    said, output, left = answer(change)
    assert said == effect and left < 2.1  # the noise is 2 N
    assert output[name].value == pytest.approx(size, rel=0.1)


def test_mass_off_by_a_tenth_is_a_recalibration() -> None:
    known = trace(1)
    response = diagnose(type(known)(known.manifest, known.frame.assign(F_X_sim=0.9 * known.frame.F_X_sim)))[0]
    assert response.responses[0].verdict == "recalibrate"


@pytest.mark.slow
def test_a_spike_that_takes_its_time_to_rise_is_a_spike() -> None:
    assert answer(breaks_away_late)[0] == "reversal_spike"


@pytest.mark.parametrize("off", [(0.0, 0.0, 0.12), pytest.param((0.05, -0.1, 0.12), marks=pytest.mark.slow)])
def test_one_coefficient_off_in_a_simulation_that_is_right_elsewhere_is_named(off) -> None:
    known = trace(1)
    frame, side = known.frame, np.sign(known.frame.v)
    held = frame.F_X_sim, 20.0 * side, 0.2 * frame.v
    simulated = sum(held)
    recorded = frame.F_X - frame.F_X_sim + sum((1.0 + by) * part for by, part in zip(off, held, strict=True))
    changed = frame.assign(F_X=recorded, F_X_sim=simulated)
    (response,) = diagnose(type(known)(known.manifest, changed))[0].responses
    assert response.verdict == ("recalibrate" if off[0] else "missing_physics")
    if not off[0]:
        first = response.findings[0]
        assert first.effect == "viscous_friction" and first.confidence <= 0.45  # it may be the gain
        assert first.parameters[0].ci95[0] <= 24.0 <= first.parameters[0].ci95[1]


def test_two_names_of_one_curve_share_the_confidence() -> None:
    """A signal four intervals late has a dead time or another clock: the equations are the same."""
    known = trace(1)
    t, rng = known.frame.t.to_numpy(), np.random.default_rng(5)

    def force(at):
        return -16.224 * np.sin(1.3 * at) - 23.064 * np.sin(3.1 * at) + 9 * np.sin(13.0 * at)

    changed = known.frame.assign(F_X=force(t - 0.0203) + 0.01 * rng.standard_normal(t.size), F_X_sim=force(t))
    first = diagnose(type(known)(known.manifest, changed))[0].responses[0].findings[0]
    assert {first.effect, *first.indistinguishable_from} >= {"dead_time", "clock_offset"}
    assert first.confidence <= 0.6 and (first.confidence_of_class or 0.0) > 0.9


@pytest.mark.parametrize(("quick", "noise"), [(0.0, 0.01), pytest.param(1.0, 0.2, marks=pytest.mark.slow)])
def test_a_dead_time_of_part_of_a_sampling_step_is_named_with_its_size(quick: float, noise: float) -> None:
    """0.3 steps: for straight lines between rows, the curvature would be another effect, such as a mass."""
    known, delay = trace(1), 0.0015
    t, rng = known.frame.t.to_numpy(), np.random.default_rng(5)

    def force(at):
        waves = 15 * np.sin(40 * at) + 10 * np.sin(97 * at + 1)
        return -16.224 * np.sin(1.3 * at) - 23.064 * np.sin(3.1 * at) + quick * waves

    changed = known.frame.assign(F_X=force(t - delay) + noise * rng.standard_normal(t.size), F_X_sim=force(t))
    response = diagnose(type(known)(known.manifest, changed))[0].responses[0]
    first = response.findings[0]
    assert first.effect == "dead_time" and first.confidence > 0.8 and response.rms_after_um < 1.05 * noise
    share, late = first.parameters
    assert share.value == pytest.approx(1.0, abs=0.15) and late.ci95[0] <= delay <= late.ci95[1]
