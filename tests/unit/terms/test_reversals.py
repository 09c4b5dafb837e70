"""Directions of an axis whose velocity is noisy at rest, and what friction and play do where it turns."""

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.motion import direction, moving
from errpipe.terms.coulomb_friction import CoulombFriction

NOISE = 0.05  # mm/s
STEP = 0.001  # s


def traced(velocity: np.ndarray, noise: float) -> Recording:
    """A log of an axis at 1 kHz; its velocity as measured with a noise of `noise` mm/s rms."""
    read = velocity + np.random.default_rng(5).normal(0.0, noise, velocity.size)
    x = np.cumsum(velocity) * STEP
    columns = {
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "v": Column(role="velocity", axis="X", unit="mm/s"),
        "a": Column(role="acceleration", axis="X", unit="mm/s2"),
        "F_X": Column(role="error", component="F_X", unit="N"),
    }
    a = np.gradient(velocity, STEP)
    frame = pd.DataFrame({"t": np.arange(x.size) * STEP, "x": x, "v": read, "a": a, "F_X": 0.0})
    return Recording(Manifest(recording=1, title="t", machine="m", tables=("t.csv",), columns=columns), frame)


@pytest.fixture
def there_and_back() -> np.ndarray:
    """Forwards, at rest, backwards, at rest, forwards, at rest: 0.6 s each, 10 mm/s."""
    ramp = np.r_[np.linspace(0.0, 10.0, 50), np.full(500, 10.0), np.linspace(10.0, 0.0, 50)]
    rest = np.zeros(600)
    return np.concatenate([ramp, rest, -ramp, rest, ramp, rest])


def test_noise_at_rest_turns_no_axis(there_and_back):
    recording = traced(there_and_back, NOISE)
    assert np.count_nonzero(np.diff(direction(recording, "X"))) == 2
    resting = moving(recording, "v") == 0
    assert resting[there_and_back == 0].mean() > 0.98
    assert not resting[np.abs(there_and_back) > 10 * NOISE].any()


def test_an_exact_velocity_is_taken_as_it_is(there_and_back):
    recording = traced(there_and_back, 0.0)
    assert np.array_equal(moving(recording, "v"), np.sign(there_and_back))


def test_a_velocity_from_row_to_row_unrelated_is_taken_as_it_is():
    v = np.random.default_rng(3).normal(0.0, 10.0, 400)
    assert np.array_equal(moving(traced(v, 0.0), "v"), np.sign(v))


def test_dry_friction_holds_at_rest_and_builds_up_over_some_travel(there_and_back):
    recording = traced(there_and_back, NOISE)
    x, z = recording.array("x"), 1.0
    force = np.empty(x.size)
    for i, step in enumerate(np.diff(x, prepend=x[0])):  # Dahl 1968
        z += step / 0.02 * (1.0 - z * np.sign(step))
        force[i] = 100.0 * z
    term = CoulombFriction(axis="X", column="v")
    base = term.basis(recording, 0.0)
    columns = np.column_stack([base, *(column for column, _ in term.slack(recording, base, 0.0))])
    left = force - columns @ np.linalg.lstsq(columns, force, rcond=None)[0]
    assert left.std() < 0.02 * force.std()
