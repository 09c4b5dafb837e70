"""Drivers that decide which sensors are accepted. The letters are those of `errpipe.guard.description`.

Every function returns one driver per sensor, in the guard's order, unless stated otherwise. A repeated call
returns the same object, so that a table contains each part once.
"""

from __future__ import annotations

import math
from functools import lru_cache

from errpipe.domain import driver as d
from errpipe.guard import composed as c
from errpipe.guard.description import SensorGuard
from errpipe.guard.rules import RULES

QUIET_SHARE = 0.36  # of the squared threshold: above it residuals are not latched; 0.25 to 0.5 give equal results
FROZEN_FIRST = 1e6  # squared thresholds: more than a failed sensor's residual
FADE_S = 600.0  # fade time of the correction when readings are not trusted: slower than a cut, faster than a body
TIE_TOLERANCE = 1e-6  # relative: below the rounding of a sum in single precision, above that in double

shared = lru_cache(maxsize=256)


@shared
def residuals(guard: SensorGuard) -> tuple[d.Driver, ...]:
    """s: leave-one-sensor-out residuals of the recent changes, in thresholds.

    All changes count from the last of the first readings on: a sensor that is late would lack what the others have.
    """
    read = [d.Input(name=n) for n in guard.names()]
    all_read = d.Affine(weights=(0.0,) * len(read), of=tuple(read))
    inputs = [d.Affine(weights=(1.0, 1.0), of=(x, all_read)) for x in read]
    recent = tuple(d.Affine(weights=(1.0, -1.0), of=(x, c.lag(x, guard.horizon_s))) for x in inputs)
    out = []
    for i, sensor in enumerate(guard.sensors):
        scale = guard.threshold * math.sqrt(sensor.precision[i])
        out.append(d.Affine(weights=tuple(p / scale for p in sensor.precision), of=recent))
    return tuple(out)


@shared
def _first_candidate(guard: SensorGuard) -> tuple[tuple[d.Driver, ...], d.Driver]:
    """Per sensor 1 where its squared residual is the largest; and the largest. Failed sensors come first."""
    squares, still = map(c.squared, residuals(guard)), _by_itself(guard)
    ahead = [FROZEN_FIRST * (len(still) - i) for i in range(len(still))]  # distinct, so that two of them are ordered
    return _largest(tuple(d.Affine(weights=(1.0, w), of=(q, f)) for q, f, w in zip(squares, still, ahead, strict=True)))


@shared
def _second_candidate(guard: SensorGuard) -> tuple[tuple[d.Driver, ...], d.Driver]:
    """The same after excluding the sensor of the largest residual (orthogonal matching pursuit)."""
    top, s = _first_candidate(guard)[0], residuals(guard)
    left_out = tuple(d.Product(of=pair) for pair in zip(top, s, strict=True))
    squares = []
    for j, row in enumerate(correlations(guard)):
        shown = d.Affine(weights=(1.0, *(-r for r in row)), of=(s[j], *left_out))
        share = tuple(0.0 if i == j else 1.0 / (1.0 - r * r) for i, r in enumerate(row))
        squares.append(d.Product(of=(shown, shown, d.Affine(weights=share, of=top))))
    return _largest(tuple(squares))


def correlations(guard: SensorGuard) -> list[list[float]]:
    """P_ij / sqrt(P_ii P_jj): the share of a fault of sensor j that appears in the residual of i; 1 on the diagonal."""
    rows = [s.precision for s in guard.sensors]
    size = [math.sqrt(row[i]) for i, row in enumerate(rows)]
    return [[p / size[i] / size[j] if i != j else 1.0 for j, p in enumerate(row)] for i, row in enumerate(rows)]


def _largest(values: tuple[d.Driver, ...]) -> tuple[tuple[d.Driver, ...], d.Driver]:
    most = values[0]
    for value in values[1:]:
        most = c.larger(most, value)
    below = [d.Affine(weights=(1.0, TIE_TOLERANCE - 1.0), of=(value, most)) for value in values]
    return tuple(d.Switch(of=b, on=0.0, off=-1e-30) for b in below), most


@shared
def isolated(guard: SensorGuard) -> tuple[d.Driver, ...]:
    """1 once a sensor's residual has been the largest and above the threshold, until the next start; else 0.

    While one is frozen or has jumped, the others are tested without it: its reading affects their residuals.
    """
    (top, most), (second, left) = _first_candidate(guard), _second_candidate(guard)
    judged = d.Product(of=(most, c.none_of(*_by_itself(guard))))
    over = d.Switch(of=judged, on=1.0, off=1.0 - TIE_TOLERANCE)
    first_known = c.any_of(d.Switch(of=judged, on=1.0, off=c.UNTIL_RESTART), *_by_itself(guard))
    over_too = d.Product(of=(first_known, d.Switch(of=left, on=1.0, off=1.0 - TIE_TOLERANCE)))
    out = []
    for one, other in zip(top, second, strict=True):
        now = (d.Product(of=(over, one)), d.Product(of=(over_too, other)))
        out.append(d.Switch(of=d.Affine(weights=(1.0, 1.0), of=now), on=0.5, off=c.UNTIL_RESTART))
    return tuple(out)


@shared
def flags(guard: SensorGuard, kind: str) -> tuple[d.Driver, ...]:
    """Flags of one rule; 0 of a sensor to which it is not applied."""
    rules = [s.rule(kind) for s in guard.sensors]
    return tuple(
        d.Constant(value=0.0) if rule is None else rule.flag(d.Input(name=s.name))
        for s, rule in zip(guard.sensors, rules, strict=True)
    )


@shared
def _by_itself(guard: SensorGuard) -> tuple[d.Driver, ...]:
    """Above 0 if a reading alone shows that it is wrong; else 0."""
    by_rule = [flags(guard, kind) for kind in RULES.tags]
    return tuple(d.Affine(weights=(1.0,) * len(of), of=of) for of in zip(*by_rule, strict=True))


@shared
def faults(guard: SensorGuard) -> tuple[d.Driver, ...]:
    """1 while a reading is rejected; else 0."""
    if not guard.compares:
        return tuple(c.any_of(flag) for flag in _by_itself(guard))
    return tuple(c.any_of(*pair) for pair in zip(_by_itself(guard), isolated(guard), strict=True))


@shared
def trust(guard: SensorGuard) -> d.Driver:
    """1 while the readings, or their replacements, are usable; else it fades to 0."""
    failed = faults(guard)
    lost = [f for s, f in zip(guard.sensors, failed, strict=True) if not s.stands_in]
    most = guard.most_failed + 0.5
    several = d.Switch(of=d.Affine(weights=(1.0,) * len(failed), of=failed), on=most, off=most - TIE_TOLERANCE)
    return c.lag(c.none_of(*lost, several), FADE_S)


@shared
def all_normal(guard: SensorGuard) -> d.Driver:
    """One driver: 1 while no sensor has failed and no residual is near the threshold; else 0."""
    if not guard.compares:
        return c.none_of(*faults(guard))
    suspect = d.Switch(of=_first_candidate(guard)[1], on=QUIET_SHARE, off=QUIET_SHARE - TIE_TOLERANCE)
    return c.none_of(*faults(guard), suspect)
