"""A sensor guard: which readings to expect from each sensor, and what to use instead of one that fails.

After Ni (1997, Fig. 10), T27 = g(T26, T29): every sensor is estimated from the others. With x the readings and
`start` the first reading of the run (on a controller: since it was switched on),

    r_i = x_i - sum v_ij x_j, less its value at the start     departure from the best estimate, which also
                                                            reads first-order lags of the others
    p_i = x_i - sum w_ij x_j, less its value at the start     departure that tells sensors apart
    slow_i  = lag(p_i, filter) / its threshold                  over minutes, so that noise says nothing;
               its size less 1 per K that the session began outside the starts learnt from
    quick_i = lag(p_i - lag(p_i, horizon), filter) / its threshold     what came in the last hour: smaller faults

    blamed_i = 1 for good once |quick_i| >= 1 + c_ij |quick_j| for every other j; or so for slow
    frozen_i = 1 while lag((x_i - lag(x_i, freeze))^2, freeze) <= still_i: less alive than ever when healthy,
               no sooner than WARM_UP freeze times after the start
    m_i = lag(r_i - e_i, settle) as it was when last all was calm and x_i alive: what the estimate is off by
    swapped_ij = 1 for good once x_i, x_j read what x_j, x_i did when last nothing had jumped, by far better than what
               they did themselves, and are further apart than the difference of healthy ones ever turns round
               within minutes; by no less than a fault must be where a sensor is blamed already
    e_i = how far x_i has moved, over hours, beyond what *both* its witnesses allow (disjoint sets of other sensors):
               the lesser of the two excesses where they agree in sign, else 0; 0 once any sensor is found at fault.
               Only for sensors that have witnesses
    guarded reading = x_i - e_i, less (r_i - m_i + sum v_ij (r_j - m_j) over failed j) while it is blamed or frozen:
               its last trusted reading, carried on as its estimate from what stands in for the others;
               x_j where it is swapped with j

e_i bounds what a fault does before it is found: nobody has to know which sensor lies, because one witness that
lies is outvoted by the reading and the other witness. Half the harm of slow drifts is done before any alarm.

Two sets of weights, because the estimate that follows best cannot tell which of two close sensors failed: their
departures are one and the same. The w give up some closeness, so that a fault of sensor j shows in p_i less than
in p_j. How much less is known, so c_ij = MARGIN x that share keeps i from being blamed for j's fault, and leaves
it free to be blamed for its own beside it (two that are swapped). All of it is built of the operations of
`errpipe.domain.driver`, so it is compiled, exported and evaluated like any driver, causally.

Limits. What is blamed stays out until the next start. A fault that is there at the start and constant does not
show, and does no harm to a model of rises. Empty, impossible and racing readings are caught before, by each
input's own range, rate and hold (`low`, `high`, `max_rate`); a held reading is a frozen one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import lru_cache
from itertools import combinations
from typing import Literal

from pydantic import Field

from errpipe.domain import driver as d
from errpipe.domain.recording import Frozen

WARM_UP = 3.0  # freeze times after the start before stillness means anything
AWAKE = 4.0  # times the stillness: a frozen sensor must be that alive again to be believed
MUTED = 1.0  # per K outside the starts learnt from: of the slow statistic
FAR = 1e3  # K
SUSPECT = 0.5  # of the threshold: from here what a reading is off by is no longer remembered
CLEARED = 0.4  # of the threshold: from here down it is again
STIRRED = 0.8  # of the threshold: from here where readings were before a swap is no longer followed
SETTLED = 0.7  # of the threshold: from here down it is again
FITS = 0.3  # share of the squared difference that two swapped readings may miss each other's by
BESIDE = 0.18  # of FITS and the squared sum of two quick thresholds: what a swap must reach once a sensor is blamed
LATELY = 0.6  # of 1: a swap is looked for until half a horizon after all was calm,
JUST_NOW = 0.9  # if nobody is blamed until a fifth of it
RATE = 3.0  # times the fastest change seen: no healthy reading is faster
FOREVER = 1e9  # s
NEVER = 1e15  # s
AT_ONCE = 1e-3  # s
NO_SQUARE = -1e12  # K2: below any difference of squares, so that a switch stays on until the next start
MARGIN = 1.2  # times what another sensor's fault makes of a departure: only what is beyond is one's own
TIE = 1e-9
MOST_OPERANDS = 8
FOR_GOOD = -1.0  # a switch's lower level that no square ever reaches: once on, it stays on until the next start


# The same part asked for again is the same object, so that whoever walks a driver can know it again.
_shared = lru_cache(maxsize=1024)


class Source(Frozen):
    """A sensor's reading, or its first-order lag, that says something about another sensor."""

    name: str
    lag_s: float | None = Field(None, gt=0)


class Witness(Frozen):
    """A few other sensors that tell how one should move: sum of weights x sources."""

    sources: tuple[Source, ...]
    weights: tuple[float, ...]
    within: float = Field(gt=0, description="K; a healthy reading mostly departs less within hours.")


class GuardedSensor(Frozen):
    """One sensor. Units: the sensor's own (degC; differences K), s."""

    name: str
    low: float = Field(description="No healthy reading lies below.")
    high: float = Field(description="No healthy reading lies above.")
    max_rate: float = Field(gt=0, description="No healthy reading changes faster, per s.")
    others: tuple[str, ...] = Field(description="The other sensors.")
    weights: tuple[float, ...] = Field(description="Weights w of the others, which keep faults apart.")
    sources: tuple[Source, ...] = Field(description="What it is best estimated from.")
    estimate: tuple[float, ...] = Field(description="Weights v of the sources.")
    static: tuple[float, ...] = Field(description="Weights of the others where neither lag nor start is known:")
    offset: float = Field(description="reading = offset + sum of static weights x the others' readings.")
    residual: float = Field(ge=0, description="Standard deviation of r on groups that had no part in the weights.")
    quick: float = Field(gt=0, description="Threshold of the quick departure.")
    slow: float = Field(gt=0, description="Threshold of the slow departure.")
    starts: tuple[float, float] = Field(description="Lowest and highest reading at the start of a session.")
    reach: float = Field(gt=0, description="Largest departure r that is remembered; twice what a healthy one had.")
    witnesses: tuple[Witness, ...] = Field((), description="Disjoint sets of others that a reading is held between.")
    lively: float | None = Field(None, description="Of the lagged square; a healthy one seldom is below.")
    still: float | None = Field(None, description="Of the lagged square; None: it stands still when healthy.")


class SensorGuard(Frozen):
    """Format version 1. `false_alarms` is the rate the thresholds were set for, on healthy sensors."""

    sensor_guard: Literal[1] = 1
    sensors: tuple[GuardedSensor, ...]
    filter_s: float = Field(gt=0, description="Time constant of the statistics.")
    horizon_s: float = Field(gt=0, description="Time constant of what the quick statistic forgets.")
    freeze_s: float = Field(gt=0, description="Time constant of the stillness.")
    settle_s: float = Field(gt=0, description="Time constant of what is remembered of a departure.")
    swap_s: float = Field(gt=0, description="Time constant of where a reading was before a swap.")
    corridor_s: float = Field(14400.0, gt=0, description="Time constant of what a witness forgets.")
    turns: tuple[float, ...] = Field(description="K; healthy ones this far apart never turn round; pairs in order.")
    false_alarms: float = Field(description="Expected per 1000 hours, all sensors together.")
    hours: float = Field(description="Hours of healthy readings the thresholds come from.")
    shows_elsewhere: float = Field(description="Largest share of a fault that shows in another sensor's p.")

    def sensor(self, name: str) -> GuardedSensor:
        """The sensor of a name. Raises KeyError."""
        return {s.name: s for s in self.sensors}[name]

    def turn(self, one: str, other: str) -> float:
        """How far the difference of two healthy readings does not turn round, K. Raises KeyError."""
        return dict(zip(combinations(self.names(), 2), self.turns, strict=True))[one, other]

    def names(self) -> tuple[str, ...]:
        """Names of the guarded sensors."""
        return tuple(s.name for s in self.sensors)


@_shared
def departure(sensor: GuardedSensor) -> d.Driver:
    """r: how far a reading has moved away from its best estimate since the start of the run."""
    sources = tuple(_delayed(s, d.Input(name=s.name)) for s in sensor.sources)
    return _since_start(_less(d.Input(name=sensor.name), sources, sensor.estimate))


@_shared
def apart(sensor: GuardedSensor) -> d.Driver:
    """p: the departure that tells sensors apart."""
    return _since_start(_less(d.Input(name=sensor.name), tuple(map(_input, sensor.others)), sensor.weights))


def _input(name: str) -> d.Driver:
    return d.Input(name=name)


def _less(own: d.Driver, others: tuple[d.Driver, ...], weights: tuple[float, ...]) -> d.Driver:
    return d.Affine(weights=(1.0, *(-w for w in weights)), of=(own, *others))


def _since_start(of: d.Driver) -> d.Driver:
    return d.Affine(weights=(1.0, -1.0), of=(of, d.First(of=of)))


def _delayed(source: Source, of: d.Driver) -> d.Driver:
    return of if source.lag_s is None else _lag(of, source.lag_s)


def _lag(of: d.Driver, tau: float) -> d.Driver:
    return d.Lag(of=of, tau_up=tau, tau_down=tau)


@_shared
def quick(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """|quick_i|: 1 and more is a fault somewhere."""
    scaled = d.Affine(weights=(1.0 / sensor.quick,), of=(apart(sensor),))
    recent = d.Affine(weights=(1.0, -1.0), of=(scaled, _lag(scaled, guard.horizon_s)))
    return _size(_lag(recent, guard.filter_s))


@_shared
def slow(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """|slow_i|: 1 and more is a fault somewhere; less of it where a start is unlike those learnt from.

    How sensors stand to each other over a day changes with the season, what an hour brings hardly does.
    """
    size = _size(_lag(d.Affine(weights=(1.0 / sensor.slow,), of=(apart(sensor),)), guard.filter_s))
    return d.Affine(weights=(1.0, -MUTED), of=(size, unlike(guard)))


@_shared
def unlike(guard: SensorGuard) -> d.Driver:
    """How far outside the starts learnt from this session began, mean over sensors, K."""
    nodes: list[d.Driver] = []
    for s in guard.sensors:
        start = d.First(of=d.Input(name=s.name))
        low, high = s.starts
        nodes.append(d.Clip(of=d.Affine(offset=low, weights=(-1.0,), of=(start,)), low=0.0, high=FAR))
        nodes.append(d.Clip(of=d.Affine(offset=-high, weights=(1.0,), of=(start,)), low=0.0, high=FAR))
    return d.Affine(weights=(1.0 / len(guard.sensors),) * len(nodes), of=tuple(nodes))


def _size(of: d.Driver) -> d.Driver:
    """The absolute value."""
    return d.Power(of=d.Product(of=(of, of)), exponent=0.5)


@_shared
def stillness(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """How much alive a reading is: the lagged square of its own quick part, K2. Starts at 0."""
    reading = d.Input(name=sensor.name)
    moving = d.Affine(weights=(1.0, -1.0), of=(reading, _lag(reading, guard.freeze_s)))
    return _lag(d.Product(of=(moving, moving)), guard.freeze_s)


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
    return _all(flags)


def _all(flags: list[d.Driver]) -> d.Driver:
    """Product of any number of flags, at most MOST_OPERANDS at a time."""
    while len(flags) > 1:
        flags = [d.Product(of=tuple(flags[i : i + MOST_OPERANDS])) for i in range(0, len(flags), MOST_OPERANDS)]
    return flags[0]


def _not(flag: d.Driver) -> d.Driver:
    return d.Affine(offset=1.0, weights=(-1.0,), of=(flag,))


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


@_shared
def plain_fault(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading is seen to have departed by itself or to stand still; else 0."""
    return _any_of(blamed(guard, name), frozen(guard, name))


@_shared
def fault(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading is not believed; else 0."""
    flags = (plain_fault(guard, name), *(swapped(guard, name, n) for n in guard.names() if n != name))
    return _any_of(*flags)


@_shared
def calm(guard: SensorGuard) -> d.Driver:
    """1 while no sensor is at fault and none is about to be: what is seen now may be remembered; else 0."""
    return _none_of(_anybody(guard), *_stirred(guard, SUSPECT, CLEARED))


def _stirred(guard: SensorGuard, on: float, off: float) -> tuple[d.Driver, ...]:
    return tuple(d.Switch(of=quick(guard, s), on=on, off=off) for s in guard.sensors)


def _none_of(*flags: d.Driver) -> d.Driver:
    """1 while every flag is 0; else 0."""
    return d.Clip(of=d.Affine(offset=1.0, weights=(-1.0,) * len(flags), of=flags), low=0.0, high=1.0)


def _any_of(*flags: d.Driver) -> d.Driver:
    """1 while a flag is 1; else 0."""
    return d.Clip(of=d.Affine(weights=(1.0,) * len(flags), of=flags), low=0.0, high=1.0)


@_shared
def settled(guard: SensorGuard) -> d.Driver:
    """1 while no sensor is at fault or near to it, nor has just jumped: the readings are where they belong; else 0.

    A jump is a change within minutes that no healthy sensor kept up; one of two that are swapped may show it long
    before the other, whose input holds what races.
    """
    jumps = []
    for s in guard.sensors:
        gone = _squared(d.Affine(weights=(1.0, -1.0), of=(d.Input(name=s.name), _minutes_ago(guard, s.name))))
        level = (s.max_rate / RATE * guard.swap_s) ** 2
        jumps.append(d.Switch(of=gone, on=level, off=SETTLED * level))
    return _none_of(_anybody(guard), *_stirred(guard, STIRRED, SETTLED), *jumps)


@_shared
def _at_ease(guard: SensorGuard, name: str) -> d.Driver:
    """1 while what a sensor is off by may be remembered; else 0."""
    return d.Product(of=(calm(guard), _not(asleep(guard, name))))


@_shared
def asleep(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading moves less than it mostly does when healthy: it may just have got stuck; else 0."""
    sensor = guard.sensor(name)
    if sensor.lively is None:
        return d.Constant(value=0.0)
    alive = d.Affine(weights=(-1.0,), of=(stillness(guard, sensor),))
    return d.Switch(of=alive, on=-sensor.lively, off=-sensor.lively * (1.0 + TIE))


@_shared
def _clock(guard: SensorGuard) -> d.Driver:
    """Rises without end, faster than anything that is remembered, K."""
    widest = max(max(2.0 * s.reach / guard.settle_s, (s.high - s.low) / guard.swap_s) for s in guard.sensors)
    return d.Lag(of=d.Constant(value=2.0 * widest * FOREVER), tau_up=FOREVER, tau_down=FOREVER, start="zero")


def _held(of: d.Driver, gate: d.Driver) -> d.Driver:
    """What never falls, as it was when the gate was last 1: a lag that follows upwards at once and downwards never."""
    return d.Lag(of=d.Product(of=(gate, of)), tau_up=AT_ONCE, tau_down=NEVER, start="zero")


def _as_it_was(guard: SensorGuard, of: d.Driver, gate: d.Driver) -> d.Driver:
    """What `of` was when the gate was last 1.

    No operation holds a value that may fall; so a clock is added that rises faster, and subtracted once both are held.
    """
    rising = d.Affine(weights=(1.0, 1.0), of=(of, _clock(guard)))
    return d.Affine(weights=(1.0, -1.0), of=(_held(rising, gate), _held(_clock(guard), gate)))


@_shared
def remembered(guard: SensorGuard, name: str) -> d.Driver:
    """The departure r that a sensor had while it was last believed, K: what its estimate is off by."""
    sensor = guard.sensor(name)
    believed = departure(sensor)
    beyond = excess(guard, name)
    if beyond is not None:
        believed = d.Affine(weights=(1.0, -1.0), of=(believed, beyond))
    within = d.Clip(of=believed, low=-sensor.reach, high=sensor.reach)
    return _as_it_was(guard, _lag(within, guard.settle_s), _at_ease(guard, name))


@_shared
def reading(guard: SensorGuard, name: str) -> d.Driver:
    """The reading while it is believed, else what stands in for it."""
    sensor = guard.sensor(name)
    others = tuple(_delayed(s, _off(guard, s.name)) for s in sensor.sources)
    estimated = d.Affine(weights=(1.0, *sensor.estimate), of=(_gone(guard, name), *others))
    parts: tuple[d.Driver, ...] = (d.Input(name=name), _instead(guard, name, estimated))
    beyond = excess(guard, name)
    if beyond is not None:
        parts = (*parts, beyond)
    return d.Affine(weights=(1.0, *(-1.0,) * (len(parts) - 1)), of=parts)


@_shared
def excess(guard: SensorGuard, name: str) -> d.Driver | None:
    """How far a reading is beyond what both of its witnesses allow, K; 0 once a sensor is known to have failed.

    So much of a fault that nobody has seen yet is kept away; and one witness that fails itself changes nothing.
    None where a sensor has no witnesses.
    """
    sensor = guard.sensor(name)
    if not sensor.witnesses:
        return None
    over, under = [], []
    for witness in sensor.witnesses:
        sources = tuple(_delayed(s, d.Input(name=s.name)) for s in witness.sources)
        departed = _less(d.Input(name=name), sources, witness.weights)
        usual = _lag(departed, guard.corridor_s)
        for side, sign in ((over, -1.0), (under, 1.0)):
            beyond = d.Affine(offset=sign * witness.within, weights=(1.0, -1.0), of=(departed, usual))
            side.append(d.Clip(of=beyond, low=0.0 if sign < 0 else -FAR, high=FAR if sign < 0 else 0.0))
    parts, weights = [over[0], under[0]], [1.0, 1.0]
    for one, other in zip((over[0], under[0]), (over[1:], under[1:]), strict=True):
        low, high = (0.0, FAR) if one is over[0] else (-FAR, 0.0)
        for two in other:
            parts.append(d.Clip(of=d.Affine(weights=(1.0, -1.0), of=(one, two)), low=low, high=high))
            weights.append(-1.0)
    return d.Product(of=(_not(_found(guard)), d.Affine(weights=tuple(weights), of=tuple(parts))))


@_shared
def _found(guard: SensorGuard) -> d.Driver:
    """1 while any sensor is at fault; else 0."""
    return _any_of(_anybody(guard), *(_swapped(guard, *pair) for pair in combinations(guard.names(), 2)))


@_shared
def _gone(guard: SensorGuard, name: str) -> d.Driver:
    """How far a reading has departed since it was last believed."""
    return d.Affine(weights=(1.0, -1.0), of=(departure(guard.sensor(name)), remembered(guard, name)))


@_shared
def _off(guard: SensorGuard, name: str) -> d.Driver:
    return _instead(guard, name, _gone(guard, name))


def _instead(guard: SensorGuard, name: str, gone: d.Driver) -> d.Driver:
    """What a reading is off by: where it is swapped, its difference to the other; where it failed else, `gone`."""
    place = guard.names().index(name)
    others = [n for n in guard.names() if n != name]
    alone = _none_of(*(swapped(guard, name, n) for n in others))
    exchanged = [_difference_where_swapped(guard, name, n) for n in others]
    parts = [d.Product(of=(fault(guard, name), alone, gone)), *exchanged]
    signs = [1.0 if guard.names().index(n) > place else -1.0 for n in others]
    return d.Affine(weights=(1.0, *signs), of=tuple(parts))


def _ordered(guard: SensorGuard, one: str, other: str) -> tuple[str, str]:
    first, second = sorted((one, other), key=guard.names().index)
    return first, second


def swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    """1 once two readings are where each other was, until the next start; else 0."""
    return _swapped(guard, *_ordered(guard, one, other))


def _difference_where_swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    first, second = _ordered(guard, one, other)
    return _difference_of_swapped(guard, first, second)


@_shared
def _difference_of_swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    return d.Product(of=(_swapped(guard, one, other), _difference(one, other)))


@_shared
def _difference(one: str, other: str) -> d.Driver:
    return d.Affine(weights=(1.0, -1.0), of=(d.Input(name=one), d.Input(name=other)))


@_shared
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
        of=(_settled_lately(guard), *_squares(guard, one, other), _anybody(guard)),
    )
    return d.Switch(of=seen, on=alone, off=NO_SQUARE)


@_shared
def _settled_lately(guard: SensorGuard) -> d.Driver:
    since = d.Affine(weights=(1.0, JUST_NOW - LATELY), of=(_since_settled(guard), _anybody(guard)))
    return d.Switch(of=since, on=JUST_NOW, off=JUST_NOW - TIE)


@_shared
def _anybody(guard: SensorGuard) -> d.Driver:
    """1 while any sensor has departed or stands still; else 0."""
    return _any_of(*(plain_fault(guard, n) for n in guard.names()))


@_shared
def _since_settled(guard: SensorGuard) -> d.Driver:
    """exp(-time since all was settled / horizon)."""
    return d.Lag(of=settled(guard), tau_up=AT_ONCE, tau_down=guard.horizon_s)


def _squares(guard: SensorGuard, one: str, other: str) -> tuple[d.Driver, ...]:
    """(x - y)^2, (x - y')^2, (y - x')^2, with x', y' when all was settled, K2."""
    crosswise = [
        d.Affine(weights=(1.0, -1.0), of=(d.Input(name=a), when_settled(guard, b)))
        for a, b in ((one, other), (other, one))
    ]
    return tuple(map(_squared, (_difference(one, other), *crosswise)))


@_shared
def when_settled(guard: SensorGuard, name: str) -> d.Driver:
    """The reading, over minutes, when last all was settled."""
    return _as_it_was(guard, _minutes_ago(guard, name), settled(guard))


@_shared
def _minutes_ago(guard: SensorGuard, name: str) -> d.Driver:
    within = d.Clip(of=d.Input(name=name), low=guard.sensor(name).low, high=guard.sensor(name).high)
    return _lag(within, guard.swap_s)


def _squared(of: d.Driver) -> d.Driver:
    return d.Product(of=(of, of))


def guarded(driver: d.Driver, guard: SensorGuard) -> d.Driver:
    """The driver with every guarded sensor's reading replaced by its guarded one."""
    if isinstance(driver, d.Input):
        return reading(guard, driver.name) if driver.name in guard.names() else driver
    of = getattr(driver, "of", None)
    if of is None:
        return driver
    inside = tuple(guarded(child, guard) for child in of) if isinstance(of, tuple) else guarded(of, guard)
    return driver.model_copy(update={"of": inside})
