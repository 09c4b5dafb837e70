"""Drivers composed of others: lags, flags and their logic, values latched while a gate was open.

A flag is a driver that is 1 or 0.
"""

from __future__ import annotations

from errpipe.domain import driver as d

AT_ONCE = 1e-3  # s: far below any cycle
NEVER = 1e15  # s: far above any session
UNTIL_RESTART = -1.0  # lower level of a switch that no flag or square reaches
UNREACHABLE_SQUARE = 1e12  # above any squared residual in thresholds


def lag(of: d.Driver, tau: float) -> d.Driver:
    """First-order lag, tau in s, that starts where its input does."""
    return d.Lag(of=of, tau_up=tau, tau_down=tau)


def since_start(of: d.Driver) -> d.Driver:
    """A driver minus its own value at the start of the run."""
    return d.Affine(weights=(1.0, -1.0), of=(of, d.First(of=of)))


def larger(one: d.Driver, other: d.Driver) -> d.Driver:
    above = d.Clip(of=d.Affine(weights=(1.0, -1.0), of=(one, other)), low=0.0, high=UNREACHABLE_SQUARE)
    return d.Affine(weights=(1.0, 1.0), of=(other, above))


def squared(of: d.Driver) -> d.Driver:
    return d.Product(of=(of, of))


def none_of(*flags: d.Driver) -> d.Driver:
    """1 while every flag is 0; else 0."""
    return d.Clip(of=d.Affine(offset=1.0, weights=(-1.0,) * len(flags), of=flags), low=0.0, high=1.0)


def any_of(*flags: d.Driver) -> d.Driver:
    """1 while a flag is 1; else 0."""
    return d.Clip(of=d.Affine(weights=(1.0,) * len(flags), of=flags), low=0.0, high=1.0)


def held(of: d.Driver, gate: d.Driver) -> d.Driver:
    """A non-decreasing value, latched when the gate was last 1: a lag that rises at once and never falls."""
    return d.Lag(of=d.Product(of=(gate, of)), tau_up=AT_ONCE, tau_down=NEVER, start="zero")
