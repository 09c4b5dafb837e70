"""Do 90 % intervals hold 90 % of the rows, season by season? Each season judged by widths that never saw it."""

from __future__ import annotations

from typing import Any

import numpy as np

from errpipe.fitting.thermal_arithmetic import conformal_half_width

__all__ = ["conformal_half_width", "coverage", "cross_coverage"]


def coverage(error: np.ndarray, half_width: np.ndarray | float, group: np.ndarray) -> dict[str, float]:
    """Group -> share of its rows with |error| within the half width. error, group: (n,); half_width: (n,) or one."""
    inside = np.abs(error) <= half_width
    return {str(g): float(inside[group == g].mean()) for g in dict.fromkeys(group)}


def cross_coverage(
    error: np.ndarray, run: np.ndarray, environment: np.ndarray, level: float = 0.9
) -> list[dict[str, Any]]:
    """Per environment: half width from the runs of all others (um), and the share of its rows within it.

    error: of rows left out, (n,), um. With one environment the list is empty: nothing can vouch for it.
    """
    out = []
    for label in dict.fromkeys(environment):
        mine = environment == label
        if mine.all():
            continue
        half = conformal_half_width(np.abs(error[~mine]), run[~mine], level)
        out.append(
            {"environment": str(label), "half_width": half, "coverage": float(np.mean(np.abs(error[mine]) <= half))}
        )
    return out
