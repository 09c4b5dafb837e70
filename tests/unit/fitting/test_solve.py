import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.fitting import solve


def problem(seed=0, rows=400, columns=5, noise=0.5):
    rng = np.random.default_rng(seed)
    design = rng.normal(size=(rows, columns))
    truth = np.arange(1.0, columns + 1)
    return design, truth, design @ truth + rng.normal(0, noise, rows)


def test_equals_lstsq_whatever_the_units_of_the_columns():
    design, _, y = problem()
    units = np.array([1e-9, 1e-3, 1.0, 1e4, 1e9])
    solution = solve.least_squares(design * units, y)
    assert_allclose(solution.coefficients * units, np.linalg.lstsq(design, y, rcond=None)[0], rtol=1e-12)
    assert solution.degrees == pytest.approx(5) and solution.rank == 5


def test_inverse_is_that_of_the_weighted_normal_matrix():
    design, _, y = problem()
    weights = np.linspace(0.1, 2.0, y.size)
    solution = solve.least_squares(design, y, weights=weights)
    assert_allclose(solution.inverse, np.linalg.inv(design.T @ (weights[:, None] * design)), rtol=1e-9, atol=1e-15)


def test_a_direction_never_seen_stays_zero():
    design, _, y = problem()
    solution = solve.least_squares(np.column_stack([design, design[:, 0]]), y)
    assert solution.rank == 5
    assert_allclose(solution.coefficients[0], solution.coefficients[5], rtol=1e-9)


def test_a_prior_pulls_as_much_as_its_precision():
    # One column of ones: the posterior mean of a normal level is the precision-weighted mean.
    y = np.array([10.0, 12.0, 14.0, 16.0])
    solution = solve.least_squares(np.ones((4, 1)), y, priors=[solve.Prior(0, 3.0, 0.5)], noise=2.0)
    expected = (4 * 13.0 / 4.0 + 3.0 / 0.25) / (4 / 4.0 + 1 / 0.25)
    assert_allclose(solution.coefficients, [expected])


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_robust_sets_outliers_aside(loss):
    design, truth, y = problem(rows=600)
    y[::12] += 60.0
    plain = np.abs(solve.least_squares(design, y).coefficients - truth).max()
    solution = solve.robust(design, y, loss=loss)
    assert np.abs(solution.coefficients - truth).max() < 0.15 < plain
    assert solution.weights[::12].max() < (0.05 if loss == "huber" else 1e-6)


def test_robust_loses_little_on_clean_rows():
    misses = []
    for seed in range(40):
        design, truth, y = problem(seed, rows=200)
        a, b = solve.least_squares(design, y).coefficients, solve.robust(design, y).coefficients
        misses.append([np.sum((a - truth) ** 2), np.sum((b - truth) ** 2)])
    plain, robust = np.mean(misses, axis=0)
    assert robust < 1.25 * plain  # 95 % efficient: 1.05 in the long run


def test_ridge_beats_least_squares_on_twins():
    rng = np.random.default_rng(3)
    base = rng.normal(size=(60, 1))
    design = np.column_stack([np.ones(60), base + 0.01 * rng.normal(size=(60, 6))])
    truth = np.r_[4.0, np.full(6, 0.5)]
    y = design @ truth + rng.normal(0, 1.0, 60)
    fresh = np.column_stack([np.ones(500), rng.normal(size=(500, 1)) + 0.05 * rng.normal(size=(500, 6))])
    shrunk = np.r_[False, np.ones(6, dtype=bool)]
    folds = [(np.arange(60) % 5 != k, np.arange(60) % 5 == k) for k in range(5)]
    errors = {}
    for name, match in {
        "plain": solve.least_squares(design, y),
        "gcv": solve.ridge(design, y, shrunk),
        "held-out": solve.ridge(design, y, shrunk, folds=folds),
    }.items():
        errors[name] = np.sqrt(np.mean((fresh @ (match.coefficients - truth)) ** 2))
    assert errors["gcv"] < errors["plain"] and errors["held-out"] < errors["plain"]


def test_ridge_does_not_depend_on_units():
    design, _, y = problem(rows=50)
    shrunk = np.ones(5, dtype=bool)
    units = np.array([1e-3, 1.0, 10.0, 1e3, 1e6])
    one, other = solve.ridge(design, y, shrunk), solve.ridge(design * units, y, shrunk)
    assert_allclose(other.coefficients * units, one.coefficients, rtol=1e-8)


def curve(rows, noise, seed, shape):
    from errpipe.terms import Curve

    rng = np.random.default_rng(seed)
    x = np.linspace(0.0, 500.0, rows)
    profile = Curve(segments=30, span=(0.0, 500.0))
    design = np.column_stack([np.ones(rows), profile.basis(x)])
    penalty = np.zeros((design.shape[1],) * 2)
    penalty[1:, 1:] = profile.penalty()
    exact = shape(x)
    return design, penalty, exact, exact + rng.normal(0, noise, rows)


def test_smoothing_finds_the_curve_and_leaves_the_noise():
    design, penalty, exact, y = curve(400, 1.0, 0, lambda x: 8 * np.sin(x / 60.0))
    solution = solve.penalised(design, y, [penalty])
    assert np.sqrt(np.mean((design @ solution.coefficients - exact) ** 2)) < 0.3
    assert 8 < solution.degrees < 25


def test_smoothing_a_line_needs_about_two_parameters():
    degrees = []
    for seed in range(10):
        design, penalty, _, y = curve(400, 1.0, seed, lambda x: 0.02 * x)
        degrees.append(solve.penalised(design, y, [penalty]).degrees)
    assert np.median(degrees) < 3.0


def test_ridge_leaves_out_folds_that_hold_no_usable_row():
    """A run whose sensor was blanked throughout: `run` ended with an internal error."""
    rng = np.random.default_rng(2)
    design, shrunk = rng.normal(size=(40, 2)), np.ones(2, dtype=bool)
    response = design @ np.array([1.0, 2.0]) + 0.1 * rng.normal(size=40)
    half = np.arange(40) < 20
    folds, empty = [(half, ~half), (~half, half)], (np.ones(40, dtype=bool), np.zeros(40, dtype=bool))
    assert_allclose(
        solve.ridge(design, response, shrunk, folds=[*folds, empty]).coefficients,
        solve.ridge(design, response, shrunk, folds=folds).coefficients,
    )
