"""Parameters of similar machines pooled: each machine's estimate shrunk towards its type's mean.

    estimate_i ~ N(parameter_i, S_i),   parameter_i ~ N(mean, T)        (Lindley and Smith 1972)

mean and T come from all machines of a type by maximum likelihood (EM, Dempster, Laird and Rubin 1977); a machine's
pooled parameter is its posterior mean under them (empirical Bayes, Efron and Morris 1975). T's correlations are shrunk
towards zero, as if the data included as many uncorrelated machines as there are parameters: with few machines T is
singular, and every other machine would be forced into the subspace that they span.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage

from errpipe.fitting.statistics import chi2_quantile, normal_quantile, student_quantile

STEPS = 200  # of EM, which converges slowly if machines hardly differ
CONVERGED = 1e-5  # convergence threshold: relative change of the spread per step
REGULAR = 1e-5  # smallest over largest diagonal element of a Cholesky factor: the inverse keeps six digits
SIGNIFICANT = 0.05  # p of two machines of one type that differ
MIN_MACHINES = 4  # with fewer, the estimated spread between machines does not improve on separate fits
MIN_LENDERS = 3  # as few may provide values for a machine without a fit


@dataclass(frozen=True)
class Pool:
    """A type of machine. mean: (p,); spread: covariance between machines, (p, p); machines: their number."""

    mean: np.ndarray
    spread: np.ndarray
    machines: int

    def of_a_further_machine(self) -> np.ndarray:
        """Standard deviation of each parameter of a further machine, (p,): Student's t as a Gaussian."""
        variance = np.diag(self.spread) * (1.0 + 1.0 / self.machines)
        return np.sqrt(variance) * student_quantile(0.975, self.machines - 1) / normal_quantile(0.975)

    def shrunk(self, estimate: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Posterior mean and covariance of one machine's parameters, (p,) and (p, p)."""
        gain = self.spread @ _inverse(self.spread + covariance)
        return self.mean + gain @ (estimate - self.mean), _symmetric(self.spread - gain @ self.spread)


def pooled(
    estimates: Sequence[np.ndarray], covariances: Sequence[np.ndarray], least: int = MIN_MACHINES
) -> Pool | None:
    """The distribution of a type from machines' estimates, or None if there are fewer than `least`.

    estimates: (p,) each, in any units; covariances: (p, p) each.
    """
    if len(estimates) < least:
        return None
    values, errors = np.array(estimates), np.array(covariances)
    unit = np.sqrt(np.maximum(values.var(axis=0), np.median([np.diag(e) for e in errors], axis=0)))
    unit = np.where(unit > 0, unit, 1.0)
    values, errors = values / unit, errors / np.outer(unit, unit)
    mean, spread = values.mean(axis=0), np.cov(values.T).reshape(len(unit), len(unit)) + 1e-9 * np.eye(len(unit))
    known = len(values) / (len(values) + len(unit))  # shrinkage factor of a correlation
    shares = known + (1.0 - known) * np.eye(len(unit))
    for _ in range(STEPS):
        before = spread
        gains = spread @ _inverse(spread + errors)  # (machines, p, p)
        means = mean + np.einsum("ijk,ik->ij", gains, values - mean)
        mean = means.mean(axis=0)
        around = means - mean
        spread = _symmetric((spread - gains @ spread).mean(axis=0) + around.T @ around / len(values)) * shares
        if np.abs(spread - before).max() < CONVERGED * float(np.trace(before)):
            break
    return Pool(mean * unit, spread * np.outer(unit, unit), len(values))


def _inverse(covariances: np.ndarray) -> np.ndarray:
    """Inverses of covariances (..., p, p); pseudo-inverses, six times as slow, if one is nearly singular."""
    try:
        root = np.diagonal(np.linalg.cholesky(covariances), axis1=-2, axis2=-1)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(covariances, hermitian=True)
    regular = bool((root.min(axis=-1) > REGULAR * root.max(axis=-1)).all())
    return np.linalg.inv(covariances) if regular else np.linalg.pinv(covariances, hermitian=True)


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return (matrix + matrix.T) / 2.0


def distances(estimates: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Squared Mahalanobis distance of every two machines, n (n - 1) / 2; chi-square if they are equal.

    estimates: (n, p); covariances: (n, p, p).
    """
    out = []
    for i in range(len(estimates) - 1):
        gaps = estimates[i + 1 :] - estimates[i]
        precisions = _inverse(covariances[i + 1 :] + covariances[i])
        out.append(np.einsum("ij,ijk,ik->i", gaps, precisions, gaps))
    return np.concatenate(out)


def homogeneous_groups(estimates: Sequence[np.ndarray], covariances: Sequence[np.ndarray]) -> list[list[int]]:
    """Groups of machines whose parameters do not differ significantly (complete linkage: every pair of a group)."""
    if len(estimates) < 2:
        return []
    limit = chi2_quantile(1.0 - SIGNIFICANT, estimates[0].size)
    labels = fcluster(linkage(distances(np.array(estimates), np.array(covariances)), "complete"), limit, "distance")
    groups = [np.flatnonzero(labels == label).tolist() for label in np.unique(labels)]
    return sorted((g for g in groups if len(g) > 1), key=lambda g: (-len(g), g))
