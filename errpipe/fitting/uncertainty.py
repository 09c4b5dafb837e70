"""Uncertainty of parameters if neighbouring rows share their noise.

Rows of a machine's log are not independent: the noise is autocorrelated, and the lack of fit of a model
repeats within a run. Intervals from the number of rows are several times too narrow. Two estimates:

* noise model: white plus first-order autoregressive noise within each run, its two shape parameters by restricted
  likelihood (which, unlike the autocorrelation of residuals, does not forget that p parameters were fitted);
* runs: the sandwich over runs, which assumes nothing about the noise within one, if there are enough runs.

The noise model's covariance is used; if the runs disagree by clearly more than their own uncertainty (lack of
fit), the larger of the two.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logit

from errpipe.fitting.simplex import minimum
from errpipe.fitting.solve import one_thread
from errpipe.fitting.statistics import chi2_quantile, student_quantile
from errpipe.kernels.noise import correlated, innovations

RHO = (0.3, 0.6, 0.8, 0.9, 0.95, 0.98, 0.995)  # starting points of the search: correlation of neighbouring rows,
SHARE = (0.1, 0.3, 0.6, 0.9, 0.999)  # and the share of the noise that is correlated
MAX_ROWS = 20_000  # rows the noise model is fitted to; further ones change its third digit
MIN_RUNS = 6  # runs needed to estimate their spread


@dataclass(frozen=True)
class Noise:
    """Standard deviation, and the share of the variance that is correlated by `rho` from row to row."""

    sigma: float
    rho: float
    share: float

    def inflation(self) -> float:
        """Rows per independent row, for a mean over a long run."""
        return 1.0 + 2.0 * self.share * self.rho / (1.0 - self.rho)


def noise_model(sequence: np.ndarray, jacobian: np.ndarray, residual: np.ndarray, penalty: np.ndarray | None) -> Noise:
    """Restricted maximum likelihood (REML) of the noise of a least-squares residual.

    sequence: integer per row, (n,); jacobian: (n, p); residual: (n,), of fitting p parameters; penalty: (p, p).
    """
    if residual.size > MAX_ROWS:
        sequence, jacobian, residual = _some_rows(sequence, jacobian, residual)
    both = np.column_stack([jacobian / _length(jacobian), residual])
    scaled = None if penalty is None else penalty / np.outer(_length(jacobian), _length(jacobian))

    def cost(rho: float, share: float) -> tuple[float, float]:
        whitened, logdet = innovations(sequence, both, min(rho, 0.9999), min(share, 0.9999))
        return _restricted(whitened, logdet, scaled)

    with one_thread():
        white = cost(0.0, 0.0)
        if not np.isfinite(white[0]):
            return Noise(float(np.sqrt(np.mean(residual**2))), 0.0, 0.0)
        start = min((cost(r, s)[0], r, s) for r in RHO for s in SHARE)
        found, least = minimum(
            lambda v: cost(float(expit(v[0])), float(expit(v[1])))[0], logit(start[1:]), near=0.02, alike=1e-3, most=79
        )
        rho, share = min(float(expit(found[0])), _longest_memory(sequence)), float(expit(found[1]))
        # Two more parameters must improve the fit, or white noise would get a memory by chance.
        if white[0] - least < 1.0:
            rho, share = 0.0, 0.0
        return Noise(cost(rho, share)[1], rho, share)


def _longest_memory(sequence: np.ndarray) -> float:
    """A memory beyond a quarter of a run cannot be distinguished from a trend in it: rho is capped there."""
    lengths = np.unique(sequence, return_counts=True)[1]
    return min(0.9995, max(0.9, 1.0 - 4.0 / float(lengths.max())))


def _restricted(whitened: np.ndarray, logdet: float, penalty: np.ndarray | None) -> tuple[float, float]:
    """(minus log restricted likelihood, sigma) of whitened [jacobian | residual]."""
    design, response = whitened[:, :-1], whitened[:, -1]
    gram = design.T @ design if penalty is None else design.T @ design + penalty
    values, vectors = np.linalg.eigh(gram)
    keep = values > 1e-12 * max(values.max(initial=0.0), 1e-300)
    inner = (vectors[:, keep].T @ (design.T @ response)) ** 2 / values[keep]
    degrees = response.size - int(keep.sum())
    if degrees < 3:
        return np.inf, np.nan
    left = max(float(response @ response) - float(inner.sum()), 1e-300)
    return 0.5 * (degrees * np.log(left / degrees) + logdet + float(np.log(values[keep]).sum())), np.sqrt(
        left / degrees
    )


def _some_rows(sequence, jacobian, residual):
    """Whole sequences, spread over the recording, up to MAX_ROWS; a part of the first if one is longer."""
    starts = np.flatnonzero(np.r_[True, sequence[1:] != sequence[:-1]])
    ends = np.r_[starts[1:], sequence.size]
    chosen, count = np.zeros(sequence.size, dtype=bool), 0
    for k in np.argsort([(7 * i) % 97 for i in range(starts.size)], kind="stable"):
        take = min(ends[k] - starts[k], MAX_ROWS - count)
        chosen[starts[k] : starts[k] + take] = True
        count += take
        if count >= MAX_ROWS:
            break
    return sequence[chosen], jacobian[chosen], residual[chosen]


def _length(jacobian: np.ndarray) -> np.ndarray:
    length = np.sqrt(np.sum(jacobian**2, axis=0))
    return np.where(length > 0, length, 1.0)


def covariance(
    sequence: np.ndarray,
    jacobian: np.ndarray,
    inverse: np.ndarray,
    noise: Noise,
    scores: np.ndarray,
    penalty: np.ndarray | None = None,
) -> np.ndarray:
    """Covariance of the parameters, shape (p, p).

    inverse: (J'J + penalty)^-1 of the solve; scores: residuals in the last step, (n,), zero if a
    robust solve rejected the row. The bias due to a penalty is included (Nychka 1988): without it intervals
    of a smooth curve would be too narrow.
    """
    with one_thread():
        spread = noise.sigma**2 * (jacobian.T @ correlated(sequence, jacobian, noise.rho, noise.share))
        if penalty is not None:
            spread = spread + noise.sigma**2 * noise.inflation() * penalty
        modelled = inverse @ spread @ inverse
        runs, middle = between_runs(sequence, jacobian, scores)
        return larger(modelled, inverse @ middle @ inverse, runs)


def larger(modelled: np.ndarray, seen: np.ndarray, runs: int) -> np.ndarray:
    """The noise model's covariance, widened if `runs` runs disagree significantly; (p, p)."""
    if runs < MIN_RUNS:
        return modelled
    ratio = np.sqrt(np.maximum(np.diag(seen), 0.0) / np.maximum(np.diag(modelled), 1e-300) * runs / (runs - 1))
    doubt = np.sqrt(chi2_quantile(0.95, runs - 1) / (runs - 1))
    factor = np.where(ratio > doubt, ratio, 1.0)
    return modelled * np.outer(factor, factor)


def between_runs(sequence: np.ndarray, jacobian: np.ndarray, scores: np.ndarray) -> tuple[int, np.ndarray]:
    """(number of runs, sum over runs of the outer square of jacobian' scores), which adds up over chunks."""
    order = np.argsort(sequence, kind="stable")
    starts = np.flatnonzero(np.r_[True, np.diff(sequence[order]) != 0])
    pulls = np.add.reduceat(jacobian[order] * scores[order, None], starts, axis=0)
    return starts.size, pulls.T @ pulls


def rows_effective(sequence: np.ndarray, noise: Noise) -> float:
    """Effective number of independent rows, for a mean: n over the sum of the autocorrelation."""
    return effective_rows(np.unique(sequence, return_counts=True)[1], noise)


def effective_rows(rows_of_runs: np.ndarray, noise: Noise) -> float:
    """`rows_effective` from the number of rows of each run, (runs,)."""
    lengths = rows_of_runs.astype(float)
    if noise.rho <= 0.0 or noise.share <= 0.0:
        return float(lengths.sum())
    r = noise.rho
    tail = 2 * noise.share * r / (1 - r) * (1 - (1 - r**lengths) / (lengths * (1 - r)))
    return float(np.sum(lengths / (1.0 + tail)))


def degrees_of_freedom(rows: int, parameters: float, noise: Noise) -> float:
    """Degrees of freedom of `noise.sigma`: rows over the sum of the squared autocorrelation, minus parameters."""
    memory = 1.0 + 2.0 * (noise.share * noise.rho) ** 2 / (1.0 - noise.rho**2)
    return max((rows - parameters) / memory, 2.0)


def half_width(standard_error: np.ndarray | float, degrees: float) -> np.ndarray | float:
    """Half width of a parameter's 95 % interval with `degrees` of freedom of its noise."""
    return standard_error * student_quantile(0.975, max(degrees, 2.0))
