"""A curve on a uniform grid of integers: the spacing for a stated error bound, and the errors that remain.

Straight lines between grid points miss a curve by at most h^2 / 8 * max|f''|. That picks the first spacing; dense
sampling of the difference then decides, so kinks and steps are seen too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.domain.table import LARGEST_VALUE, Profile
from errpipe.errors import GateError

SAMPLES = 4096  # for the first look at the curve, and at least as many for the check
PER_STEP = 16  # samples between two grid points when the error is measured
MAX_INTERVALS = 16384  # of a profile


def grid(
    curve: Callable[[np.ndarray], np.ndarray],
    low: float,
    high: float,
    *,
    bound: float,
    unit: float = 0.001,
    periodic: bool = False,
    limit: int = MAX_INTERVALS,
    what: str = "profile",
) -> Profile:
    """The profile of `curve` over [low, high] (periodic: one period), without its input.

    bound: largest interpolation error allowed, in the curve's unit; unit: the value of one integer step (made
    ten times larger as often as 32 bits demand). Raises GateError if `limit` intervals are not enough and
    where the curve is not finite.
    """
    if not low < high:
        raise GateError(f"{what}: nothing to grid between {low:g} and {high:g}")
    first = _evaluate(curve, np.linspace(low, high, SAMPLES + 1), what)
    bend = float(np.max(np.abs(np.diff(first, 2)), initial=0.0)) * SAMPLES**2
    intervals = min(max(1, int(np.ceil((bend / 8.0 / bound) ** 0.5))), limit)
    while True:
        error = interpolation_error(curve, low, high, intervals)
        if error <= bound:
            break
        if intervals >= limit:
            raise GateError(
                f"{what}: {limit} intervals leave {error:.3g} between the grid points (allowed {bound:.3g}). "
                "Allow a larger error, or look for a step in the curve."
            )
        intervals = min(limit, max(intervals + 1, int(np.ceil(intervals * min(4.0, 1.02 * (error / bound) ** 0.5)))))
    return quantise(curve, low, high, max(intervals, 2 if periodic else 1), error, unit, periodic)


def quantise(
    curve: Callable[[np.ndarray], np.ndarray],
    start: float,
    end: float,
    intervals: int,
    error: float,
    unit: float,
    periodic: bool,
) -> Profile:
    """The profile with a given number of intervals; `error` is reported as its interpolation error."""
    step = (end - start) / intervals
    nodes = _evaluate(curve, start + step * np.arange(intervals + 1), "profile")
    if periodic:
        nodes[-1] = nodes[0]
    while np.max(np.abs(nodes)) / unit > LARGEST_VALUE:
        unit *= 10.0
    values = np.rint(nodes / unit)
    return Profile.model_construct(
        input=None,
        start=float(start),
        step=float(step),
        scale=float(unit),
        periodic=periodic,
        values=tuple(int(v) for v in values),
        interpolation_error=float(error),
        rounding_error=float(np.max(np.abs(values * unit - nodes))),
    )


def interpolation_error(curve: Callable[[np.ndarray], np.ndarray], start: float, end: float, intervals: int) -> float:
    """Largest distance between the curve and its straight pieces, by dense sampling."""
    per_step = max(PER_STEP, -(-SAMPLES // intervals))
    x = np.linspace(start, end, intervals * per_step + 1)
    dense = _evaluate(curve, x, "profile")
    straight = np.interp(x, x[::per_step], dense[::per_step])
    return float(np.max(np.abs(dense - straight)))


def _evaluate(curve: Callable[[np.ndarray], np.ndarray], x: np.ndarray, what: str) -> np.ndarray:
    y = np.asarray(curve(x), dtype=float)
    y = np.array(np.broadcast_to(y, x.shape))
    if not np.all(np.isfinite(y)):
        raise GateError(f"{what}: not a number at {x[~np.isfinite(y)][0]:g}")
    return y
