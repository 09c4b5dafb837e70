"""The noise floor: the noise, from repeats where there are some, and never above what it is part of."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.fitting.noise_floor import noise_floor, noise_of_twin, rounding

COLUMNS = {
    "run": Column(role="run"),
    "d": Column(role="direction", axis="X"),
    "x": Column(role="position", axis="X", unit="mm"),
    "e": Column(role="error", component="EXX", unit="um"),
}


def bidirectional(runs: int, targets: int = 21) -> Recording:
    up = np.linspace(0, 600, targets)
    rows = [(str(r), s, x) for r in range(runs) for s in (1.0, -1.0) for x in (up if s > 0 else up[::-1])]
    frame = pd.DataFrame(rows, columns=["run", "d", "x"]).assign(e=0.0)
    return Recording(Manifest(recording=1, tables=("t.csv",), columns=COLUMNS), frame)


@pytest.mark.parametrize("seed", range(4))
def test_repeats_across_runs_tell_noise_from_a_shape_that_no_model_took(seed: int) -> None:
    """Each target once a run and direction, and a wave of three targets a period left: 0.3 um of noise beside 2 um."""
    data = bidirectional(5)
    noise = 0.3 * np.random.default_rng(seed).normal(size=len(data))
    left = noise + 2.0 * np.sin(2 * np.pi * data.array("x") / 90.0)
    assert noise_floor(data, np.arange(len(data)), left) == pytest.approx(0.3, rel=0.25)


@pytest.mark.parametrize("seed", range(4))
def test_runs_that_differ_are_not_taken_for_noise(seed: int) -> None:
    """Runs 5 um apart in level: second differences within each run know better."""
    data = bidirectional(6)
    noise = 0.3 * np.random.default_rng(seed).normal(size=len(data))
    left = noise + 5.0 * (data.run_codes() % 3)
    assert noise_floor(data, np.arange(len(data)), left) == pytest.approx(0.3, rel=0.3)


def test_it_is_never_above_the_residual() -> None:
    data = bidirectional(5)
    for seed in range(30):
        values = np.random.default_rng(seed).standard_t(3, size=len(data))
        values[::2] *= -1.0
        assert noise_floor(data, np.arange(len(data)), values) <= np.sqrt(np.mean(values**2)) + 1e-12


@pytest.mark.parametrize("seed", range(4))
def test_a_coarse_display_does_not_hide_the_noise_in_repeats_that_read_alike(seed: int) -> None:
    """A dial gauge of 10 um that repeats within 1 um: whoever predicts its readings is 10 / sqrt(12) um off."""
    data = bidirectional(8)
    true = 0.05 * data.array("x") + np.random.default_rng(seed).normal(0.0, 1.0, len(data))
    shown = 10.0 * np.round(true / 10.0)
    floor = noise_floor(data, np.arange(len(data)), shown - true, shown)
    assert floor == pytest.approx(10.0 / 12.0**0.5, rel=0.1)
    assert noise_floor(data, np.arange(len(data)), shown - true) < 2.0


def test_readings_without_steps_have_no_rounding() -> None:
    random = np.random.default_rng(1).normal(0.0, 5.0, 400)
    assert rounding(random) == 0.0
    assert rounding(np.round(random, 1) + 0.03) == pytest.approx(0.1 / 12.0**0.5)
    assert rounding(np.array([1.0, 2.0, 3.0])) == 0.0  # too few to tell
    assert rounding(np.full(50, 7.0)) == 0.0


def test_noise_of_a_twin_is_what_smooth_leaves_of_it():
    rng = np.random.default_rng(0)
    true = 30.0 * np.sin(np.arange(400) / 40.0)
    recorded, twin = true + rng.standard_normal((2, 400))
    noise = noise_of_twin(twin, recorded - twin, np.zeros(400, dtype=int))
    assert noise is not None
    assert np.corrcoef(noise, twin - true)[0, 1] > 0.9


@pytest.mark.parametrize(("gain", "rounded"), [(1.0, 0.0), (0.85, 0.0), (1.0, 0.01)])
def test_a_computed_signal_has_no_noise_of_its_own(gain, rounded):
    """A gain that is off and steps of a file show in second differences, too, but by less."""
    rng = np.random.default_rng(1)
    simulated = 30.0 * np.sin(np.arange(400) / 40.0) + 5.0 * np.sign(np.sin(np.arange(400) / 7.0))
    simulated = np.round(simulated / rounded) * rounded if rounded else simulated
    mismatch = (gain - 1.0) * simulated + 0.3 * rng.standard_normal(400)
    assert noise_of_twin(simulated, mismatch, np.zeros(400, dtype=int)) is None


def test_steps_that_are_missing_are_no_noise_of_a_simulation():
    """A step with the wrong sign gives second differences a slope of -2, but only in the rows beside the steps."""
    rng = np.random.default_rng(2)
    steps = 5.0 * np.sign(np.sin(np.arange(400) / 7.0))
    simulated = 30.0 * np.sin(np.arange(400) / 40.0) + steps
    mismatch = -2.0 * steps + 0.3 * rng.standard_normal(400)
    assert noise_of_twin(simulated, mismatch, np.zeros(400, dtype=int)) is None
