"""Noise of a response: white with a slowly varying share, fitted to the residual of an explanation.

The slow share is a first-order process with a memory (in rows) that restarts with each run; with white noise added it
is an ARMA(1,1) process, which a filter whitens. Share 1 and a memory of many rows is a random walk.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from scipy.special import fdtrc

from errpipe.kernels import noise


class Colour(NamedTuple):
    """memory: correlation length of the slow share, rows; share: its fraction of the noise variance."""

    memory: float
    share: float

    def filter(self) -> tuple[float, float, float]:
        """phi, theta and gain of the filter that whitens noise of unit variance."""
        phi = float(np.exp(-1.0 / self.memory))
        g0 = self.share * (1 - phi**2) + (1.0 - self.share) * (1 + phi**2)
        g1 = phi * (1.0 - self.share)
        theta = (g0 - np.sqrt(max(g0**2 - 4 * g1**2, 0.0))) / (2 * g1)
        return phi, float(theta), float(np.sqrt(g1 / theta))


USUAL = Colour(8.0, 0.06)  # of most measurements (public blind trials: memory 5 to 12, share 0 to 0.12)
MEMORIES = np.geomspace(2.0, 3000.0, 16)  # grid of a fit: memories in rows,
SHARES = (0.06, 0.12, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.87, 0.92, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)  # and shares
MOST_LAGS = 24  # largest order of an autoregression
EVEN_ROWS, EVEN_PARTS = 50, 16  # fewest rows and most parts of a recording for a local noise level
EVENTS = 6.0  # kurtosis of the innovations (Gaussian: 3) from which noise is classed as events
WIDTHS, LEAST_MEANS, MOST_MEANS = (2, 4, 8, 16), 40, 1000  # rows of a mean; fewest and most means compared
COPIES, SEED, NONLINEAR = 199, 0, 4.5  # surrogates; limit of skewness and kurtosis in their standard deviations, which
# 3 of 900 series of white, AR(1) and 1/f noise and random walks (250 to 900 rows) exceed
BUMP = 40.0  # power of half an octave over the smallest of slower ones, from which it is a rhythm: among drifting
# gaps of real repetitions 7 of 8 are below both, among 72 novel mechanisms (three generators, seeds 771 to 773) 8
SLOWEST = 4  # slowest frequencies, pooled: the power of a single one is small by chance
RHYTHM_BY_CHANCE = 1e-3  # p of a rhythm: white and coloured noise of 40 to 4000 rows is below it in at most 3 of 400
BY_CHANCE = 1e-4  # p of levels of runs: white, coloured and 1/f noise and random walks are below it in 0 of 300 each
LEAST_ROWS = 8  # of a spectrum with two half octaves: fewer rows cannot show events or a rhythm
HEAVY = 4.0  # robust standard deviations at which whitened rows are clipped: outliers must not determine the colour


def whiten(columns: np.ndarray, run: np.ndarray, colour: Colour = USUAL) -> np.ndarray:
    """Filter columns (rows,) or (rows, k) so that noise of this colour and unit variance becomes white."""
    flat = columns.ndim == 1
    two = np.ascontiguousarray(columns[:, None] if flat else columns, dtype=float)
    out = noise.whiten(run, two, *colour.filter())
    return out[:, 0] if flat else out


def recolour(columns: np.ndarray, run: np.ndarray, old: Colour, new: Colour) -> np.ndarray:
    """Columns (rows, k) whitened by one colour, whitened by another instead."""
    return noise.whiten(run, noise.unwhiten(run, np.ascontiguousarray(columns), *old.filter()), *new.filter())


def fitted(left: np.ndarray, run: np.ndarray) -> Colour:
    """Maximum-likelihood colour of a residual (rows,)."""
    tried = [USUAL, *(Colour(float(m), s) for m in MEMORIES for s in SHARES)]
    return max(tried, key=lambda colour: _likelihood(left, run, colour))


def _likelihood(left: np.ndarray, run: np.ndarray, colour: Colour) -> float:
    """Log likelihood of a residual in noise of this colour, its variance profiled."""
    white = whiten(left, run, colour)
    most = HEAVY * 1.4826 * float(np.median(np.abs(white))) + 1e-300
    size = float(np.mean(np.clip(white, -most, most) ** 2)) + 1e-300
    return -0.5 * left.size * np.log(size) - scale(colour, run)


def scale(colour: Colour, run: np.ndarray) -> float:
    """Log of the factor by which whitening shrinks a volume of signals: the Jacobian of a colour in a likelihood."""
    return float(np.count_nonzero(run[1:] == run[:-1]) * np.log(colour.filter()[2]))


def correlation_time(left: np.ndarray, run: np.ndarray) -> float:
    """Rows per independent row of a whitened residual: 1 + 2 sum of its autocorrelation while that is positive."""
    centred = left - left.mean()
    power = float(centred @ centred)
    if power <= 0 or left.size < 20:
        return 1.0
    total = 1.0
    for lag in range(1, left.size // 4):
        same = run[lag:] == run[:-lag]
        rho = float(centred[lag:][same] @ centred[:-lag][same]) / power
        if rho < 0.05:
            break
        total += 2 * rho
    return total


class Autoregression(NamedTuple):
    """Noise as a linear process of varying size: innovations (rows,), log likelihood minus its order's penalty."""

    innovations: np.ndarray
    evidence: float

    def has_heavy_tails(self) -> bool:
        """Are the tails of the innovations heavier than those of Gaussian noise (kurtosis)?"""
        centred = self.innovations - np.sum(self.innovations) / max(self.innovations.size, 1)
        return float(np.sum(centred**4)) * centred.size > EVENTS * float(np.sum(centred**2)) ** 2


def autoregression(left: np.ndarray, run: np.ndarray) -> Autoregression:
    """Least-squares autoregression of a residual (rows,) within runs; order by BIC, all orders on the same rows.

    Runs of a single row have no neighbours: they give no innovations and no evidence.
    """
    lengths = np.unique(run, return_counts=True)[1]
    most = int(np.clip(np.median(lengths) // 4, 1, MOST_LAGS))
    rows = np.arange(most, left.size)
    rows = rows[run[rows] == run[rows - most]]
    if not rows.size:
        return Autoregression(np.zeros(0), 0.0)
    lagged = np.column_stack([left[rows - k] for k in range(1, most + 1)])
    products, seen = lagged.T @ lagged, lagged.T @ left[rows]
    products.flat[:: most + 1] = products.diagonal() * (1.0 + 1e-10) + 1e-300
    edges = np.linspace(0, rows.size, int(np.clip(rows.size // EVEN_ROWS, 1, EVEN_PARTS)) + 1).astype(int)
    best = None
    for order in range(most + 1):
        weights = np.linalg.solve(products[:order, :order], seen[:order])
        innovations = left[rows] - lagged[:, :order] @ weights
        squares, count = np.add.reduceat(innovations**2, edges[:-1]), np.diff(edges)
        evidence = -0.5 * float(count @ np.log(squares / count + 1e-300)) - 0.5 * order * np.log(rows.size)
        if best is None or evidence > best.evidence:
            best = Autoregression(innovations, evidence)
    assert best is not None
    return best


def surrogates(values: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Surrogate data (Theiler et al. 1992): series of the same spectrum with random phases, shape (count, rows)."""
    size = np.abs(np.fft.rfft(np.r_[values, values[::-1]]))  # mirrored, so that the ends do not form a step
    return np.fft.irfft(size * np.exp(2j * np.pi * rng.random((count, size.size))), 2 * values.size)[:, : values.size]


def is_nonlinear(left: np.ndarray, run: np.ndarray) -> bool:
    """Are means over 2 to 16 rows, or their increments, more skewed or heavier-tailed than those of linear noise?

    Those of a linear Gaussian process are normal and symmetric at every scale. From row to row, measurement noise
    hides a cause that switches, or builds up and releases. In a long log, means over rows replace the rows.
    """
    parts = [p[0] for p in _means(left[None], run, -(-left.size // MOST_MEANS))]
    if sum(p.size for p in parts) < LEAST_MEANS:
        return False
    run, left = np.repeat(np.arange(len(parts)), [p.size for p in parts]), np.concatenate(parts)
    every = np.vstack([left, surrogates(left - left.mean(), COPIES, np.random.default_rng(SEED))])
    scales = [means for width in WIDTHS if (means := _means(every, run, width))]
    ways = (np.hstack(way) for means in scales for way in (means, [np.diff(m) for m in means]))
    return any(way.shape[1] >= LEAST_MEANS and _stands_out(way) for way in ways)


def _means(every: np.ndarray, run: np.ndarray, width: int) -> list[np.ndarray]:
    """Means of series (k, rows) over so many rows within each run, shape (k, means)."""
    starts = [np.flatnonzero(run == r) for r in np.unique(run)]
    return [every[:, s[: s.size // width * width].reshape(-1, width)].mean(axis=2) for s in starts if s.size >= width]


def _stands_out(values: np.ndarray) -> bool:
    """Is the skewness or kurtosis of the first of some series (series, k) far beyond that of the others?"""
    centred = values - values.mean(axis=1, keepdims=True)
    scaled = centred / (centred.std(axis=1, keepdims=True) + 1e-300)
    skewness, tails = np.mean(scaled**3, axis=1), np.log(np.mean(scaled**4, axis=1) + 1e-300)  # both nearly normal
    heavy = tails[0] - tails[1:].mean() > NONLINEAR * tails[1:].std()
    return bool(heavy or abs(skewness[0]) > NONLINEAR * np.sqrt(np.mean(skewness[1:] ** 2)))


def levels_jump(left: np.ndarray, run: np.ndarray, t: np.ndarray) -> bool:
    """Do the levels of runs differ by more than the drift within runs predicts for the time between them?

    F test of squared differences over the elapsed time (equal for a random walk), between neighbouring runs and between
    the halves of each. Not applied if the clock restarts with each run, because the elapsed time is then unknown.
    """
    runs = [np.flatnonzero(run == r) for r in dict.fromkeys(run.tolist())]
    halves = [np.array_split(rows, 2) for rows in runs if rows.size >= LEAST_ROWS]
    if len(halves) < 3:
        return False
    pairs = [(np.concatenate(a), np.concatenate(b)) for a, b in itertools.pairwise(halves)]
    if any(t[b[0]] <= t[a[-1]] for a, b in pairs):
        return False
    far, near = (
        np.mean([(left[b].mean() - left[a].mean()) ** 2 / max(t[b].mean() - t[a].mean(), 1e-9) for a, b in way])
        for way in (pairs, halves)
    )
    return bool(fdtrc(len(pairs), len(halves), far / max(near, 1e-300)) < BY_CHANCE)


def is_linear_noise(left: np.ndarray, run: np.ndarray) -> bool:
    """Is a residual (rows,) a linear Gaussian process without a rhythm (coloured noise, a random walk)?

    A rhythm is a peak in the spectrum, by half octaves from two periods on.
    """
    if left.size < LEAST_ROWS:
        return True
    return not (autoregression(left, run).has_heavy_tails() or _rhythm(left) or is_nonlinear(left, run))


def _rhythm(left: np.ndarray) -> bool:
    """Does half an octave of the spectrum exceed the smallest of the slower ones significantly?

    F test: the power of few frequencies is small by chance, so the slowest ones are pooled. A Hann window
    correlates neighbours, so that three frequencies count as two.
    """
    power = np.abs(np.fft.rfft((left - left.mean()) * np.hanning(left.size)))[2:] ** 2
    octaves = np.log2(max(power.size / SLOWEST, 2.0))
    edges = np.unique(np.r_[0, np.geomspace(SLOWEST, max(power.size, SLOWEST), int(2 * octaves) + 2).astype(int)])
    level = np.add.reduceat(power, edges[:-1]) / np.diff(edges)
    freedom = np.maximum(2.0 * np.diff(edges) / 1.5, 2.0)
    for k in range(1, level.size):
        least = int(np.argmin(level[:k]))
        rise = level[k] / (level[least] + 1e-300)
        if rise >= BUMP and fdtrc(freedom[k], freedom[least], rise) < RHYTHM_BY_CHANCE:
            return True
    return False
