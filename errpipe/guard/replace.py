"""The guarded reading: a sensor's own while it is accepted, else its estimate from the others, as drivers.

The letters are those of `errpipe.guard.description`.
"""

from __future__ import annotations

from collections.abc import Mapping

from errpipe.domain import driver as d
from errpipe.guard import composed as c
from errpipe.guard.description import SensorGuard
from errpipe.guard.detect import TIE_TOLERANCE, all_normal, faults, shared, trust
from errpipe.guard.rules import activity

LONGEST_S = 1e9  # time constant of the rising clock added to latched values: longer than any session


def trusted(driver: d.Driver, guard: SensorGuard, within: Mapping[str, tuple[float, float]] | None = None) -> d.Driver:
    """`guarded`, times `trust`; a driver without guarded sensors is unchanged."""
    if set(d.inputs(driver)).isdisjoint(guard.names()):
        return driver
    return d.Product(of=(guarded(driver, guard, within), trust(guard)))


def guarded(driver: d.Driver, guard: SensorGuard, within: Mapping[str, tuple[float, float]] | None = None) -> d.Driver:
    """The driver with every guarded sensor's reading replaced by its guarded one.

    within: sensor -> range of an estimate, degC; default: the range of a healthy sensor. Without a
    range the latched values, which contain a clock, would leave the correction unbounded.
    """
    if isinstance(driver, d.Input):
        names = guard.names()
        if driver.name not in names:
            return driver
        k = names.index(driver.name)
        low, high = (within or {}).get(driver.name, (guard.sensors[k].low, guard.sensors[k].high))
        return d.Clip(of=readings(guard)[k], low=low, high=high)
    of = getattr(driver, "of", None)
    if of is None:
        return driver
    inside = tuple(guarded(x, guard, within) for x in of) if isinstance(of, tuple) else guarded(of, guard, within)
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
