"""Library of an empirical regression: columns, lags, thresholds, powers and products as drivers, with their units.

Temperatures enter as rises over their mean and positions as distances from the middle, so that a power or product
means something. A time constant, a threshold or an exponent has a starting value; `Candidate.at` gives the same
column with another one.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.operations import LARGEST_NUMBER
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive

MOST_BASE = 40  # columns and lags whose products are tried
LAGS = (1 / 60, 1 / 20, 1 / 6)  # of the longest session: time constants of lagged columns
THRESHOLDS = (0.25, 0.5, 0.75)  # of the range of a column
DRIVEN = ("spindle_speed", "feed", "coolant", "load", "force", "current", "torque")  # inputs with a natural zero
MEASURED = ("temperature", "pressure", "humidity")  # counted from their mean
MOVING = ("direction", "velocity", "acceleration")
READ = (*MEASURED, *DRIVEN, *MOVING, "position", "command", "overhang", "depth_of_cut", "cut_length")
UNITS = {"temperature": "K", "direction": "1", "coolant": "1"}
PLAIN, BENT, TWO = 1.0, 0.98, 0.96  # weights of a column, its bend, of a product: the simplest of collinear ones
STEEP = 1e9  # slope of a sign: 1 beyond a billionth of a unit
Unit = tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Candidate:
    """A column of the library: expression, unit as powers of units, driver, weight, values (rows,).

    free, spans: parameters that may be fitted, and their ranges; at: the column with other values of them.
    """

    name: str
    unit: Unit
    driver: d.Driver
    weight: float
    values: np.ndarray
    free: tuple[float, ...] = ()
    spans: tuple[tuple[float, float], ...] = ()
    at: Callable[..., Candidate] | None = None

    def over(self, name: str, driver: d.Driver, values: np.ndarray, **changed: Any) -> Candidate:
        """A column made of this one."""
        return replace(self, name=name, driver=driver, values=values, weight=BENT, **changed)


def candidates(recording: Recording, rows: np.ndarray, longest: float) -> list[Candidate]:
    """The library on some rows of a conditioned recording. longest: its longest session, s."""
    every = [(one, list(_late(one, recording, rows, longest))) for one in _plain(recording, rows)]
    plain = [late[0] if late else one for one, late in every]
    late = [c for _, late in every for c in late[1:]]
    bent = [c for one, _ in every for c in _bent(one, recording, rows)]
    base = [*plain, *late][:MOST_BASE]
    out = [*base, *bent, *(product(c, c) for c in base[len(plain) :])]
    out += [product(one, other) for one, other in itertools.combinations(base, 2)]
    powers = [c for c in bent if isinstance(c.driver, d.Power)]
    out += [product(c, one) for c in powers for one in plain if one.name not in c.name]
    return [c for c in out if np.std(c.values) > 1e-9 * (1e-300 + float(np.abs(c.values).max()))]


def _plain(recording: Recording, rows: np.ndarray) -> Iterator[Candidate]:
    """Columns about their mean, positions about the middle."""
    for role in READ:
        for name in recording.names(role):
            whole = recording.array(name)
            if not np.isfinite(whole).all() or np.ptp(whole[rows]) == 0:
                continue
            column, low, high = recording.manifest.columns[name], float(whole[rows].min()), float(whole[rows].max())
            own = UNITS.get(role) or column.unit or "1"
            unit: Unit = () if own == "1" else ((own, 1),)
            node: d.Driver = d.Input(name=name)
            if role == "direction" and column.axis is not None:
                node = d.Direction(axis=column.axis)
            one = Candidate(name, unit, node, PLAIN, drive(node, recording)[rows])
            if role in MOVING or role in DRIVEN:
                yield one
            else:
                span = (2.0 * low - high, 2.0 * high - low)
                yield _counted(one, float(whole[rows].mean()) if role in MEASURED else 0.5 * (low + high), span)
            if role == "velocity":
                sign = d.Clip(of=d.Affine(weights=(STEEP,), of=(node,)), low=-1.0, high=1.0)
                yield Candidate(f"sign({name})", (), sign, PLAIN, drive(sign, recording)[rows])


def _counted(one: Candidate, zero: float, span: tuple[float, float]) -> Candidate:
    """A column counted from a reference."""
    driver = d.Affine(offset=-zero, weights=(1.0,), of=(one.driver,)) if zero else one.driver
    values, name = one.values - zero, f"({one.name} - {zero:.5g})".replace("- -", "+ ") if zero else one.name
    again = lambda value: _counted(one, value, span)  # noqa: E731
    return Candidate(name, one.unit, driver, PLAIN, values, (zero,), (span,), again)


def _late(one: Candidate, recording: Recording, rows: np.ndarray, longest: float) -> Iterator[Candidate]:
    """An input that changes by itself, as it is and through first-order lags."""
    roles = {recording.manifest.columns[name].role for name in d.inputs(one.driver)}
    if not roles or not roles <= {*MEASURED, *DRIVEN} or recording.name("time") is None:
        return

    def lagged(tau: float, *inner: float) -> Candidate:
        of = one.at(*inner) if one.at and inner else one
        if tau < 0.25 * LAGS[0] * longest:
            return replace(of, free=(tau, *of.free), spans=(span, *of.spans), at=lagged)
        driver, name = d.Lag(of=of.driver, tau_up=tau, tau_down=tau), f"lag({of.name.strip('()')}, {tau:.3g} s)"
        known = {"free": (tau, *of.free), "spans": (span, *of.spans), "at": lagged}
        return of.over(name, driver, drive(driver, recording)[rows], **known)

    for share in (0.0, *LAGS):
        span = (0.0, longest)
        if np.ptp((made := lagged(share * longest)).values) > 0:
            yield made


def _bent(one: Candidate, recording: Recording, rows: np.ndarray) -> Iterator[Candidate]:
    """Magnitude and square; of an input with a natural zero any power, and what exceeds a threshold."""
    low, high = float(one.values.min()), float(one.values.max())
    if np.unique(one.values).size < 3:
        return

    def power(exponent: float) -> Candidate:
        driver = d.Power(of=one.driver, exponent=exponent)
        known = {"free": (exponent,), "spans": ((0.3, 4.0),), "at": power}
        unit = tuple((name, exponent) for name, _ in one.unit)
        return one.over(
            f"({one.name})^{exponent:.3g}" if exponent != 1 else one.name,
            driver,
            drive(driver, recording)[rows],
            unit=unit,
            **known,
        )

    def beyond(threshold: float) -> Candidate:
        above = d.Clip(of=one.driver, low=threshold, high=LARGEST_NUMBER)
        driver = d.Affine(offset=-threshold, weights=(1.0,), of=(above,))
        known = {"free": (threshold,), "spans": ((low, high),), "at": beyond}
        name = f"max({one.name} - {threshold:.4g}, 0)".replace("- -", "+ ")
        return one.over(name, driver, drive(driver, recording)[rows], **known)

    if one.free or low < 0:
        yield replace(product(one, one), weight=BENT)
    else:
        yield from (power(2.0), *(beyond(low + share * (high - low)) for share in THRESHOLDS))
    if low < 0 < high:
        sides = [d.Clip(of=one.driver, low=a, high=b) for a, b in ((0.0, LARGEST_NUMBER), (-LARGEST_NUMBER, 0.0))]
        size = d.Affine(weights=(1.0, -1.0), of=tuple(sides))
        yield Candidate(f"|{one.name}|", one.unit, size, BENT, np.abs(one.values))


def product(one: Candidate, other: Candidate) -> Candidate:
    """The product of two columns, which may be the same."""
    square, powers = one is other, dict(one.unit)
    for name, power in other.unit:
        powers[name] = powers.get(name, 0) + power
    unit, driver = tuple(sorted(powers.items())), d.Product(of=(one.driver, other.driver))
    free, count = (one.free, len(one.free)) if square else (one.free + other.free, len(one.free))

    def again(*values: float) -> Candidate:
        first = one.at(*values[:count]) if one.at else one
        return product(first, first if square else other.at(*values[count:]) if other.at else other)

    return Candidate(
        f"({one.name})^2" if square else f"{one.name} {other.name}",
        unit,
        driver,
        TWO * one.weight * other.weight,
        one.values * other.values,
        free,
        one.spans if square else one.spans + other.spans,
        again if free else None,
    )


def unit_over(response: str, unit: Unit) -> str:
    """Unit of a coefficient: the response's over the column's, such as um/(K2 mm)."""
    below = [f"{name}{power:.3g}" if power != 1 else name for name, power in unit]
    below = [f"({b})" if "/" in b and len(below) > 1 else b for b in below]
    if not below:
        return response
    return f"{response}/{below[0]}" if len(below) == 1 and "/" not in below[0] else f"{response}/({' '.join(below)})"
