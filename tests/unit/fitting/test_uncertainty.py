import numpy as np
import pytest
from numpy.testing import assert_allclose

from errpipe.fitting import uncertainty as u
from errpipe.fitting.solve import least_squares
from errpipe.kernels.noise import correlated, innovations


def sequence_of(lengths):
    return np.repeat(np.arange(len(lengths)), lengths)


def dense(sequence, rho, share):
    """The covariance, written out: the second opinion on both kernels."""
    i = np.arange(sequence.size)
    same = sequence[:, None] == sequence[None, :]
    out = np.where(same, share * rho ** np.abs(i[:, None] - i[None, :]).astype(float), 0.0)
    return out + (1 - share) * np.eye(sequence.size)


@pytest.mark.parametrize(("rho", "share"), [(0.0, 0.0), (0.9, 0.4), (0.99, 1.0), (0.5, 0.9)])
def test_filter_and_product_agree_with_the_matrix_written_out(rho, share):
    sequence = sequence_of([5, 1, 12, 7])
    columns = np.random.default_rng(0).normal(size=(25, 3))
    covariance = dense(sequence, rho, share)
    whitened, logdet = innovations(sequence, columns, rho, share)
    assert_allclose(whitened.T @ whitened, columns.T @ np.linalg.solve(covariance, columns), rtol=1e-9)
    assert_allclose(logdet, np.linalg.slogdet(covariance)[1], atol=1e-9)
    assert_allclose(correlated(sequence, columns, rho, share), covariance @ columns, rtol=1e-9)


def draw(rng, sequence, rho, share, sigma=1.0):
    e, state = np.empty(sequence.size), 0.0
    for i in range(sequence.size):
        fresh = i == 0 or sequence[i] != sequence[i - 1]
        state = rng.normal() if fresh else rho * state + np.sqrt(1 - rho**2) * rng.normal()
        e[i] = sigma * (np.sqrt(share) * state + np.sqrt(1 - share) * rng.normal())
    return e


def axis(rng, runs, length):
    """Columns as an axis has them: some change along a run, some only from run to run."""
    sequence = sequence_of([length] * runs)
    x = np.tile(np.linspace(0, 1, length), runs)
    rise = np.repeat(rng.uniform(0, 8, runs), length)
    return sequence, np.column_stack([np.ones(x.size), x, x**2, x * rise, rise])


def coverage(runs, length, rho, share, seeds):
    hits = []
    for seed in range(seeds):
        rng = np.random.default_rng(seed)
        sequence, design = axis(rng, runs, length)
        e = draw(rng, sequence, rho, share, 1.3)
        solution = least_squares(design, e)
        noise = u.noise_model(sequence, design, solution.residual, None)
        spread = u.covariance(sequence, design, solution.inverse, noise, solution.residual)
        freedom = u.degrees_of_freedom(e.size, 5, noise)
        hits.append(np.abs(solution.coefficients) < u.half_width(np.sqrt(np.diag(spread)), freedom))
    return np.mean(hits)


def test_intervals_cover_with_noise_that_remembers():
    assert 0.92 < coverage(9, 60, 0.9, 0.4, seeds=60) < 0.985


@pytest.mark.slow
@pytest.mark.parametrize(("rho", "share"), [(0.0, 0.0), (0.6, 0.5), (0.9, 0.4), (0.95, 0.8)])
def test_intervals_cover_about_95_in_100(rho, share):
    assert 0.93 < coverage(9, 80, rho, share, seeds=200) < 0.98


def test_counting_rows_would_cover_far_too_little():
    """The reason for all this: the same intervals from the number of rows alone."""
    hits = []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        sequence, design = axis(rng, 9, 60)
        solution = least_squares(design, draw(rng, sequence, 0.9, 0.4))
        sigma = np.sqrt(np.sum(solution.residual**2) / (solution.residual.size - 5))
        hits.append(np.abs(solution.coefficients) < 1.96 * sigma * np.sqrt(np.diag(solution.inverse)))
    assert np.mean(hits) < 0.8


def test_runs_that_disagree_widen_the_interval():
    """A slope that differs from run to run, which no noise model of a single run can know."""
    rng = np.random.default_rng(5)
    sequence, design = axis(rng, 12, 60)
    e = draw(rng, sequence, 0.0, 0.0) + np.repeat(rng.normal(0, 5.0, 12), 60) * design[:, 1]
    solution = least_squares(design, e)
    white = u.Noise(1.0, 0.0, 0.0)
    spread = u.covariance(sequence, design, solution.inverse, white, solution.residual)
    assert np.sqrt(spread[1, 1]) > 3 * np.sqrt(solution.inverse[1, 1])


def test_effective_rows():
    sequence = sequence_of([1000])
    assert u.rows_effective(sequence, u.Noise(1.0, 0.0, 0.0)) == 1000
    # n (1 - rho)/(1 + rho) for a long autoregressive series
    assert u.rows_effective(sequence, u.Noise(1.0, 0.8, 1.0)) == pytest.approx(1000 * 0.2 / 1.8, rel=0.02)


def test_white_noise_gets_no_memory_by_chance():
    rng = np.random.default_rng(0)
    sequence, design = axis(rng, 9, 60)
    remembered = 0
    for _ in range(20):
        e = rng.normal(size=sequence.size)
        noise = u.noise_model(sequence, design, least_squares(design, e).residual, None)
        remembered += noise.inflation() > 1.5
    assert remembered <= 3
