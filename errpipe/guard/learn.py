"""Learning a sensor guard from healthy readings.

Thresholds keep a stated false-alarm rate: the largest departures of every two hours, on readings that had no part in
the weights, are extrapolated to the stated rate by the law of largest values (generalised, by L-moments:
Hosking 1990). With few hours of learning that extrapolates far; `hours` says how many there were.

The rate holds for conditions that were learnt. On a real turning centre no run of 23 gave a false alarm to a guard
learnt from the other 22. Learnt from 7 spring runs alone, 9 of 16 winter runs did, 8 of them by the slow statistic of
one sensor, whose relation to the others changes with the season; since that statistic is muted where a session starts
outside the starts learnt from, 1 of 16 does.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.evaluation import drive
from errpipe.drivers.sessions import sessions
from errpipe.errors import DataError
from errpipe.guard import blame, weights, witness
from errpipe.guard import description as g
from errpipe.guard.rows import LAGS, Healthy, centred, lagged, left_out, ridge_weights, rises, rows_of, seldom
from errpipe.guard.weights import LEAST_NOISE

FILTER = 300.0  # s: machines warm up over minutes and more, noise and switching heaters are quicker
FREEZE = 300.0  # s
HORIZON = 3600.0  # s
SETTLE = 1800.0  # s: what is remembered of a departure
SWAP = 300.0  # s
CORRIDOR = 7200.0  # s: a reading is held to what its witnesses say of the last hours
MOST_HELD = 5  # sensors with witnesses: a table has room for no more beside a thermal model
BEYOND_TURNS = 2.0  # times the farthest that the difference of two healthy readings turns round within minutes
REACH = 2.0  # times the largest departure of healthy readings
LIVELY = 0.2  # of the time a healthy reading is stiller
RIDGES = np.logspace(-5, 1, 13)  # times the readings' mean square, of the best estimates
KINDS = 3  # of alarms: quick, slow, frozen
FAINTEST = 1e-8  # of the usual liveliness: below, a sensor that is frozen would be told after days
BEYOND = 0.5  # of the range seen, on either side, and RANGE_MARGIN: readings outside are impossible
RANGE_MARGIN = 10.0  # K


def learn(
    recording: Recording,
    sensors: Sequence[str] | None = None,
    *,
    group: str | None = None,
    false_alarms: float = 0.5,
    filter_s: float = FILTER,
    horizon_s: float = HORIZON,
    freeze_s: float = FREEZE,
) -> g.SensorGuard:
    """Learn from a recording whose sensors were healthy (clean it first).

    sensors: default all temperatures. group: column whose labels are left out one by one (default: runs).
    false_alarms: expected alarms per 1000 hours, all sensors together. Raises DataError where there are fewer
    than two sensors, two groups, or ten hours.
    """
    names = tuple(sensors) if sensors is not None else recording.names("temperature")
    x, run, t, held_out = rows_of(recording, names, group)
    hours = float(sum(np.ptp(t[run == r]) for r in np.unique(run)) / 3600)
    if len(names) < 2 or np.unique(held_out).size < 2 or hours < 10:
        raise DataError(
            f"a sensor guard needs two sensors, two groups and 10 hours of readings"
            f" (found: {len(names)}, {np.unique(held_out).size}, {hours:.1f})"
        )
    rows = Healthy(x, run, t, held_out, filter_s, horizon_s)
    rate = false_alarms / 1000 / len(names) / KINDS  # per hour, sensor and kind of alarm
    apart, close = weights.apart(rows, rate), _close(rows)
    alive = lagged((x - lagged(x, run, t, freeze_s)) ** 2, run, t, freeze_s)
    begun = x - rises(x, run)
    sensors_out = []
    for i, name in enumerate(names):
        others = [j for j in range(len(names)) if j != i]
        low, high = np.min(x[:, i]), np.max(x[:, i])
        margin = max(BEYOND * (high - low), RANGE_MARGIN)
        static, offset = _static(x[:, others], x[:, i])
        sensors_out.append(
            g.GuardedSensor(
                name=name,
                low=float(low - margin),
                high=float(high + margin),
                max_rate=float(blame.RATE * _fastest(x[:, i], run, t)),
                others=tuple(names[j] for j in others),
                weights=tuple(float(apart.weights[i, j]) for j in others),
                sources=tuple(g.Source(name=names[j], lag_s=lag) for lag in (None, *LAGS) for j in others),
                estimate=tuple(float(close.weights[i, k, j]) for k in range(1 + len(LAGS)) for j in others),
                static=static,
                offset=offset,
                residual=float(np.sqrt(np.mean(close.residual[:, i] ** 2))),
                quick=float(apart.quick[i]),
                slow=float(apart.slow[i]),
                starts=(float(begun[:, i].min()), float(begun[:, i].max())),
                reach=float(max(REACH * np.max(np.abs(close.since_start[:, i])), 1e-3)),
                lively=_lively(alive[:, i]),
                still=_still(alive[:, i], run, t, rate, freeze_s),
            )
        )
    return g.SensorGuard(
        sensors=tuple(sensors_out),
        filter_s=filter_s,
        horizon_s=horizon_s,
        freeze_s=freeze_s,
        settle_s=SETTLE,
        swap_s=SWAP,
        corridor_s=CORRIDOR,
        turns=_turns(rows, SWAP, rate),
        false_alarms=false_alarms,
        hours=hours,
        shows_elsewhere=apart.elsewhere(),
    )


def hold(
    guard: g.SensorGuard,
    recording: Recording,
    drivers: Sequence[d.Driver],
    *,
    group: str | None = None,
    most: int = MOST_HELD,
) -> g.SensorGuard:
    """The guard with witnesses for the sensors whose unseen faults these drivers follow most, at most so many.

    recording: the healthy one that the guard was learnt from. A sensor that no driver follows gets none.
    """
    cost = _cost_of_unseen(guard, recording, drivers)
    held = [n for n in sorted(cost, key=lambda n: -cost[n])[:most] if cost[n] > 0]
    names = guard.names()
    x, run, t, groups = rows_of(recording, names, group)
    rows = Healthy(x, run, t, groups, guard.filter_s, guard.horizon_s)
    shifts = centred(rows.stacked, run, t)
    seen = witness.Rows(names, shifts, rows.stacked, groups, (None, *LAGS), rows.lagged, guard.corridor_s)
    sensors = [
        s.model_copy(update={"witnesses": witness.witnesses(seen, s.name) if s.name in held else ()})
        for s in guard.sensors
    ]
    return guard.model_copy(update={"sensors": tuple(sensors)})


def _cost_of_unseen(guard: g.SensorGuard, recording: Recording, drivers: Sequence[d.Driver]) -> dict[str, float]:
    """What the fastest drift that the quick statistic never sees makes of the drivers, mean square in their own.

    A steady drift reads there as what it grows by in a horizon. It begins half-way through every session.
    """
    run, t = sessions(recording), recording.time()
    since = np.zeros(t.size)
    for code in np.unique(run):
        mine = run == code
        since[mine] = t[mine] - (t[mine].min() + t[mine].max()) / 2
    grown = np.maximum(since / guard.horizon_s, 0.0)
    before = [drive(node, recording) for node in drivers]
    cost = {}
    for s in guard.sensors:
        spoilt = recording.frame.assign(**{s.name: recording.array(s.name) + s.quick * grown})
        moved = [drive(n, Recording(recording.manifest, spoilt)) - was for n, was in zip(drivers, before, strict=True)]
        share = [np.nanmean(m**2) / max(float(np.nanmean(b**2)), 1e-30) for m, b in zip(moved, before, strict=True)]
        cost[s.name] = float(np.nansum(share))
    return cost


def _turns(rows: Healthy, swap_s: float, rate: float) -> tuple[float, ...]:
    """How far apart two readings must be for an exchange within minutes to be none that healthy ones make, K.

    The difference of two that are exchanged turns round, as far as it was; that of healthy ones crosses zero now and
    then, and hardly gets anywhere within minutes. Pairs in order; none is believed to turn round less than
    most.
    """
    before = rows.lagged(rows.x, swap_s)
    noise = np.std(np.diff(rows.x, axis=0)[np.diff(rows.run) == 0], axis=0)
    out = []
    for i, j in combinations(range(rows.x.shape[1]), 2):
        now, then = rows.x[:, i] - rows.x[:, j], before[:, i] - before[:, j]
        turned = np.where(now * then < 0, np.minimum(np.abs(now), np.abs(then)), 0.0)
        level = seldom(turned, rows.run, rows.t, 2.0 * rate / (rows.x.shape[1] - 1), lightest=1e-6)
        out.append(max(BEYOND_TURNS * level, LEAST_NOISE * float(noise[i] + noise[j]), 1e-6))
    typical = float(np.median(out))
    return tuple(max(turn, typical) for turn in out)


@dataclass(frozen=True)
class _Close:
    """Weights (sensors, 1 + lags, sensors) of the best estimates; what they leave of rows left out, (rows, sensors)."""

    weights: np.ndarray
    residual: np.ndarray
    since_start: np.ndarray


def _close(rows: Healthy) -> _Close:
    """With the ridge that leaves the least of groups left out.

    Learnt from what changes within a shift, for an estimate only has to carry a reading on from where it was last
    believed.
    """
    values = rows.stacked
    shifts = centred(values, rows.run, rows.t)
    left = {r: left_out(shifts, shifts, rows.group, r) for r in RIDGES}
    ridge = min(left, key=lambda r: float(np.sum(np.log(np.mean(left[r] ** 2, axis=0)))))
    return _Close(ridge_weights(shifts, ridge), left[ridge], left_out(values, shifts, rows.group, ridge))


def _lively(alive: np.ndarray) -> float | None:
    """The stillness that a healthy sensor is seldom below."""
    level = float(np.quantile(alive, LIVELY))
    return level if level > 0 else None


def _static(others: np.ndarray, own: np.ndarray) -> tuple[tuple[float, ...], float]:
    """Weights and offset of a sensor as a plain sum of the others' readings."""
    centre, middle = others.mean(axis=0), float(own.mean())
    square = (others - centre).T @ (others - centre) / len(own)
    ridge = 1e-3 * np.mean(np.diag(square)) * np.eye(square.shape[0])
    weights = np.linalg.solve(square + ridge, (others - centre).T @ (own - middle) / len(own))
    return tuple(float(w) for w in weights), middle - float(centre @ weights)


def _still(alive: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float, tau: float) -> float | None:
    """The stillness that a healthy sensor hardly ever reaches; None where it stands still when healthy."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    told = since > blame.WARM_UP * tau
    if not told.any() or alive[told].min() <= 0:
        return None
    # Near 0 a square of noise is distributed as a power, so minus its logarithm has Gumbel's tail.
    level = np.exp(-seldom(-np.log(alive[told]), run[told], t[told], per_hour, lightest=1e-6))
    return float(level) if level > FAINTEST * np.median(alive[told]) else None


def _fastest(x: np.ndarray, run: np.ndarray, t: np.ndarray) -> float:
    same = (np.diff(run) == 0) & (np.diff(t) > 0)
    return float(np.max(np.abs(np.diff(x)[same]) / np.diff(t)[same], initial=1e-6))
