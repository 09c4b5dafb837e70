"""What a sensor guard looks at: departures from estimates, their quick and slow part, how much alive a reading is.

The letters are those of `errpipe.guard.description`.
"""

from __future__ import annotations

from functools import lru_cache

from errpipe.domain import composed as c
from errpipe.domain import driver as d
from errpipe.guard.description import GuardedSensor, SensorGuard, Source

MUTED = 1.0  # per K outside the starts learnt from: of the slow statistic
FAR = 1e3  # K

# The same part asked for again is the same object, so that whoever walks a driver can know it again.
shared = lru_cache(maxsize=1024)


@shared
def departure(sensor: GuardedSensor) -> d.Driver:
    """r: how far a reading has moved away from its best estimate since the start of the run."""
    sources = tuple(delayed(s, d.Input(name=s.name)) for s in sensor.sources)
    return c.since_start(c.less(d.Input(name=sensor.name), sources, sensor.estimate))


@shared
def apart(sensor: GuardedSensor) -> d.Driver:
    """p: the departure that tells sensors apart."""
    return c.since_start(c.less(d.Input(name=sensor.name), tuple(map(c.reading_of, sensor.others)), sensor.weights))


def delayed(source: Source, of: d.Driver) -> d.Driver:
    """A driver through the lag of a source, where it has one."""
    return of if source.lag_s is None else c.lag(of, source.lag_s)


@shared
def quick(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """|quick_i|: 1 and more is a fault somewhere."""
    scaled = d.Affine(weights=(1.0 / sensor.quick,), of=(apart(sensor),))
    recent = d.Affine(weights=(1.0, -1.0), of=(scaled, c.lag(scaled, guard.horizon_s)))
    return c.size(c.lag(recent, guard.filter_s))


@shared
def slow(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """|slow_i|: 1 and more is a fault somewhere; less of it where a start is unlike those learnt from.

    How sensors stand to each other over a day changes with the season, what an hour brings hardly does.
    """
    size = c.size(c.lag(d.Affine(weights=(1.0 / sensor.slow,), of=(apart(sensor),)), guard.filter_s))
    return d.Affine(weights=(1.0, -MUTED), of=(size, unlike(guard)))


@shared
def unlike(guard: SensorGuard) -> d.Driver:
    """How far outside the starts learnt from this session began, mean over sensors, K."""
    nodes: list[d.Driver] = []
    for s in guard.sensors:
        start = d.First(of=d.Input(name=s.name))
        low, high = s.starts
        nodes.append(d.Clip(of=d.Affine(offset=low, weights=(-1.0,), of=(start,)), low=0.0, high=FAR))
        nodes.append(d.Clip(of=d.Affine(offset=-high, weights=(1.0,), of=(start,)), low=0.0, high=FAR))
    return d.Affine(weights=(1.0 / len(guard.sensors),) * len(nodes), of=tuple(nodes))


@shared
def stillness(guard: SensorGuard, sensor: GuardedSensor) -> d.Driver:
    """How much alive a reading is: the lagged square of its own quick part, K2. Starts at 0."""
    reading = d.Input(name=sensor.name)
    moving = d.Affine(weights=(1.0, -1.0), of=(reading, c.lag(reading, guard.freeze_s)))
    return c.lag(d.Product(of=(moving, moving)), guard.freeze_s)
