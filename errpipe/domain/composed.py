"""Drivers put together from others: differences, lags, flags and their logic, what was seen last while a gate was open.

A flag is a driver that is 1 or 0.
"""

from __future__ import annotations

from errpipe.domain import driver as d

AT_ONCE = 1e-3  # s
NEVER = 1e15  # s
MOST_OPERANDS = 8


def reading_of(name: str) -> d.Driver:
    """An input as it comes."""
    return d.Input(name=name)


def less(own: d.Driver, others: tuple[d.Driver, ...], weights: tuple[float, ...]) -> d.Driver:
    """own - sum of weights x others."""
    return d.Affine(weights=(1.0, *(-w for w in weights)), of=(own, *others))


def since_start(of: d.Driver) -> d.Driver:
    """A driver less its own value at the start of the run."""
    return d.Affine(weights=(1.0, -1.0), of=(of, d.First(of=of)))


def lag(of: d.Driver, tau: float) -> d.Driver:
    """First-order lag, tau in s, that starts where its input does."""
    return d.Lag(of=of, tau_up=tau, tau_down=tau)


def size(of: d.Driver) -> d.Driver:
    """The absolute value."""
    return d.Power(of=d.Product(of=(of, of)), exponent=0.5)


def squared(of: d.Driver) -> d.Driver:
    """A driver times itself."""
    return d.Product(of=(of, of))


def difference(one: str, other: str) -> d.Driver:
    """Of two inputs."""
    return d.Affine(weights=(1.0, -1.0), of=(d.Input(name=one), d.Input(name=other)))


def all_of(flags: list[d.Driver]) -> d.Driver:
    """Product of any number of flags, at most MOST_OPERANDS at a time."""
    while len(flags) > 1:
        flags = [d.Product(of=tuple(flags[i : i + MOST_OPERANDS])) for i in range(0, len(flags), MOST_OPERANDS)]
    return flags[0]


def negated(flag: d.Driver) -> d.Driver:
    """1 while the flag is 0; else 0."""
    return d.Affine(offset=1.0, weights=(-1.0,), of=(flag,))


def none_of(*flags: d.Driver) -> d.Driver:
    """1 while every flag is 0; else 0."""
    return d.Clip(of=d.Affine(offset=1.0, weights=(-1.0,) * len(flags), of=flags), low=0.0, high=1.0)


def any_of(*flags: d.Driver) -> d.Driver:
    """1 while a flag is 1; else 0."""
    return d.Clip(of=d.Affine(weights=(1.0,) * len(flags), of=flags), low=0.0, high=1.0)


def held(of: d.Driver, gate: d.Driver) -> d.Driver:
    """What never falls, as it was when the gate was last 1: a lag that follows upwards at once and downwards never."""
    return d.Lag(of=d.Product(of=(gate, of)), tau_up=AT_ONCE, tau_down=NEVER, start="zero")
