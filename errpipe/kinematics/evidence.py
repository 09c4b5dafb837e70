"""Bayesian linear regression: ridge penalties (prior variances) estimated from the readings by marginal likelihood.

Readings y = A theta + noise. Parameter i is a priori N(0, s_i^2) with s_i = size[family_i] * rough_i^-power, or of a
fixed spread (family -1: set-up). Sizes, power and noise maximise the marginal likelihood times weak log-normal
priors about typical values, so that a poorly constrained family stays near its typical value.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky
from scipy.linalg.lapack import dtrtri
from scipy.optimize import minimize

ROUGHER, ROUGH_POWER = 2.0, 1.5  # second start of the search: log of sizes over typical ones; smoothness power


@dataclass(frozen=True)
class Spreads:
    """family (p,): number of the family, -1 for those with `fixed` (p,); rough (p,): relative wave number, 1 if none.

    typical, certainty: value and spread of the logarithm of (size by family..., power, noise).
    """

    family: np.ndarray
    rough: np.ndarray
    fixed: np.ndarray
    typical: np.ndarray
    certainty: np.ndarray

    def of(self, hyper: np.ndarray) -> np.ndarray:
        """Prior standard deviation of each parameter, (p,)."""
        sizes, power = hyper[:-2], hyper[-2]
        return np.where(self.family < 0, self.fixed, sizes[np.maximum(self.family, 0)] * self.rough**-power)

    def take(self, columns: np.ndarray) -> Spreads:
        """A selection of the parameters."""
        return replace(self, **{n: getattr(self, n)[columns] for n in ("family", "rough", "fixed")})


@dataclass(frozen=True)
class Moments:
    """Sufficient statistics of the readings: A'A, A'y, y'y and their number."""

    gram: np.ndarray
    cross: np.ndarray
    square: float
    count: int

    @classmethod
    def of(cls, design: np.ndarray, y: np.ndarray) -> Moments:
        """Moments of a weighted design and its readings."""
        return cls(design.T @ design, design.T @ y, float(y @ y), len(y))


def _whitened(spreads: Spreads, moments: Moments, hyper: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Prior standard deviation, Cholesky factor of the whitened normal matrix (unit prior), whitened solution."""
    spread = spreads.of(hyper)
    noise2 = hyper[-1] ** 2
    m = moments.gram * (spread[:, None] * spread / noise2)
    m[np.diag_indices_from(m)] += 1.0
    factor = cholesky(m, lower=True, check_finite=False)
    return spread, factor, cho_solve((factor, True), moments.cross * spread / noise2, check_finite=False)


def solve(spreads: Spreads, moments: Moments, hyper: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Posterior mean and covariance of the parameters."""
    spread, factor, u = _whitened(spreads, moments, hyper)
    half = dtrtri(factor, lower=1)[0] * spread
    return spread * u, half.T @ half


def estimate(spreads: Spreads, moments: Moments, known: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
    """Sizes by family, power and noise. known: NaN if estimated. start: initial values of the search.

    With u the whitened solution and M its normal matrix, the gradient of the cost by log(spread_i) is
    1 - u_i^2 - (M^-1)_ii, and by log(noise) the count minus the expected residual sum over noise^2.
    """
    free = np.isnan(known)
    if not free.any():
        return known
    centre = np.log(spreads.typical)
    families = len(centre) - 2
    rough = np.log(spreads.rough)

    def unpack(v: np.ndarray) -> np.ndarray:
        full = np.where(free, 0.0, np.log(np.where(free, 1.0, known)))
        full[free] = v
        return np.exp(full)

    def cost(v: np.ndarray) -> tuple[float, np.ndarray]:
        hyper = unpack(v)
        noise2 = hyper[-1] ** 2
        standardised = (v - centre[free]) / spreads.certainty[free]
        try:
            spread, factor, u = _whitened(spreads, moments, hyper)
        except LinAlgError:
            return 1e30, standardised
        # (M^-1)_ii = sum_k (L^-1)_ki^2: the inverse of the factor costs a sixth of that of M
        posterior_variance = np.sum(dtrtri(factor, lower=1)[0] ** 2, axis=0)
        fit = (moments.square - u @ (moments.cross * spread)) / noise2
        value = (
            0.5 * fit
            + np.log(np.diag(factor)).sum()
            + moments.count * np.log(hyper[-1])
            + 0.5 * standardised @ standardised
        )
        by_spread = np.where(spreads.family < 0, 0.0, 1.0 - u**2 - posterior_variance)
        slope = np.zeros(len(centre))
        slope[:families] = np.bincount(np.maximum(spreads.family, 0), weights=by_spread, minlength=families)
        slope[-2] = -hyper[-2] * (by_spread @ rough)
        slope[-1] = moments.count - (fit - u @ u) - (len(u) - posterior_variance.sum())
        return value, slope[free] + standardised / spreads.certainty[free]

    def search(first: np.ndarray) -> tuple[float, np.ndarray]:
        limits = [(c - 6, c + 6) for c in centre[:-2]] + [(np.log(1.2), np.log(6.0)), (first[-1] - 4, first[-1] + 4)]
        bounds = [limit for limit, f in zip(limits, free, strict=True) if f]
        result = minimize(cost, first[free], jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 60})
        return float(result.fun), result.x

    if start is not None:
        return unpack(search(np.log(start))[1])
    smooth, rough_curve = centre.copy(), centre.copy()
    rough_curve[:-2] += ROUGHER
    rough_curve[-2] = np.log(ROUGH_POWER)
    for first in (smooth, rough_curve):
        first[-1] = np.log(_residual(spreads, moments, unpack(first[free])))
    best = search(smooth)
    if cost(rough_curve[free])[0] < best[0]:  # a short wave: the smooth start has no gradient towards it
        best = min(best, search(rough_curve), key=lambda one: one[0])
    return unpack(best[1])


def _residual(spreads: Spreads, moments: Moments, hyper: np.ndarray) -> float:
    """Rms residual with typical sizes: initial value of the noise."""
    mean, _ = solve(spreads, moments, hyper)
    residual_square = moments.square - 2 * mean @ moments.cross + mean @ moments.gram @ mean
    return float(np.sqrt(max(residual_square, 1e-12 * moments.square + 1e-18) / moments.count))
