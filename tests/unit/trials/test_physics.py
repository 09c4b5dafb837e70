"""The lower-level physics against closed forms and known figures."""

import numpy as np
import pytest

from trials.first import bodies, friction
from trials.first.air import index_minus_one, path_error
from trials.first.lookalikes import lagged
from trials.first.servo import follow


def test_an_insulated_bar_keeps_its_heat():
    bar = bodies.bar(10, 0.5, 1e-3, 0.1, 0.0, k=45.0, c=3.7e6)
    power = np.zeros((400, 10))
    power[:100, 2] = 20.0
    warm = bar.respond(10.0, power)
    stored = (warm[-1] * bar.capacity).sum()
    assert stored == pytest.approx(20.0 * 1000.0, rel=1e-6)


def test_the_mode_solution_agrees_with_marching():
    bar = bodies.bar(8, 0.4, 1e-3, 0.1, 20.0, k=45.0, c=3.7e6)
    power = np.zeros((2000, 8))
    power[:, 0] = 15.0
    exact = bar.respond(2.0, power)
    stepped = bar.march(2.0, power, np.zeros(2000, int), {0: bar.air})
    assert np.abs(exact - stepped).max() < 0.01 * exact.max()


def test_a_thin_wall_is_nearly_a_first_order_lag():
    t = np.arange(0, 20000, 10.0)
    surface = np.where(t > 0, 1.0, 0.0)
    thickness, film = 0.03, 20.0
    film_effective = film / (1 + film * thickness / 8 / (2 * bodies.IRON["k"]))
    tau = thickness * bodies.IRON["c"] / film_effective
    assert np.abs(bodies.wall_after(10.0, surface, thickness, film) - (1 - np.exp(-t / tau))).max() < 0.02


def test_air_has_the_known_sensitivities():
    n = float(index_minus_one(np.array(20.0), np.array(1013.25)))
    assert n == pytest.approx(2.714e-4, rel=2e-3)
    warmer = path_error(np.array([1000.0]), np.array([21.0]), np.array([1013.25]), (20.0, 1013.25))[0]
    higher = path_error(np.array([1000.0]), np.array([20.0]), np.array([1014.25]), (20.0, 1013.25))[0]
    assert warmer == pytest.approx(-0.93, abs=0.03)
    assert higher == pytest.approx(0.27, abs=0.01)


def test_friction_saturates_with_the_sign_of_speed_and_dips_with_stribeck():
    t = np.arange(0, 2, 0.002)
    v = 50.0 * np.sign(np.sin(np.pi * t) + 1e-12)
    plain = friction.lugre(t, v, 40.0, 40.0, 3.0, 0.01)
    assert plain[400] == pytest.approx(40.0, rel=1e-3)
    assert plain[900] == pytest.approx(-40.0, rel=1e-3)
    slow = friction.lugre(t, np.full(t.size, 0.1), 40.0, 70.0, 3.0, 0.01)
    assert slow[-1] == pytest.approx(70.0, rel=0.01)


def test_play_follows_only_after_the_gap():
    x = np.concatenate([np.linspace(0, 1, 101), np.linspace(1, 0, 101)])
    state = friction.play(x, 0.1)
    assert state[50] == pytest.approx(1.0)
    assert state[101 + 3] > -1.0
    assert state[-1] == pytest.approx(-1.0)


def test_hysteresis_saturates_and_returns_by_the_other_branch():
    x = np.concatenate([np.linspace(0, 10, 500), np.linspace(10, 0, 500)])
    z = friction.bouc_wen(x, 0.5)
    assert z[499] == pytest.approx(1.0, abs=0.01)
    assert z[-1] == pytest.approx(-1.0, abs=0.01)
    assert -0.9 < z[500 + 20] < 0.9


def test_an_axis_at_constant_speed_trails_by_speed_times_lag():
    t = np.arange(0, 3, 0.005)
    trail = follow(0.005, 100.0 * t, 2e-4, 200.0)
    assert trail[-1] == pytest.approx(-100.0 * 2e-4, rel=1e-6)


def test_the_lag_of_a_ramp_is_the_ramp_one_time_constant_late():
    t = np.array([0.0, 100.0, 350.0, 4000.0, 9000.0])
    late = lagged(t, 0.01 * t, np.array([500.0]))[:, 0]
    assert late == pytest.approx(0.01 * (t - 500.0 * (1 - np.exp(-t / 500.0))), abs=1e-9)
