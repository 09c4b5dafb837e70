"""How much better data are explained with a hypothesis than without: marginal likelihood in coloured noise.

Model of a response on n rows:  y = N b + H w + e.  N holds nuisances (datum, gains of what the simulation
already knows) with Gaussian priors, H a hypothesis' columns, w ~ Normal(0, (a s)^2), s the columns' relative
freedom (1 for the textbook form, less for how far reality strays from it), a its unknown size, averaged over
a grid. e is white noise with a small slowly varying share; an ARMA(1,1) filter makes it white. The noise
variance is profiled. A hypothesis pays for every column and for every size that does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import lfilter

MEMORY = 8.0  # rows over which the slow share of the noise forgets (public blind trials: 5 to 12)
SIZES = np.geomspace(0.15, 600.0, 14)  # sizes tried, in units of the noise


@dataclass(frozen=True)
class Noise:
    """sigma: rms of the noise; share: part of its variance that varies slowly (0..0.5)."""

    sigma: float
    share: float = 0.06

    def whiten(self, columns: np.ndarray, run: np.ndarray) -> np.ndarray:
        """Columns (rows,) or (rows, k) filtered so that the noise becomes white with unit variance."""
        if self.share <= 1e-6:
            return columns / self.sigma
        phi = np.exp(-1.0 / MEMORY)
        white = 1.0 - self.share
        g0 = self.share * (1 - phi**2) + white * (1 + phi**2)
        g1 = phi * white
        theta = (g0 - np.sqrt(max(g0**2 - 4 * g1**2, 0.0))) / (2 * g1)
        gain = np.sqrt(g1 / theta)
        out = np.empty_like(columns, dtype=float)
        for rows in stretches(run):
            filtered = lfilter([1.0, -phi], [1.0, -theta], columns[rows], axis=0)
            filtered[0] = columns[rows][0] * gain  # the first row has no past
            out[rows] = filtered
        return out / (self.sigma * gain)


def stretches(run: np.ndarray) -> list[slice]:
    """Slices of rows that follow each other in one run."""
    edges = np.flatnonzero(np.diff(run)) + 1
    return [slice(a, b) for a, b in zip(np.r_[0, edges], np.r_[edges, run.size], strict=True)]


@dataclass
class Nuisance:
    """Columns everyone may use, with prior standard deviations (inf: free), shape (rows, m) and (m,)."""

    columns: np.ndarray
    sd: np.ndarray
    names: list[str] = field(default_factory=list)

    def plus(self, columns: np.ndarray, sd: np.ndarray, names: list[str]) -> Nuisance:
        """These and further columns."""
        return Nuisance(np.column_stack([self.columns, columns]), np.r_[self.sd, sd], [*self.names, *names])


@dataclass(frozen=True)
class Scored:
    """A hypothesis' log Bayes factor against the nuisances alone, and the size that fits best."""

    gain: float
    size: float
    explained: float  # share of the null's residual sum that it takes away


class Scene:
    """One response ready to be explained: whitened data and nuisances, against which many hypotheses are scored."""

    def __init__(self, y: np.ndarray, nuisance: Nuisance, noise: Noise, run: np.ndarray):
        self.noise, self.run, self.n = noise, run, y.size
        self.nuisance = nuisance
        self.y = noise.whiten(y, run)
        self.N = noise.whiten(nuisance.columns, run)
        scale = np.sqrt((self.N**2).sum(axis=0)) + 1e-300
        prior = np.where(np.isinf(nuisance.sd), 0.0, 1.0 / np.maximum(nuisance.sd, 1e-300) ** 2)
        self.NN = self.N.T @ self.N + np.diag(prior + 1e-12 * scale**2)
        self.chol = np.linalg.cholesky(self.NN)
        self.half = np.linalg.solve(self.chol, self.N.T @ self.y)
        self.Q = float(self.y @ self.y - self.half @ self.half)

    def coefficients(self) -> np.ndarray:
        """Posterior mean of the nuisances' coefficients."""
        return np.linalg.solve(self.chol.T, self.half)

    def residual_rms(self) -> float:
        """Whitened residual rms times sigma, degrees of freedom counted softly."""
        dof = float(np.trace(np.linalg.solve(self.NN, self.N.T @ self.N)))
        return float(np.sqrt(self.Q / max(self.n - dof, 1.0))) * self.noise.sigma

    def score_all(self, H: np.ndarray, slices: list[slice], freedom: np.ndarray) -> list[Scored]:
        """Score hypotheses whose whitened columns stand side by side in H; freedom: relative sd of each column."""
        NH = np.linalg.solve(self.chol, self.N.T @ H)
        s_all = H.T @ self.y - NH.T @ self.half
        out = []
        for at in slices:
            Hs = H[:, at]
            S = Hs.T @ Hs - NH[:, at].T @ NH[:, at]
            out.append(self._score(S, s_all[at], freedom[at]))
        return out

    def _score(self, S: np.ndarray, s: np.ndarray, freedom: np.ndarray) -> Scored:
        # in units where a column at unit size moves the response by one noise rms
        D = freedom
        lam, U = np.linalg.eigh(S * D[:, None] * D[None, :])
        lam = np.maximum(lam, 0.0)
        z = (U.T @ (D * s)) ** 2
        a2 = SIZES[:, None] ** 2
        took = (z * a2 / (1.0 + a2 * lam)).sum(axis=1)
        left = np.maximum(self.Q - took, 1e-9 * max(self.Q, 1e-9))
        log_bf = -0.5 * np.log1p(a2 * lam).sum(axis=1) - 0.5 * self.n * np.log(left / self.Q)
        top = int(np.argmax(log_bf))
        mean = float(log_bf[top] + np.log(np.mean(np.exp(log_bf - log_bf[top]))))
        return Scored(mean, float(SIZES[top]), float(took[top] / self.Q))
