import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.fitting.separable import Unknown, search

T = np.linspace(0.0, 4.0 * 3600, 600)


def lagged(tau):
    return (1.0 - np.exp(-T / tau))[:, None]


@pytest.mark.parametrize("tau", [90.0, 700.0, 5000.0, 25000.0])
def test_a_time_constant_is_found_wherever_it_lies(tau):
    y = 7.0 * lagged(tau)[:, 0] + 3.0
    match = search(lambda v: lagged(v[0]), np.ones((T.size, 1)), y, [Unknown("tau", 60.0, 30000.0)])
    assert_allclose(match, [tau], rtol=1e-5)


def test_two_time_constants_are_distinguished():
    y = 7.0 * lagged(300.0)[:, 0] - 12.0 * lagged(4000.0)[:, 0] + 0.01 * np.sin(T)
    both = [Unknown("a", 60.0, 30000.0), Unknown("b", 60.0, 30000.0)]
    match = search(lambda v: np.hstack([lagged(v[0]), lagged(v[1])]), np.ones((T.size, 1)), y, both)
    assert_allclose(sorted(match), [300.0, 4000.0], rtol=0.02)


def test_the_right_period_is_found_among_many_valleys():
    x = np.linspace(0.0, 800.0, 1000)
    wave = lambda p: np.column_stack([np.sin(2 * np.pi * x / p), np.cos(2 * np.pi * x / p)])  # noqa: E731
    starts = tuple(1.0 / np.linspace(1 / 50.0, 1 / 2.0, 1500))
    y = wave(7.3) @ [1.0, 0.5]
    match = search(lambda v: wave(v[0]), np.ones((x.size, 1)), y, [Unknown("period", 2.0, 50.0, starts)])
    assert_allclose(match, [7.3], rtol=1e-6)


def test_bounds_hold_and_noise_does_not_break_them():
    y = 7.0 * lagged(20.0)[:, 0]
    match = search(lambda v: lagged(v[0]), np.ones((T.size, 1)), y, [Unknown("tau", 60.0, 30000.0)])
    assert 60.0 <= match[0] < 61.0
