"""Learning a sensor guard from healthy readings, and watching a recording with it.

Thresholds keep a stated false-alarm rate: the largest departures of every two hours, on readings that had no part in
the weights, are extrapolated to the stated rate by the law of largest values (generalised, by L-moments:
Hosking 1990). With few hours of learning that extrapolates far; `hours` says how many there were.

The rate holds for conditions that were learnt. On a real turning centre no run of 23 gave a false alarm to a guard
learnt from the other 22. Learnt from 7 spring runs alone, 9 of 16 winter runs did, 8 of them by the slow statistic of
one sensor, whose relation to the others changes with the season; since that statistic is muted where a session starts
outside the starts learnt from, 1 of 16 does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain import sensor_guard as g
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import sensor_witness
from errpipe.terms._base import drive, sessions

FILTER = 300.0  # s: machines warm up over minutes and more, noise and switching heaters are quicker
FREEZE = 300.0  # s
HORIZON = 3600.0  # s
SETTLE = 1800.0  # s: what is remembered of a departure
SWAP = 300.0  # s
CORRIDOR = 14400.0  # s: a reading is held to what its witnesses say of the last hours
MOST_HELD = 5  # sensors with witnesses: a table has room for no more beside a thermal model
SHIFT = 36000.0  # s: estimates are learnt from what changes within one
BEYOND_TURNS = 2.0  # times the farthest that the difference of two healthy readings turns round within minutes
REACH = 2.0  # times the largest departure of healthy readings
LIVELY = 0.2  # of the time a healthy reading is stiller
LAGS = (300.0, 900.0, 3600.0, 14400.0)  # s: heat reaches one sensor later than another, some much later
RIDGES = np.logspace(-5, 1, 25)  # times the readings' mean square; the smallest is taken that keeps faults apart
APART = 0.8  # of a fault at most shows in another sensor's statistic, or the wrong sensor is blamed
KINDS = 3  # of alarms: quick, slow, frozen
BLOCK = 7200.0  # s: largest values are taken per two hours, beyond which residuals know little of each other
LIGHTEST = 0.25  # shape of the law of largest values: lighter is not believed of few hours
FAINTEST = 1e-8  # of the usual liveliness: below, a sensor that is frozen would be told after days
LEAST_NOISE = 3.0  # times the readings' own noise: no threshold lies below
BEYOND = 0.5  # of the range seen, on either side, and RANGE_MARGIN: readings outside are impossible
RANGE_MARGIN = 10.0  # K


@dataclass(frozen=True)
class Watch:
    """What a guard made of a recording. Arrays have shape (rows, sensors), sensors in the guard's order."""

    names: tuple[str, ...]
    fault: np.ndarray
    reading: np.ndarray


def watch(guard: g.SensorGuard, recording: Recording) -> Watch:
    """Faults (bool) and guarded readings, row by row and causal: as the compiled drivers do it."""
    conditioned, impossible = _conditioned(guard, recording)
    names = guard.names()
    found = _drive_all([*(g.fault(guard, n) for n in names), *(g.reading(guard, n) for n in names)], conditioned)
    return Watch(names, (found[:, : len(names)] > 0.5) | impossible, found[:, len(names) :])


def faults(guard: g.SensorGuard, recording: Recording) -> np.ndarray:
    """Which readings are not believed, shape (rows, sensors): `watch` without the readings that stand in."""
    conditioned, impossible = _conditioned(guard, recording)
    return (_drive_all([g.fault(guard, n) for n in guard.names()], conditioned) > 0.5) | impossible


class _Values(dict[str, np.ndarray]):
    """Columns by name, beside the runs and times of a recording: as much of one as `drive` looks at."""

    between = "held"  # a control knows no more than its last reading

    def __init__(self, recording: Recording):
        super().__init__()
        self.recording = recording

    def __len__(self) -> int:
        return len(self.recording)

    def array(self, name: str) -> np.ndarray:
        return self[name] if name in self else self.recording.array(name)

    def name(self, role: str) -> str | None:
        return self.recording.name(role)

    def run_codes(self) -> np.ndarray:
        return self.recording.run_codes()

    def time(self) -> np.ndarray:
        return self.recording.time()


def _drive_all(drivers: Sequence[d.Driver], recording: Recording) -> np.ndarray:
    """`drive` of several drivers with much in common, each part once; shape (rows, drivers)."""
    values = _Values(recording)
    walked: dict[int, str] = {}  # by identity: the drivers are alive as long as this function runs
    known: dict[d.Driver, str] = {}

    def name(driver: d.Driver) -> str:
        if id(driver) not in walked:
            walked[id(driver)] = driver.name if isinstance(driver, d.Input) else flat(driver)
        return walked[id(driver)]

    def flat(driver: d.Driver) -> str:
        of = getattr(driver, "of", None)
        if isinstance(of, tuple):
            driver = driver.model_copy(update={"of": tuple(d.Input(name=name(child)) for child in of)})
        elif of is not None:
            driver = driver.model_copy(update={"of": d.Input(name=name(of))})
        if driver not in known:
            known[driver] = f"#{len(known)}"
            values[known[driver]] = drive(driver, values)  # type: ignore[arg-type]
        return known[driver]

    return np.column_stack([values.array(name(driver)) for driver in drivers])


def _conditioned(guard: g.SensorGuard, recording: Recording) -> tuple[Recording, np.ndarray]:
    """Readings as a table's inputs give them on: what is empty, impossible or racing holds the one before."""
    columns, doubted = {}, []
    run, t = sessions(recording), recording.time()
    for s in guard.sensors:
        values, doubt = _believed(recording.array(s.name), run, t, s)
        columns[s.name] = values
        doubted.append(doubt)
    return Recording(recording.manifest, recording.frame.assign(**columns)), np.column_stack(doubted)


def _believed(x: np.ndarray, run: np.ndarray, t: np.ndarray, s: g.GuardedSensor) -> tuple[np.ndarray, np.ndarray]:
    out, doubt = x.copy(), np.zeros(x.size, dtype=bool)
    if _all_possible(x, run, t, s):
        return out, doubt
    good, when = np.nan, 0.0
    for i in range(x.size):
        if i == 0 or run[i] != run[i - 1]:
            good = np.nan
        possible = s.low <= x[i] <= s.high
        if possible and not np.isnan(good):
            possible = abs(x[i] - good) <= s.max_rate * max(t[i] - when, 1e-9)
        if possible:
            good, when = x[i], t[i]
        else:
            out[i], doubt[i] = good, True
    return out, doubt


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
    x, run, t, held_out = _rows(recording, names, group)
    hours = float(sum(np.ptp(t[run == r]) for r in np.unique(run)) / 3600)
    if len(names) < 2 or np.unique(held_out).size < 2 or hours < 10:
        raise DataError(
            f"a sensor guard needs two sensors, two groups and 10 hours of readings"
            f" (found: {len(names)}, {np.unique(held_out).size}, {hours:.1f})"
        )
    rows = _Healthy(x, run, t, held_out, filter_s, horizon_s)
    rate = false_alarms / 1000 / len(names) / KINDS  # per hour, sensor and kind of alarm
    apart, close = _apart(rows, rate), _close(rows)
    alive = _lagged((x - _lagged(x, run, t, freeze_s)) ** 2, run, t, freeze_s)
    begun = x - _rises(x, run)
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
                max_rate=float(g.RATE * _fastest(x[:, i], run, t)),
                others=tuple(names[j] for j in others),
                weights=tuple(float(apart.weights[i, 0, j]) for j in others),
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
        sensors=tuple(sensors_out), filter_s=filter_s, horizon_s=horizon_s, freeze_s=freeze_s,
        settle_s=SETTLE, swap_s=SWAP, corridor_s=CORRIDOR, turns=_turns(rows, SWAP, rate),
        false_alarms=false_alarms, hours=hours, shows_elsewhere=apart.elsewhere(),
    )  # fmt: skip


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
    x, run, t, groups = _rows(recording, names, group)
    rows = _Healthy(x, run, t, groups, guard.filter_s, guard.horizon_s)
    shifts = _centred(rows.stacked, run, t)
    seen = sensor_witness.Rows(names, shifts, rows.stacked, groups, (None, *LAGS), rows.lagged, guard.corridor_s)
    sensors = [
        s.model_copy(update={"witnesses": sensor_witness.witnesses(seen, s.name) if s.name in held else ()})
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


def _turns(rows: _Healthy, swap_s: float, rate: float) -> tuple[float, ...]:
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
        level = _seldom(turned, rows.run, rows.t, 2.0 * rate / (rows.x.shape[1] - 1), lightest=1e-6)
        out.append(max(BEYOND_TURNS * level, LEAST_NOISE * float(noise[i] + noise[j]), 1e-6))
    typical = float(np.median(out))
    return tuple(max(turn, typical) for turn in out)


def _all_possible(x: np.ndarray, run: np.ndarray, t: np.ndarray, s: g.GuardedSensor) -> bool:
    slow_enough = np.abs(np.diff(x)) <= s.max_rate * np.maximum(np.diff(t), 1e-9)
    return bool(np.all((x >= s.low) & (x <= s.high)) and np.all(slow_enough | (np.diff(run) != 0)))


@dataclass(frozen=True)
class _Healthy:
    """Readings of healthy sensors, shape (rows, sensors), and how they are to be looked at."""

    x: np.ndarray
    run: np.ndarray
    t: np.ndarray
    group: np.ndarray
    filter_s: float
    horizon_s: float

    @cached_property
    def stacked(self) -> np.ndarray:
        """Rises since the start of the run and their lags, shape (rows, 1 + lags, sensors)."""
        rise = _rises(self.x, self.run)
        return np.stack([rise, *(self.lagged(rise, tau) for tau in LAGS)], axis=1)

    def lagged(self, values: np.ndarray, tau: float) -> np.ndarray:
        return _lagged(values, self.run, self.t, tau)

    def recent(self, values: np.ndarray) -> np.ndarray:
        return values - self.lagged(values, self.horizon_s)


@dataclass(frozen=True)
class _Apart:
    """Weights (sensors, 1, sensors) and thresholds (sensors,) of the departures that tell sensors apart."""

    weights: np.ndarray
    quick: np.ndarray
    slow: np.ndarray

    def elsewhere(self) -> float:
        """The largest share of a fault of one sensor that shows in another one's departure, by thresholds."""
        shows = np.abs(self.weights[:, 0])
        return max(float(np.max(shows * t[None, :] / t[:, None])) for t in (self.quick, self.slow))


def _apart(rows: _Healthy, rate: float) -> _Apart:
    """With the least ridge that keeps faults apart; learnt from what is recent, as quick faults are."""
    rise = rows.stacked[:, :1]
    recent = rows.recent(rise[:, 0])[:, None]
    noise = np.std(np.diff(rows.x, axis=0)[np.diff(rows.run) == 0], axis=0) / np.sqrt(2)
    least = np.maximum(LEAST_NOISE * noise, 1e-6)
    for ridge in RIDGES:
        residual = _left_out(rise, recent, rows.group, ridge)
        statistics = (rows.lagged(rows.recent(residual), rows.filter_s), rows.lagged(residual, rows.filter_s))
        levels = [[_seldom(np.abs(column), rows.run, rows.t, rate) for column in s.T] for s in statistics]
        found = _Apart(_weights(recent, ridge), *np.maximum(levels, least))
        if found.elsewhere() <= APART:
            break
    return found


@dataclass(frozen=True)
class _Close:
    """Weights (sensors, 1 + lags, sensors) of the best estimates; what they leave of rows left out, (rows, sensors)."""

    weights: np.ndarray
    residual: np.ndarray
    since_start: np.ndarray


def _close(rows: _Healthy) -> _Close:
    """With the ridge that leaves the least of groups left out.

    Learnt from what changes within a shift, for an estimate only has to carry a reading on from where it was last
    believed.
    """
    values = rows.stacked
    shifts = _centred(values, rows.run, rows.t)
    left = {r: _left_out(shifts, shifts, rows.group, r) for r in RIDGES[::2]}
    ridge = min(left, key=lambda r: float(np.sum(np.log(np.mean(left[r] ** 2, axis=0)))))
    return _Close(_weights(shifts, ridge), left[ridge], _left_out(values, shifts, rows.group, ridge))


def _centred(values: np.ndarray, run: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Values less their mean over every shift of a run."""
    out = values.copy()
    for rows in _spans(run, t, SHIFT):
        out[rows] -= values[rows].mean(axis=0)
    return out


def _spans(run: np.ndarray, t: np.ndarray, length: float) -> list[np.ndarray]:
    """Rows of each stretch of time within each run."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    key = run * 100_000 + (since // length).astype(int)
    order = np.argsort(key, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(key[order])) + 1)


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


def _rows(
    recording: Recording, names: tuple[str, ...], group: str | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Readings, sessions, times and groups of the rows in which every sensor has a reading."""
    x = np.column_stack([recording.array(n) for n in names]) if names else np.zeros((len(recording), 0))
    whole = np.isfinite(x).all(axis=1)
    labels = recording.run_codes() if group is None else np.unique(recording.frame[group], return_inverse=True)[1]
    return x[whole], sessions(recording)[whole], recording.time()[whole], labels[whole]


def _rises(x: np.ndarray, run: np.ndarray) -> np.ndarray:
    first = np.r_[True, run[1:] != run[:-1]]
    start = np.maximum.accumulate(np.where(first, np.arange(run.size), 0))
    return x - x[start]


def _weights(values: np.ndarray, ridge: float) -> np.ndarray:
    """Ridge regression of each sensor on all others and their lags; 0 on itself.

    values: shape (rows, 1 + lags, sensors), the readings themselves first. Result (sensors, 1 + lags, sensors).
    """
    rows, kinds, count = values.shape
    flat = values.reshape(rows, kinds * count)
    square = flat.T @ flat / rows
    square[np.diag_indices_from(square)] += ridge * np.mean(np.diag(square)[:count])
    out = np.zeros((count, kinds, count))
    for i in range(count):
        free = np.flatnonzero(np.arange(kinds * count) % count != i)
        out[i].reshape(-1)[free] = np.linalg.solve(square[np.ix_(free, free)], square[free, i])
    return out


def _left_out(values: np.ndarray, learnt_from: np.ndarray, group: np.ndarray, ridge: float) -> np.ndarray:
    """Departure of every row from its estimate, weights learnt without its group; shape (rows, sensors)."""
    out = values[:, 0].copy()
    for label in np.unique(group):
        inside = group == label
        weights = _weights(learnt_from[~inside], ridge)
        out[inside] -= np.einsum("rkj,ikj->ri", values[inside], weights)
    return out


def _lagged(values: np.ndarray, run: np.ndarray, t: np.ndarray, tau: float) -> np.ndarray:
    from errpipe.kernels import responses

    return np.column_stack([responses.lag(run, t, np.ascontiguousarray(v), tau, tau, True) for v in values.T])


def _blocks(values: np.ndarray, run: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Largest value of each block of time."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    key = run * 100_000 + (since // BLOCK).astype(int)
    return np.array([values[key == k].max() for k in np.unique(key)])


def _seldom(values: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float, lightest: float = LIGHTEST) -> float:
    """The level that values exceed `per_hour` times an hour; no less than the largest value seen.

    Generalised extreme-value law with a tail between Gumbel's and one that ends (shape 0 to `lightest`).
    """
    largest = np.sort(_blocks(values, run, t))
    rank = np.arange(largest.size)
    l1 = largest.mean()
    b1 = np.mean(largest * rank) / (largest.size - 1)
    b2 = np.mean(largest * rank * (rank - 1)) / ((largest.size - 1) * (largest.size - 2))
    l2, l3 = 2 * b1 - l1, 6 * b2 - 6 * b1 + l1
    if l2 <= 0:
        return float(largest[-1])
    c = 2 / (3 + l3 / l2) - np.log(2) / np.log(3)
    k = float(np.clip(7.8590 * c + 2.9554 * c**2, 1e-6, lightest))
    scale = l2 * k / ((1 - 2**-k) * math.gamma(1 + k))
    place = l1 - scale * (1 - math.gamma(1 + k)) / k
    level = place + scale * (1 - (-math.log1p(-per_hour * BLOCK / 3600)) ** k) / k
    return float(max(level, largest[-1]))


def _still(alive: np.ndarray, run: np.ndarray, t: np.ndarray, per_hour: float, tau: float) -> float | None:
    """The stillness that a healthy sensor hardly ever reaches; None where it stands still when healthy."""
    first = np.r_[True, run[1:] != run[:-1]]
    since = t - t[np.maximum.accumulate(np.where(first, np.arange(run.size), 0))]
    told = since > g.WARM_UP * tau
    if not told.any() or alive[told].min() <= 0:
        return None
    # Near 0 a square of noise is distributed as a power, so minus its logarithm has Gumbel's tail.
    level = np.exp(-_seldom(-np.log(alive[told]), run[told], t[told], per_hour, lightest=1e-6))
    return float(level) if level > FAINTEST * np.median(alive[told]) else None


def _fastest(x: np.ndarray, run: np.ndarray, t: np.ndarray) -> float:
    same = (np.diff(run) == 0) & (np.diff(t) > 0)
    return float(np.max(np.abs(np.diff(x)[same]) / np.diff(t)[same], initial=1e-6))
