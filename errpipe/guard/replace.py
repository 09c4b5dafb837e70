"""The guarded reading: a sensor's own while it is accepted, else its estimate from the others, as drivers.

The letters are those of `errpipe.guard.description`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from errpipe.domain import driver as d
from errpipe.guard import composed as c
from errpipe.guard.description import SensorGuard
from errpipe.guard.detect import TIE_TOLERANCE, all_normal, faults, shared, trust
from errpipe.guard.rules import activity

NEWLY_S = 60.0  # well below the time constant of a body, above the reading interval of a logger (by judgement)
LONGEST_S = 1e9  # time constant of clocks: longer than any session


def trusted(
    driver: d.Driver, guard: SensorGuard, within: Mapping[str, tuple[float, float]] | None = None, apart: bool = True
) -> d.Driver:
    """`guarded`, times `trust`; a driver without guarded sensors is unchanged."""
    if not _reads(driver, guard):
        return driver
    return d.Product(of=(guarded(driver, guard, within, apart), trust(guard)))


def guarded(
    driver: d.Driver, guard: SensorGuard, within: Mapping[str, tuple[float, float]] | None = None, apart: bool = True
) -> d.Driver:
    """The driver with every guarded sensor's reading replaced by its guarded one.

    apart: as the driver plus what the replacements change of it (exactly 0 while none has failed). A guarded reading is
    known only once every sensor has a reading, and the lags and first values of it start then, not with the run;
    those of the driver itself start with their own sensor. It takes one node more for each lag.

    within: sensor -> range of an estimate, degC; default: the range of a healthy sensor. Without a
    range the latched values, which contain a clock, would leave the correction unbounded.
    """
    if not _reads(driver, guard) or (apart and isinstance(driver, d.First)):
        return driver
    if isinstance(driver, d.Input) and driver.name in guard.kept_names():
        return d.Affine(weights=(1.0, 1.0), of=(driver, _kept(guard, driver.name)))
    if isinstance(driver, d.Input):
        k = guard.names().index(driver.name)
        low, high = (within or {}).get(driver.name, (guard.sensors[k].low, guard.sensors[k].high))
        return d.Clip(of=readings(guard)[k], low=low, high=high)
    if apart and _is_linear(driver) and _has_lag(driver, guard):
        return d.Affine(weights=(1.0, 1.0), of=(driver, _change(driver, guard, within)))
    inside = _with_operands(driver, lambda x: guarded(x, guard, within, apart))
    missed = _missed_rise(driver, guard) if apart else None
    return inside if missed is None else d.Affine(weights=(1.0, 1.0), of=(inside, missed))


def _change(driver: d.Driver, guard: SensorGuard, within: Mapping[str, tuple[float, float]] | None) -> d.Driver:
    """What guarded readings change of a driver that reads some."""
    if isinstance(driver, d.Input) and driver.name in guard.kept_names():
        return _kept(guard, driver.name)
    if isinstance(driver, d.Affine):
        parts = [p for p in zip(driver.weights, driver.of, strict=True) if _reads(p[1], guard)]
        changes = tuple(_change(x, guard, within) for _, x in parts if not isinstance(x, d.First))
        weights = tuple(weight for weight, x in parts if not isinstance(x, d.First))
        if (missed := _missed_rise(driver, guard)) is not None:
            return d.Affine(weights=(1.0, 1.0), of=(*changes, missed))
        return changes[0] if weights == (1.0,) else d.Affine(weights=weights, of=changes)
    if _is_linear(driver):
        return _with_operands(driver, lambda x: _change(x, guard, within))
    return d.Affine(weights=(1.0, -1.0), of=(guarded(driver, guard, within), driver))


def _missed_rise(driver: d.Driver, guard: SensorGuard) -> d.Driver | None:
    """What the rise of a sensor lacks that had no reading at the start, K; 0 if it had one; None if not estimated.

    Its first reading minus the one it usually has at a start, by those of the others. It counts if the first reading
    was later than the others', on average, by `NEWLY_S`: nothing shows how all of them were before.
    """
    k = next((k for k, s in enumerate(guard.sensors) if s.start is not None and driver == d.rise(s.name)), None)
    start = None if k is None else guard.sensors[k].start
    if k is None or start is None:
        return _risen_as_others(driver, guard)
    own, count = guard.names()[k], len(guard.sensors) - 1
    others = [(n, w) for n, w in zip(guard.names(), start.weights, strict=True) if n != own]
    names = (own, *(n for n, _ in others))
    weights = (1.0, *(-w for _, w in others))
    beyond = d.Affine(offset=-start.usual, weights=weights, of=tuple(map(d.at_start, names)))
    when = tuple(d.First(of=d.Affine(weights=(1.0, 0.0), of=(_clock(), d.Input(name=n)))) for n in names)
    late = d.Clip(of=d.Affine(weights=(1.0, *[-1.0 / count] * count), of=when), low=0.0, high=1.0)
    return d.Product(of=(late, d.Clip(of=beyond, low=start.limits[0], high=start.limits[1])))


def _risen_as_others(driver: d.Driver, guard: SensorGuard) -> d.Driver | None:
    """Of the rise of a sensor that others can replace: its estimate when its first reading came, K; else None.

    0 if all sensors have their first reading together. Of a sensor that is not the last one it has faded by then.
    """
    replaced = (s for s in guard.sensors if guard.compares and s.stands_in and any(s.estimate))
    sensor = next((s for s in replaced if driver == d.rise(s.name)), None)
    if sensor is None:
        return None
    others = [(w, d.rise(o.name)) for w, o in zip(sensor.estimate, guard.sensors, strict=True) if w]
    estimate = d.Affine(weights=tuple(w for w, _ in others), of=tuple(x for _, x in others))
    there = d.Affine(offset=1.0, weights=(0.0,), of=(d.Input(name=sensor.name),))
    newly = d.Affine(offset=1.0, weights=(-1.0,), of=(d.lag(there, NEWLY_S),))
    return d.First(of=d.Product(of=(estimate, newly)))


def _clock() -> d.Driver:
    """Time since the start, in `NEWLY_S`."""
    return d.lag(d.Constant(value=LONGEST_S / NEWLY_S), LONGEST_S)


def _reads(driver: d.Driver, guard: SensorGuard) -> bool:
    return not set(d.inputs(driver)).isdisjoint((*guard.names(), *guard.kept_names()))


def _is_linear(driver: d.Driver) -> bool:
    return isinstance(driver, d.Affine) or (isinstance(driver, d.Lag) and driver.tau_up == driver.tau_down)


def _has_lag(driver: d.Driver, guard: SensorGuard) -> bool:
    """Whether a lag of a guarded reading is in a driver."""
    if isinstance(driver, d.Lag):
        return _reads(driver, guard)
    of = getattr(driver, "of", ())
    return any(_has_lag(x, guard) for x in (of if isinstance(of, tuple) else (of,)))


def _with_operands(driver: d.Driver, change: Callable[[d.Driver], d.Driver]) -> d.Driver:
    of = getattr(driver, "of", None)
    if of is None:
        return driver
    inside = tuple(map(change, of)) if isinstance(of, tuple) else change(of)
    return driver.model_copy(update={"of": inside})


@shared
def readings(guard: SensorGuard) -> tuple[d.Driver, ...]:
    """Per sensor the reading while it is accepted, else its replacement."""
    failed, gone = faults(guard), tuple(_shift_since_trusted(guard, i) for i in range(len(guard.sensors)))
    alone = tuple(d.Product(of=pair) for pair in zip(failed, gone, strict=True))
    weights, out = [s.estimate for s in guard.sensors], []
    for i, name in enumerate(guard.names()):
        fault, others = gone[i], [j for j in range(len(gone)) if j != i]
        if guard.most_failed > 1:
            both = {j: weights[i][j] * weights[j][i] for j in others}  # feedback through the other failed sensor
            through = tuple(b / (1.0 - b) for b in both.values())
            own = d.Affine(offset=1.0, weights=through, of=tuple(failed[j] for j in others))
            shown = tuple(weights[i][j] / (1.0 - b) for j, b in both.items())
            fault = d.Affine(weights=(1.0, *shown), of=(d.Product(of=(gone[i], own)), *(alone[j] for j in others)))
        out.append(d.Affine(weights=(1.0, -1.0), of=(d.Input(name=name), d.Product(of=(failed[i], fault)))))
    return tuple(out)


@shared
def _kept(guard: SensorGuard, name: str) -> d.Driver:
    """What is added to the reading of a sensor that is not compared: 0 while it is consistent with those that are."""
    (sensor,) = (s for s in guard.kept if s.name == name)
    others = [(v, x) for v, x in zip(sensor.estimate, readings(guard), strict=True) if v]
    of = (d.Input(name=name), *(x for _, x in others))
    beyond = c.since_start(d.Affine(weights=(1.0, *(-v for v, _ in others)), of=of))
    counted = d.Clip(of=beyond, low=-sensor.within, high=sensor.within)
    return d.Affine(weights=(1.0, -1.0), of=(counted, beyond))


@shared
def _shift_since_trusted(guard: SensorGuard, i: int) -> d.Driver:
    """r - m: how far one reading has moved from its estimate since it was last trusted."""
    inputs, weights = [d.Input(name=n) for n in guard.names()], guard.sensors[i].estimate
    if not guard.compares:
        return _residual_shift(guard, i, inputs[i])
    own = tuple(1.0 if j == i else -v for j, v in enumerate(weights))
    return _residual_shift(guard, i, d.Affine(weights=own, of=tuple(inputs)))


def _residual_shift(guard: SensorGuard, i: int, residual_of: d.Driver) -> d.Driver:
    """How far a residual has moved since sensor i was last trusted."""
    sensor = guard.sensors[i]
    residual = c.since_start(residual_of)
    within = d.Clip(of=residual, low=-sensor.reach, high=sensor.reach)
    return d.Affine(weights=(1.0, -1.0), of=(residual, _value_at_last_normal(guard, i, c.lag(within, guard.settle_s))))


def _value_at_last_normal(guard: SensorGuard, i: int, value: d.Driver) -> d.Driver:
    """The value when all residuals were last below their thresholds and this sensor changed.

    No operation latches a decreasing value; so a faster rising clock is added, and subtracted once both are latched.
    """
    sensor = guard.sensors[i]
    gate = all_normal(guard)
    if sensor.lively is not None:
        moving = d.Switch(
            of=activity(d.Input(name=sensor.name)), on=sensor.lively, off=sensor.lively * (1.0 - TIE_TOLERANCE)
        )
        gate = d.Product(of=(gate, moving))
    rising = d.Affine(weights=(1.0, 1.0), of=(value, _rising_clock(guard)))
    return d.Affine(weights=(1.0, -1.0), of=(c.held(rising, gate), c.held(_rising_clock(guard), gate)))


@shared
def _rising_clock(guard: SensorGuard) -> d.Driver:
    """Rises without limit, faster than any latched value, K."""
    fastest = max(2.0 * s.reach / guard.settle_s for s in guard.sensors)
    return d.lag(d.Constant(value=2.0 * fastest * LONGEST_S), LONGEST_S)
