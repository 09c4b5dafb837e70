"""Quantiles have the bits of scipy.stats, and neither it nor a solver is imported where none is needed."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import stats

from errpipe.fitting.statistics import chi2_quantile, normal_quantile, student_quantile, student_tail


@pytest.mark.parametrize("degrees", [1, 2, 7, 33.5, 400])
def test_the_bits_of_scipy_stats(degrees: float) -> None:
    for p in np.linspace(0.001, 0.999, 41):
        assert student_quantile(p, degrees) == stats.t.ppf(p, degrees)
        assert chi2_quantile(p, degrees) == stats.chi2.ppf(p, degrees)
        assert normal_quantile(p) == stats.norm.ppf(p)
    for t in np.linspace(-9, 9, 37):
        assert student_tail(t, degrees) == stats.t.sf(t, degrees)
        assert student_tail(-t, degrees) == stats.t.cdf(t, degrees)
    assert np.isnan(chi2_quantile(0.95, 0)) and np.isnan(stats.chi2.ppf(0.95, 0))


@pytest.mark.parametrize(
    ("module", "absent"),
    [("errpipe.validation.predict", "scipy.optimize"), ("errpipe.fitting.uncertainty", "scipy.stats")],
)
def test_nothing_is_imported_that_is_not_needed(module: str, absent: str) -> None:
    code = f"import sys, {module}; print({absent!r} in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == "False"
