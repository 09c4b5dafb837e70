"""What moves from cycle to cycle: ramps, rates within limits, sides of an axis, places of a curve.

Plain Python: the reference evaluator calls it as it is, the kernels of a cycle compile it (`elementary.compiled`).
"""

from __future__ import annotations

from collections.abc import Sequence


def towards(value: float, target: float, dt: float, whole: float) -> float:
    """Move from value to target by at most dt / whole; at once where whole is 0."""
    if whole <= 0.0:
        return target
    step = dt / whole
    if target > value + step:
        return value + step
    if target < value - step:
        return value - step
    return target


def can_stop(closing: float, left: float, brake: float) -> bool:
    """Whether a closing speed can be reduced to zero within the remaining distance (per cycle)."""
    if closing <= 0.0:
        return True
    return closing * (closing - brake) <= 2.0 * brake * left


def closing_rate(keep: float, way: float, drift: float, slowest: float, fastest: float, brake: float) -> float:
    """Full towards, keep, full away: the first that can be braked; where braking would end the closing, half way.

    Without an acceleration limit (brake 0) always full towards.
    """
    if keep > fastest:
        keep = fastest
    if keep < slowest:
        keep = slowest
    if way > 0.0:
        forward, away, sign = fastest, slowest, 1.0
    else:
        forward, away, sign = slowest, fastest, -1.0
    if brake <= 0.0:
        return forward
    if can_stop(sign * (forward - drift), sign * (way - forward), brake):
        return forward
    if sign * (keep - drift) > 0.0 and can_stop(sign * (keep - drift), sign * (way - keep), brake):
        return keep
    if sign * (away - drift) > 0.0:
        return away
    half = drift + 0.5 * (way - drift)
    return slowest if half < slowest else fastest if half > fastest else half


def moved_side(x: float, known: float, side: float, memory: float, threshold: float) -> tuple[float, float]:
    """(side, turning point) of an axis that moved to x. known: stated side (+1, -1), 0 where none is."""
    if known > 0.0:
        return 1.0, x
    if known < 0.0:
        return -1.0, x
    if side > 0.0:
        if x >= memory:
            return side, x
        if memory - x > threshold:
            return -1.0, x
    else:
        if x <= memory:
            return side, x
        if x - memory > threshold:
            return 1.0, x
    return side, memory


def on_grid(s: float, last: int) -> tuple[int, float]:
    """(interval, share of it) of a place on a uniform grid, held at the ends; s counts steps, up to `last`."""
    if s < 0.0:
        s = 0.0
    if s > last:
        s = float(last)
    j = int(s)
    if j > last - 1:
        j = last - 1
    return j, s - j


def on_lines(values: Sequence[float], first: int, last: int, s: float) -> float:
    """Straight lines between uniform values from number `first` on, at a place of `on_grid`."""
    j, share = on_grid(s, last)
    left = values[first + j]
    return left + share * (values[first + j + 1] - left)
