"""Root mean square; quantiles and tails of the usual distributions: scipy.stats without its half second of import."""

from __future__ import annotations

import numpy as np
from scipy import special


def rms(values: np.ndarray) -> float:
    """Root mean square; 0 of nothing."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def student_quantile(p: float, degrees: float) -> float:
    """Student's t that is not exceeded with probability p."""
    return float(special.stdtrit(degrees, p))


def student_tail(t: float, degrees: float) -> float:
    """Probability that Student's t exceeds t."""
    return float(special.stdtr(degrees, -t))


def chi2_quantile(p: float, degrees: float) -> float:
    """Chi-squared that is not exceeded with probability p; nan without degrees of freedom."""
    return float(2.0 * special.gammaincinv(degrees / 2.0, p)) if degrees > 0 else float("nan")


def chi2_tail(x: float, degrees: float) -> float:
    """Probability that chi-squared exceeds x."""
    return float(special.gammaincc(degrees / 2.0, x / 2.0))


def normal_quantile(p: float) -> float:
    """Standard normal value that is not exceeded with probability p."""
    return float(special.ndtri(p))
