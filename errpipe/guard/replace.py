"""The guarded reading: a sensor's own while it is believed, else what stands in for it.

The letters are those of `errpipe.guard.description`.
"""

from __future__ import annotations

from errpipe.domain import composed as c
from errpipe.domain import driver as d
from errpipe.guard.blame import TIE, anybody, as_it_was, fault, found, in_order, stirred, swapped
from errpipe.guard.description import SensorGuard
from errpipe.guard.statistics import FAR, delayed, departure, shared, stillness

SUSPECT = 0.6  # of the threshold: from here what a reading is off by is no longer remembered
CLEARED = 0.48  # of the threshold: from here down it is again


def guarded(driver: d.Driver, guard: SensorGuard) -> d.Driver:
    """The driver with every guarded sensor's reading replaced by its guarded one."""
    if isinstance(driver, d.Input):
        return reading(guard, driver.name) if driver.name in guard.names() else driver
    of = getattr(driver, "of", None)
    if of is None:
        return driver
    inside = tuple(guarded(child, guard) for child in of) if isinstance(of, tuple) else guarded(of, guard)
    return driver.model_copy(update={"of": inside})


@shared
def reading(guard: SensorGuard, name: str) -> d.Driver:
    """The reading while it is believed, else what stands in for it."""
    sensor = guard.sensor(name)
    others = tuple(delayed(s, _off(guard, s.name)) for s in sensor.sources)
    estimated = d.Affine(weights=(1.0, *sensor.estimate), of=(_gone(guard, name), *others))
    parts: tuple[d.Driver, ...] = (d.Input(name=name), _instead(guard, name, estimated))
    beyond = excess(guard, name)
    if beyond is not None:
        parts = (*parts, beyond)
    return d.Affine(weights=(1.0, *(-1.0,) * (len(parts) - 1)), of=parts)


@shared
def excess(guard: SensorGuard, name: str) -> d.Driver | None:
    """How far a reading is beyond what both of its witnesses allow, K; 0 once a sensor is known to have failed.

    So much of a fault that nobody has seen yet is kept away; and one witness that fails itself changes nothing.
    None where a sensor has no witnesses.
    """
    sensor = guard.sensor(name)
    if not sensor.witnesses:
        return None
    over: list[d.Driver] = []
    under: list[d.Driver] = []
    for witness in sensor.witnesses:
        sources = tuple(delayed(s, d.Input(name=s.name)) for s in witness.sources)
        departed = c.less(d.Input(name=name), sources, witness.weights)
        usual = c.lag(departed, guard.corridor_s)
        for side, sign in ((over, -1.0), (under, 1.0)):
            beyond = d.Affine(offset=sign * witness.within, weights=(1.0, -1.0), of=(departed, usual))
            side.append(d.Clip(of=beyond, low=0.0 if sign < 0 else -FAR, high=FAR if sign < 0 else 0.0))
    parts, weights = [over[0], under[0]], [1.0, 1.0]
    for one, other in zip((over[0], under[0]), (over[1:], under[1:]), strict=True):
        low, high = (0.0, FAR) if one is over[0] else (-FAR, 0.0)
        for two in other:
            parts.append(d.Clip(of=d.Affine(weights=(1.0, -1.0), of=(one, two)), low=low, high=high))
            weights.append(-1.0)
    return d.Product(of=(c.negated(found(guard)), d.Affine(weights=tuple(weights), of=tuple(parts))))


@shared
def remembered(guard: SensorGuard, name: str) -> d.Driver:
    """The departure r that a sensor had while it was last believed, K: what its estimate is off by."""
    sensor = guard.sensor(name)
    believed = departure(sensor)
    beyond = excess(guard, name)
    if beyond is not None:
        believed = d.Affine(weights=(1.0, -1.0), of=(believed, beyond))
    within = d.Clip(of=believed, low=-sensor.reach, high=sensor.reach)
    return as_it_was(guard, c.lag(within, guard.settle_s), _at_ease(guard, name))


@shared
def calm(guard: SensorGuard) -> d.Driver:
    """1 while no sensor is at fault and none is about to be: what is seen now may be remembered; else 0."""
    return c.none_of(anybody(guard), *stirred(guard, SUSPECT, CLEARED))


@shared
def _at_ease(guard: SensorGuard, name: str) -> d.Driver:
    """1 while what a sensor is off by may be remembered; else 0."""
    return d.Product(of=(calm(guard), c.negated(asleep(guard, name))))


@shared
def asleep(guard: SensorGuard, name: str) -> d.Driver:
    """1 while a reading moves less than it mostly does when healthy: it may just have got stuck; else 0."""
    sensor = guard.sensor(name)
    if sensor.lively is None:
        return d.Constant(value=0.0)
    alive = d.Affine(weights=(-1.0,), of=(stillness(guard, sensor),))
    return d.Switch(of=alive, on=-sensor.lively, off=-sensor.lively * (1.0 + TIE))


@shared
def _gone(guard: SensorGuard, name: str) -> d.Driver:
    """How far a reading has departed since it was last believed."""
    return d.Affine(weights=(1.0, -1.0), of=(departure(guard.sensor(name)), remembered(guard, name)))


@shared
def _off(guard: SensorGuard, name: str) -> d.Driver:
    return _instead(guard, name, _gone(guard, name))


def _instead(guard: SensorGuard, name: str, gone: d.Driver) -> d.Driver:
    """What a reading is off by: where it is swapped, its difference to the other; where it failed else, `gone`."""
    place = guard.names().index(name)
    others = [n for n in guard.names() if n != name]
    alone = c.none_of(*(swapped(guard, name, n) for n in others))
    exchanged = [_difference_where_swapped(guard, name, n) for n in others]
    parts = [d.Product(of=(fault(guard, name), alone, gone)), *exchanged]
    signs = [1.0 if guard.names().index(n) > place else -1.0 for n in others]
    return d.Affine(weights=(1.0, *signs), of=tuple(parts))


def _difference_where_swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    first, second = in_order(guard, one, other)
    return _difference_of_swapped(guard, first, second)


@shared
def _difference_of_swapped(guard: SensorGuard, one: str, other: str) -> d.Driver:
    return d.Product(of=(swapped(guard, one, other), c.difference(one, other)))
