"""Directions of an axis whose velocity is noisy at rest, and what friction and play do where it turns."""

import numpy as np
import pandas as pd
import pytest

from errpipe.domain.driver import Approach
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.motion import direction, motion_sessions, moving
from errpipe.kernels import responses
from errpipe.terms.backlash import Backlash
from errpipe.terms.coulomb_friction import CoulombFriction
from errpipe.terms.friction_gradient import FrictionGradient
from errpipe.terms.friction_hysteresis import FrictionHysteresis
from errpipe.terms.reversal_spike import ReversalSpike

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


def in_runs(positions: list[np.ndarray]) -> Recording:
    """Runs of an axis at 1 kHz with pauses of 20 s between them."""
    columns = {
        "run": Column(role="run"),
        "t": Column(role="time", unit="s"),
        "x": Column(role="position", axis="X", unit="mm"),
        "v": Column(role="velocity", axis="X", unit="mm/s"),
        "EXX": Column(role="error", component="EXX", unit="um"),
    }
    parts = [
        {"run": k, "t": 20.0 * k + np.arange(x.size) * STEP, "x": x, "v": np.gradient(x, STEP), "EXX": 0.0}
        for k, x in enumerate(positions)
    ]
    frame = pd.concat([pd.DataFrame(p) for p in parts], ignore_index=True)
    return Recording(Manifest(recording=1, title="t", machine="m", tables=("t.csv",), columns=columns), frame)


def test_a_run_that_begins_under_way_comes_from_the_side_it_leaves():
    there = np.linspace(0.0, 1.0, 500)
    recording = in_runs([there, there[::-1]])  # a circle each way: the second begins where the first one ends
    assert motion_sessions(recording)[-1] > motion_sessions(recording)[0]
    z = drive(Approach(axis="X", length=0.2), recording)
    assert np.array_equal(z, np.repeat([1.0, -1.0], 500))


def test_a_run_that_begins_at_rest_goes_on():
    there = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 500))
    recording = in_runs([there, there[::-1]])
    assert np.ptp(motion_sessions(recording)) == 0
    z = drive(Approach(axis="X", length=0.2), recording)
    assert z[500] > 0.99 and z[-1] < -0.95


@pytest.mark.parametrize(("travel", "least", "most"), [(0.002, 0.0, 0.2), (0.5, 0.4, 1.0)])
def test_a_gap_plays_no_hysteresis_of_long_travel(travel, least, most):
    x = 20.0 * np.cos(np.linspace(0.1, 6 * np.pi + 0.1, 2400))
    recording = in_runs([x])
    y = drive(Approach(axis="X", length=travel), recording)
    term = Backlash(axis="X")
    base = term.basis(recording)
    slack = [column for column, freedom in term.slack(recording, base) if freedom > 0.5]
    columns = np.column_stack([base, *slack])
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    beside = y - base[:, 0] * (base[:, 0] @ y) / (base[:, 0] @ base[:, 0])
    assert least < left.std() / beside.std() < most


def test_a_spike_rises_over_travel_whatever_the_feed():
    angle = np.linspace(0.1, 6 * np.pi + 0.1, 3000)
    recording = in_runs([-10.0 * np.cos(angle), -60.0 * np.cos(angle)])
    z = drive(Approach(axis="X", length=0.02), recording)  # bristles bend, and the loop pulls the axis back
    y = z - responses.lag(recording.run_codes(), recording.time(), z, 0.04, 0.04, True)
    term = ReversalSpike(axis="X")
    base = term.basis(recording, 0.04)
    columns = np.column_stack([base, *(column for column, _ in term.slack(recording, base, 0.04))][:4])
    left = y - columns @ np.linalg.lstsq(columns, y, rcond=None)[0]
    assert left.std() < 0.1 * y.std()


def test_a_contact_may_start_anywhere_between_its_two_sides():
    """A log starts after a short move: until the first reversal the friction builds up from an unknown state."""
    recording = in_runs([-10.0 * np.cos(np.linspace(0.1, 6 * np.pi + 0.1, 3000))])
    x, d = recording.array("x"), direction(recording, "X")
    z = np.zeros(x.size)
    for i in range(1, x.size):
        z[i] = d[i] - (d[i] - z[i - 1]) * np.exp(-abs(x[i] - x[i - 1]) / 3.0)
    term = FrictionHysteresis(axis="X")
    base = term.basis(recording, 3.0)
    columns = np.column_stack([base, *(column for column, _ in term.slack(recording, base, 3.0))][:4])
    left = z - columns @ np.linalg.lstsq(columns, z, rcond=None)[0]
    assert left.std() < 0.01 * z.std()


def test_a_mass_that_brakes_harder_than_its_friction_runs_on_across_the_gap(there_and_back):
    recording = traced(there_and_back, 0.0)  # it brakes at 204 mm/s2
    plain = Backlash(axis="X").basis(recording)[:, 0]
    heavy = Backlash(axis="X", column="a").basis(recording, 500.0)[:, 0]  # friction brakes harder than the drive
    light = Backlash(axis="X", column="a").basis(recording, 100.0)[:, 0]
    assert np.array_equal(heavy[1:], plain[1:])
    braking = np.arange(plain.size) % 1200 // 600 == 0
    braking &= np.arange(plain.size) % 600 > 552
    assert np.array_equal(light[braking & (there_and_back != 0)], -plain[braking & (there_and_back != 0)])
    assert np.array_equal(light[700:1100], -plain[700:1100])  # at rest it stays on the side where it came to lie


def test_friction_that_grows_along_the_axis(there_and_back):
    recording = traced(there_and_back, 0.0)
    (term,) = FrictionGradient.bind(recording, "F_X")
    x = recording.array("x")
    assert term.length == pytest.approx(np.ptp(x))
    expected = np.sign(there_and_back) * (x - 0.5 * (x.min() + x.max())) / np.ptp(x)
    assert np.allclose(term.basis(recording)[:, 0], expected)
