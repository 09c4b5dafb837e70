"""Which sensors a guard believes: blamed, frozen and swapped ones, as flags and what was seen before.

The letters are those of `errpipe.guard.description`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import combinations

from errpipe.domain import composed as c
from errpipe.domain import driver as d
from errpipe.guard.description import GuardedSensor, SensorGuard
from errpipe.guard.statistics import quick, shared, slow, stillness

WARM_UP = 3.0  # freeze times after the start before stillness means anything
AWAKE = 4.0  # times the stillness: a frozen sensor must be that alive again to be believed
STIRRED = 0.8  # of the threshold: from here where readings were before a swap is no longer followed
SETTLED = 0.7  # of the threshold: from here down it is again
FITS = 0.3  # share of the squared difference that two swapped readings may miss each other's by
BESIDE = 0.18  # of FITS and the squared sum of two quick thresholds: what a swap must reach once a sensor is blamed
JUMPED = 0.7  # of 1: nothing is settled until a third of a horizon after a jump
LATELY = 0.5  # of 1: a swap is looked for until two thirds of a horizon after all was calm,
JUST_NOW = 0.9  # if nobody is blamed until a tenth of one
RATE = 3.0  # times the fastest change seen: no healthy reading is faster
FOREVER = 1e9  # s
NO_SQUARE = -1e12  # K2: below any difference of squares, so that a switch stays on until the next start
MARGIN = 1.2  # times what another sensor's fault makes of a departure: only what is beyond is one's own
TIE = 1e-9
FOR_GOOD = -1.0  # a switch's lower level that no square ever reaches: once on, it stays on until the next start


@shared
def plain_fault(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading is seen to have departed by itself or to stand still; else 0."""
    return c.any_of(blamed(guard, name), frozen(guard, name))


@shared
def fault(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading is not believed; else 0."""
    flags = (plain_fault(guard, name), *(swapped(guard, name, n) for n in guard.names() if n != name))
    return c.any_of(*flags)


@shared
def found(guard: SensorGuard) -> d.Driver:
    """1 while any sensor is at fault; else 0."""
    return c.any_of(anybody(guard), *(_swapped(guard, *pair) for pair in combinations(guard.names(), 2)))


@shared
def anybody(guard: SensorGuard) -> d.Driver:
    """1 while any sensor has departed or stands still; else 0."""
    return c.any_of(*(plain_fault(guard, n) for n in guard.names()))


def stirred(guard: SensorGuard, on: float, off: float) -> tuple[d.Driver, ...]:
    """Per sensor, 1 once its quick statistic reaches `on`, until it falls below `off`; else 0."""
    return tuple(d.Switch(of=quick(guard, s), on=on, off=off) for s in guard.sensors)


@shared
def settled(guard: SensorGuard) -> d.Driver:
    """1 while no sensor is at fault or near to it, nor has lately jumped: the readings are where they belong; else 0.

    A jump is a change within minutes that no healthy sensor kept up; one of two that are swapped may show it long
    before the other, whose input holds what races. So nothing is settled for a third of a horizon after one.
    """
    jumps = []
    for s in guard.sensors:
        gone = c.squared(d.Affine(weights=(1.0, -1.0), of=(d.Input(name=s.name), _minutes_ago(guard, s.name))))
        level = (s.max_rate / RATE * guard.swap_s) ** 2
        jumps.append(d.Switch(of=gone, on=level, off=SETTLED * level))
    since = d.Lag(of=c.any_of(*jumps), tau_up=c.AT_ONCE, tau_down=guard.horizon_s)
    lately = d.Switch(of=since, on=JUMPED, off=JUMPED - TIE)
    return c.none_of(anybody(guard), *stirred(guard, STIRRED, SETTLED), lately)


def blamed(guard: SensorGuard, name: str) -> d.Driver:
    """1 once a sensor has departed by itself, until the next start; else 0."""
    by_quick = _by_itself(guard, name, quick, {s.name: s.quick for s in guard.sensors})
    by_slow = _by_itself(guard, name, slow, {s.name: s.slow for s in guard.sensors})
    return d.Switch(of=d.Affine(weights=(1.0, 1.0), of=(by_quick, by_slow)), on=0.5, off=FOR_GOOD)


def _by_itself(
    guard: SensorGuard,
    name: str,
    statistic: Callable[[SensorGuard, GuardedSensor], d.Driver],
    thresholds: dict[str, float],
) -> d.Driver:
    """1 while a sensor's statistic is 1 or more beyond what a fault of any other sensor would make it; else 0."""
    sensor = guard.sensor(name)
    own = statistic(guard, sensor)
    flags: list[d.Driver] = []
    for key, weight in zip(sensor.others, sensor.weights, strict=True):
        share = MARGIN * abs(weight) * thresholds[key] / thresholds[name]
        other = statistic(guard, guard.sensor(key))
        flags.append(d.Switch(of=d.Affine(weights=(1.0, -share), of=(own, other)), on=1.0, off=1.0 - TIE))
    return c.all_of(flags)


def frozen(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading stands still as it never does when healthy; else 0."""
    sensor = guard.sensor(name)
    if sensor.still is None:
        return d.Constant(value=0.0)
    alive = d.Affine(weights=(-1.0,), of=(stillness(guard, sensor),))
    still = d.Switch(of=alive, on=-sensor.still, off=-AWAKE * sensor.still)
    age = d.Lag(of=d.ONE, tau_up=guard.freeze_s, tau_down=guard.freeze_s, start="zero")
    awake_long_enough_to_tell = d.Switch(of=age, on=1.0 - math.exp(-WARM_UP), off=0.0)
    return d.Product(of=(still, awake_long_enough_to_tell))


def swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    """1 once two readings are where each other was, until the next start; else 0."""
    return _swapped(guard, *in_order(guard, one, other))


def in_order(guard: SensorGuard, one: str, other: str) -> tuple[str, str]:
    """Two names in the guard's order, so that a pair is the same object either way round."""
    first, second = sorted((one, other), key=guard.names().index)
    return first, second


@shared
def _swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    """Each reads what the other did when last nothing had jumped, far better than what it did itself.

    By as much as a fault must be, while a sensor is blamed; else by more than healthy ones ever turn round.
    """
    alone = FITS * guard.turn(one, other) ** 2
    beside = BESIDE * FITS * (guard.sensor(one).quick + guard.sensor(other).quick) ** 2
    most = FITS * max(guard.sensor(n).high - guard.sensor(m).low for n, m in ((one, other), (other, one))) ** 2
    seen = d.Affine(
        offset=-most,
        weights=(most, FITS, -1.0, -1.0, alone - beside),
        of=(_settled_lately(guard), *_squares(guard, one, other), anybody(guard)),
    )
    return d.Switch(of=seen, on=alone, off=NO_SQUARE)


@shared
def _settled_lately(guard: SensorGuard) -> d.Driver:
    since = d.Affine(weights=(1.0, JUST_NOW - LATELY), of=(_since_settled(guard), anybody(guard)))
    return d.Switch(of=since, on=JUST_NOW, off=JUST_NOW - TIE)


@shared
def _since_settled(guard: SensorGuard) -> d.Driver:
    """exp(-time since all was settled / horizon)."""
    return d.Lag(of=settled(guard), tau_up=c.AT_ONCE, tau_down=guard.horizon_s)


def _squares(guard: SensorGuard, one: str, other: str) -> tuple[d.Driver, ...]:
    """(x - y)^2, (x - y')^2, (y - x')^2, with x', y' when all was settled, K2."""
    crosswise = [
        d.Affine(weights=(1.0, -1.0), of=(d.Input(name=a), when_settled(guard, b)))
        for a, b in ((one, other), (other, one))
    ]
    return tuple(map(c.squared, (c.difference(one, other), *crosswise)))


@shared
def when_settled(guard: SensorGuard, name: str) -> d.Driver:
    """The reading, over minutes, when last all was settled."""
    return as_it_was(guard, _minutes_ago(guard, name), settled(guard))


@shared
def _minutes_ago(guard: SensorGuard, name: str) -> d.Driver:
    within = d.Clip(of=d.Input(name=name), low=guard.sensor(name).low, high=guard.sensor(name).high)
    return c.lag(within, guard.swap_s)


def as_it_was(guard: SensorGuard, of: d.Driver, gate: d.Driver) -> d.Driver:
    """What `of` was when the gate was last 1.

    No operation holds a value that may fall; so a clock is added that rises faster, and subtracted once both are held.
    """
    rising = d.Affine(weights=(1.0, 1.0), of=(of, _clock(guard)))
    return d.Affine(weights=(1.0, -1.0), of=(c.held(rising, gate), c.held(_clock(guard), gate)))


@shared
def _clock(guard: SensorGuard) -> d.Driver:
    """Rises without end, faster than anything that is remembered, K."""
    widest = max(max(2.0 * s.reach / guard.settle_s, (s.high - s.low) / guard.swap_s) for s in guard.sensors)
    return d.Lag(of=d.Constant(value=2.0 * widest * FOREVER), tau_up=FOREVER, tau_down=FOREVER, start="zero")
