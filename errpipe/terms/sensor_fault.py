"""The mismatch is confined to where one sensor is stuck, dead or stepped."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Literal

import numpy as np
from pydantic import Field, PrivateAttr

from errpipe.domain.components import is_deviation
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position
from errpipe.drivers.sessions import sessions
from errpipe.kernels.events import stretches
from errpipe.kernels.responses import lag
from errpipe.terms._base import NEVER, Parameter, Term
from errpipe.terms._drivers import sensors
from errpipe.terms._place import linear_axes_acting
from errpipe.terms._slack import Slack

# Log odds of a fault that readings show: it is there, open is only whether the simulation reads that sensor. Half of
# the odds against each one of some twenty other effects
LOG_ODDS_IF_VISIBLE = 3.0
ROWS_EACH_SIDE = 5  # rows on either side of a jump whose medians give its step
MAX_JUMPS, MAX_STRETCHES = 6, 16  # of a sensor, that are tried: seen ones first, those between natural jumps last
MIN_READINGS = 30  # of a sensor, in which failures are searched for
MIN_STRETCH_ROWS = 8  # of a stretch; one without a change has four times as many, or a thirtieth of all
MAX_STEP_RATIO = 2.0  # factor between a jump off and the jump back; if one of them may have another cause, at most
EQUAL_STEPS = 1.3  # for the readings alone to show a failure (chosen on 120 faults, seeds 44511 and 44512)
LINES = (8, 24)  # readings of the straight lines on either side of a jump,
JUMP = 7.0  # and standard errors by which these must miss each other: bodies bend as they warm. Short ones at least by
CHANCE = 4.5  # what chance exceeds in one of 100,000 rows
# A sensor failed in a stretch of equal readings so many times as long as any other, and that ends with so many of the
# display's steps (by judgement; true of none of 969 sound sensors, seeds 44511 to 44514), or where so few of all other
# readings equal the one before: that is no habit of it
HELD, LEAVES, RARELY = 4.0, 1.5, 0.05
# Of the fault: prior standard deviation of what the reading drawn through the gap misses (chosen on 40 faults)
DRAWN = 0.3
REPLACED = 3.0  # and of the level, if nothing is read: what the simulation takes instead is not recorded (by judgement)
BENDS, SEEN_BENDS = 4, 12  # half waves along the stretch, from which that may be made; if the readings show its ends
STILL = 0.05  # of a jump, within which a reading is constant before it


class SensorFault(Term):
    """A sensor that the simulation reads was wrong for a while: stuck, dead or stepped.

    Equation   deviation = gain * (T_true - T_read) on rows first..last, 0 elsewhere; T_true drawn through the gap,
               or T_read less the step with which the stretch begins and ends
    Assumes    the simulation follows that sensor with `gain`
    Typical    any
    Moves      nothing outside the faulty stretch
    Source     Ni 1997, recovery from sensor failure
    """

    term: Literal["sensor_fault"] = "sensor_fault"
    sensor: str = Field(description="Column of the faulty sensor.")
    first: int = Field(description="First faulty row.")
    last: int = Field(description="Last faulty row.")
    axis: str | None = Field(None, description="Axis along which it acts, where the simulation makes a slope of it.")
    stepped: bool = Field(False, description="Off by one step all along: it jumps off and back.")
    family = "measurement"
    compensable = False
    artefact = "a sensor failed while it was recorded: repair it; the machine itself is not at fault"
    simulated_log_odds = NEVER
    sample = {"sensor": "T_nut", "first": 60, "last": 120}
    misread = True
    in_part = "never"
    form = "any shape"  # what it would have read is drawn from the other sensors
    prior_log_odds = -3.0
    _seen: bool = PrivateAttr(False)  # do the readings alone show that it failed, and when? Then that is no choice
    _blank: bool = PrivateAttr(False)  # does it read nothing there?

    def log_prior_odds(self) -> float:
        return LOG_ODDS_IF_VISIBLE if self._seen else self.prior_log_odds

    def linear(self) -> tuple[Parameter, ...]:
        unit = "um/m/K" if self.axis else "um/K"
        return (Parameter("gain", unit, (0.5, 20.0), (-500.0, 500.0), "what the simulation makes of a kelvin"),)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[SensorFault]:
        if is_deviation(component):
            for sensor in recording.names("temperature"):
                for (first, last), seen in _failures(recording, sensor).items():
                    blank = not np.isfinite(recording.array(sensor)[first : last + 1]).any()
                    stepped = (False, True) if _step_in(recording, sensor, first, last) else (False,)
                    for axis, how in itertools.product((None, *linear_axes_acting(recording, component)), stepped):
                        term = cls(sensor=sensor, first=first, last=last, axis=axis, stepped=how)
                        term._seen, term._blank = seen, blank
                        yield term

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        read = recording.array(self.sensor)
        rows = np.arange(len(read))
        inside = (rows >= self.first) & (rows <= self.last)
        if self.stepped:
            lie = np.full(len(read), -_step_in(recording, self.sensor, self.first, self.last))
        else:
            before = read[: self.first][np.isfinite(read[: self.first])]
            held = np.where(np.isfinite(read), read, before[-1] if before.size else np.nanmedian(read))
            lie = reconstructed(recording, self.sensor, self.first, self.last) - held
        return np.where(inside, lie * self._reach(recording), 0.0)[:, None]

    def _reach(self, recording: Recording) -> np.ndarray | float:
        """What a kelvin acts on: the length from the axis' zero in m, or 1."""
        return 1.0 if self.axis is None else position(recording, self.axis) * 1e-3

    def slack(self, recording: Recording, base: np.ndarray, *nonlinear: float) -> Slack:
        rows = np.arange(len(recording))
        inside = ((rows >= self.first) & (rows <= self.last)) * self._reach(recording)
        along = (rows - self.first) / max(self.last - self.first, 1)
        if self.stepped:
            yield inside * along, DRAWN
            return
        yield inside, REPLACED if self._blank else DRAWN
        yield inside * along, DRAWN
        run = sessions(recording)
        if run[max(self.first - 1, 0)] != run[self.first]:
            return  # it begins with a session: no reading next to it from which a bend is drawn
        for wave in range(1, (SEEN_BENDS if self._seen else BENDS) + 1):
            yield inside * np.sin(np.pi * wave * along), DRAWN / wave

    def active_ranges(self, recording: Recording, *nonlinear: float) -> dict[str, tuple[float, float]]:
        clock, t = recording.name("time"), recording.time()
        return {} if clock is None else {clock: (float(t[self.first]), float(t[self.last]))}

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[SensorFault]:
        """Bindings to the sensors as they were read, in which failures show; those left out as unusable are no use."""
        return (term for term in cls.bind(raw, component) if term.sensor in recording.frame.columns)


def _failures(recording: Recording, sensor: str) -> dict[tuple[int, int], bool]:
    """Stretches in which a sensor may have failed, as `suspicious` has them; kept, for every response asks again."""
    if "switched" not in recording.derived:
        recording.derived["switched"] = _switched(recording)
    if ("failures", sensor) not in recording.derived:
        found = suspicious(recording.array(sensor), recording.time(), recording.derived["switched"])
        recording.derived["failures", sensor] = found
    return recording.derived["failures", sensor]


def _step_in(recording: Recording, sensor: str, first: int, last: int) -> float:
    """Step by which a sensor's readings of a stretch are off, or 0; its steps before each row are kept."""
    if ("steps", sensor) not in recording.derived:
        recording.derived["steps", sensor] = steps(recording.array(sensor), recording.time())
    finite, step = recording.derived["steps", sensor]
    return step_between(finite, step, first, last)


def _switched(recording: Recording) -> np.ndarray:
    """Rows beside which coolant or spindle change, or two sensors jump at once: no failure. Shape (rows,)."""
    t, out = recording.time(), np.zeros(len(recording))
    for name in (*recording.names("coolant"), *recording.names("spindle_speed")):
        out += 2 * _with_neighbours(np.flatnonzero(np.diff(recording.array(name))) + 1, out.size)
    for name in recording.names("temperature"):
        read, finite = recording.array(name), np.isfinite(recording.array(name))
        if finite.sum() >= MIN_READINGS:
            out += _with_neighbours(np.array([*jumps(_filled(read), t, finite)], dtype=int), out.size)
    return out >= 2


def _with_neighbours(rows: np.ndarray, n: int) -> np.ndarray:
    """1 at these rows and two on either side, else 0, shape (n,)."""
    return np.convolve(np.bincount(rows, minlength=n), np.ones(5), "same") > 0


def steps(values: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows that are read, and the step before each of them, shapes (k,)."""
    finite = np.flatnonzero(np.isfinite(values))
    return finite, _line_mismatch(_running_clock(t)[finite], values[finite], LINES[0], _without_pause(t[finite]))[0]


def step_between(finite: np.ndarray, step: np.ndarray, first: int, last: int, ratio: float = MAX_STEP_RATIO) -> float:
    """Step by which readings of a stretch are off: they jump by it and back, or to the end; else 0. Of `steps`."""
    ends = [k for k in np.searchsorted(finite, (first, last + 1)) if k < finite.size]
    if not ends:
        return 0.0
    on, off = step[ends[0]], -step[ends[-1]] if len(ends) == 2 else step[ends[0]]
    return float(on + off) / 2 if on * off > 0 and max(on / off, off / on) < ratio else 0.0


def reconstructed(recording: Recording, sensor: str, first: int, last: int) -> np.ndarray:
    """What a sensor should have read: from the others, now and late, as they went together outside rows first..last.

    What they miss of the readings on either side is drawn on between them. How they went together is kept: the fault
    is tried on every axis and response.
    """
    read = recording.array(sensor)
    if ("others", sensor) not in recording.derived:
        recording.derived["others", sensor] = _regressors(recording, sensor)
    if ("others", sensor, first, last) not in recording.derived:
        good = np.isfinite(read)
        good[first : last + 1] = False
        recording.derived["others", sensor, first, last] = _regression_on_others(
            recording.derived["others", sensor], read, good
        )
    size, weights = recording.derived["others", sensor, first, last]
    if not weights.size:
        return read
    drawn = recording.derived["others", sensor] / size @ weights
    sides = [(max(first - ROWS_EACH_SIDE, 0), first), (last + 1, last + 1 + ROWS_EACH_SIDE)]
    ends = [(row, read[a:b] - drawn[a:b]) for (a, b), row in zip(sides, (first, last + 1), strict=True)]
    missed = {row: float(np.nanmedian(gap)) for row, gap in ends if np.isfinite(gap).any()}
    return drawn + np.interp(np.arange(len(read)), [*missed], [*missed.values()]) if missed else drawn


def _regression_on_others(others: np.ndarray, read: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Sizes of the columns of other sensors, (rows, k), and their weights in a reading on good rows, shape (2, k).

    Shape (2, 0) where these rows are too few.
    """
    if good.sum() < 10:
        return np.empty((2, 0))
    known = others[good]
    size = np.maximum(known.std(axis=0), 1e-9)
    size[0] = 1.0
    known /= size
    ridge = 1e-3 * good.sum() * np.diag(np.r_[0.0, np.ones(others.shape[1] - 1)])
    return np.array([size, np.linalg.lstsq(known.T @ known + ridge, known.T @ read[good], rcond=None)[0]])


def _regressors(recording: Recording, sensor: str) -> np.ndarray:
    """A constant, the other temperatures, each now and late, and spindle speeds and coolant late, shape (rows, k)."""
    run, t = sessions(recording), recording.time()
    columns = [np.ones(len(recording))]
    for name in sensors(recording):
        other = recording.array(name)
        if name == sensor or not np.isfinite(other).all():
            continue
        columns += [other - other.mean()]
        columns += [lag(run, t, other - other.mean(), tau, tau, True) for tau in (1000.0, 5000.0)]
    for name in (*recording.names("spindle_speed"), *recording.names("coolant")):
        speed = recording.array(name)
        if np.isfinite(speed).all():
            columns += [lag(run, t, speed / max(speed.max(), 1.0), tau, tau, True) for tau in (800.0, 4000.0)]
    return np.column_stack(columns)


def suspicious(values: np.ndarray, t: np.ndarray, switched: np.ndarray | None = None) -> dict[tuple[int, int], bool]:
    """First and last row of stretches where a sensor is missing, is frozen, or lies between two jumps.

    True: the readings alone show that it failed there. It reads nothing or zero, jumps off and back by as much,
    is constant until it jumps, as nowhere else, or for far longer than elsewhere.
    switched: rows at which a jump has another cause.
    """
    n = values.size
    finite = np.isfinite(values)
    if finite.sum() < MIN_READINGS:
        return {}
    out = dict.fromkeys(_stretches(~finite, max(MIN_STRETCH_ROWS, n // 100)), True)
    long, filled = max(4 * MIN_STRETCH_ROWS, n // 30), _filled(values)
    typical = np.median(np.abs(filled))
    if typical > 5.0:  # a dead channel reads zero
        out |= dict.fromkeys(_stretches(finite & (np.abs(values) < 0.05 * typical), MIN_STRETCH_ROWS), True)
    step, known = jumps(filled, t, finite if switched is None else finite & ~switched), steps(values, t)

    def is_unexplained(*rows: int) -> bool:
        """Is one of these jumps at least without a natural cause, and is jumping no habit of the reading elsewhere?"""
        least = min((step[row] for row in rows if step[row]), default=0.0)
        return least > 0 and all(2.0 * size < least for row, size in step.items() if row not in rows)

    edges, natural = sorted(step), set()
    for i, a in enumerate(edges):
        ends = [*edges[i + 1 :], n] if step[a] or 2 * a >= n else edges[i + 1 :]  # from a pause on, it is the exception
        for b in (b for b in ends if b - a >= MIN_STRETCH_ROWS):
            natural |= {(a, b - 1)} if not step[a] and not step.get(b) else set()
            ratio = MAX_STEP_RATIO if step[a] and step.get(b) else EQUAL_STEPS
            out[a, b - 1] = b < n and is_unexplained(a, b) and step_between(*known, a, b - 1, ratio) != 0.0
        start = _still_from(filled, a, long)
        out |= {(start, a - 1): is_unexplained(a) and start > 0} if a - start >= long else {}
    if (held := _held(filled, finite)) and held[1] - held[0] >= long:
        out[held] = True
    return dict(sorted(sorted(out.items(), key=lambda one: (not one[1], one[0] in natural))[:MAX_STRETCHES]))


def _filled(values: np.ndarray) -> np.ndarray:
    """Readings with straight lines through those that are missing, shape (rows,)."""
    finite = np.flatnonzero(np.isfinite(values))
    return np.interp(np.arange(values.size), finite, values[finite])


def _held(read: np.ndarray, finite: np.ndarray) -> tuple[int, int] | None:
    """First and last row of the longest stretch of equal readings, if far longer than any other, and left by a jump or
    the only one: a body that came to rest leaves its temperature by one step of the display.
    """
    edges = np.flatnonzero(np.abs(np.diff(read)) > 1e-9) + 1
    starts, ends = np.r_[0, edges], np.r_[edges, read.size]
    count = np.add.reduceat(finite.astype(int), starts)
    longest = int(count.argmax())
    if longest in (0, count.size - 1) or count[longest] < HELD * np.delete(count, longest).max():
        return None
    first, after, moves = int(starts[longest]), int(ends[longest]), np.abs(np.diff(read[finite]))
    rare = 1.0 - edges.size / max(read.size - count[longest], 1) < RARELY
    jump = abs(read[after] - read[first]) > LEAVES * moves[moves > 1e-9].min()
    return (first, after - 1) if jump or rare else None


def _still_from(read: np.ndarray, a: int, long: int) -> int:
    """Row from which a reading is constant until it jumps at row a: means over 9 and 27 rows do not change.

    That is within 4.5 of their standard errors and a part of the jump.
    """
    before, moves = read[max(a - long, 0) : a], np.abs(np.diff(read))
    least = 1.4826 * float(np.median(np.abs(np.diff(before, 2)))) / np.sqrt(6.0)
    least = max(least, float(moves.min(initial=np.inf, where=moves > 1e-9)) / np.sqrt(12.0))
    level, noise = float(before.mean()), float(before.std())
    if noise > 2.0 * least:  # it moves
        return a
    size = abs(float(np.median(read[a : a + ROWS_EACH_SIDE])) - level)
    start = 0
    for k in (9, 27):
        mean = np.convolve(np.pad(read[:a], (k // 2, 0), mode="edge"), np.full(k, 1 / k), mode="valid")
        away = np.flatnonzero(np.abs(mean - level) > 4.5 * noise / np.sqrt(k) + STILL * size)
        start = max(start, int(away[-1]) + 1 if away.size else 0)
    return start


def jumps(filled: np.ndarray, t: np.ndarray, usable: np.ndarray) -> dict[int, float]:
    """Rows from which a reading is off at once, the surest, and by how much: straight lines through the readings on
    either side miss each other halfway between them. Zero next to unusable rows and pauses, ranked last: bodies cool.
    """
    going = _without_pause(t)
    (step, short), (_, long) = (_line_mismatch(_running_clock(t), filled, k, going) for k in LINES)
    sure = np.where(short > CHANCE, np.maximum(short, long), 0.0)  # residual of the long lines where the reading bends
    ahead = np.where(going, sure, 0.0)  # a jump at a pause hides none beside it
    highest = np.lib.stride_tricks.sliding_window_view(np.pad(ahead, LINES[0] // 2), LINES[0] + 1).max(axis=1)
    rows = np.flatnonzero((sure > JUMP) & ((sure == highest) | ~going))
    plain = going & usable & np.r_[True, usable[:-1]]
    first = np.lexsort((-sure[rows], ~going[rows], ~plain[rows]))[:MAX_JUMPS]
    return {int(row): float(np.abs(step[row]) * plain[row]) for row in rows[first]}


def _without_pause(t: np.ndarray) -> np.ndarray:
    """Is there no pause before a row, in which bodies cool or heat? Shape (rows,)."""
    pause = np.diff(t)
    return np.r_[True, (pause > 0) & (pause <= 2.0 * _longer_neighbour(pause))]


def _running_clock(t: np.ndarray) -> np.ndarray:
    """A clock that stops in pauses and does not restart with each run, shape (rows,)."""
    pause = np.diff(t)
    going = np.where(pause > 0, pause, np.median(pause[pause > 0]) if (pause > 0).any() else 1.0)
    return np.r_[0.0, np.cumsum(np.minimum(going, 2.0 * _longer_neighbour(going)))]


def _longer_neighbour(pause: np.ndarray) -> np.ndarray:
    """The longer one of the times before and after each time between two readings, shape (rows - 1,)."""
    return np.maximum(np.r_[pause[1:], 0.0], np.r_[0.0, pause[:-1]])


def _line_mismatch(clock: np.ndarray, read: np.ndarray, k: int, going: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """By how much lines through k readings on either side miss each other before each row, also in standard errors.

    Shapes (rows,), nought where there are fewer readings on a side. Rows after a pause (not going) are joined to those
    before it: lines through a jump there would hide others beside it.
    """
    step, sure, n = np.zeros(read.size), np.zeros(read.size), read.size
    if n < 2 * k:
        return step, sure
    at, values = (np.lib.stride_tricks.sliding_window_view(v, k) for v in (clock, read))
    middle, level = at.mean(axis=1), values.mean(axis=1)
    along = at - middle[:, None]
    spread = np.sum(along**2, axis=1)
    slope = np.sum(along * values, axis=1) / spread
    left = np.maximum(np.sum((values - level[:, None]) ** 2, axis=1) - slope**2 * spread, 0.0) / (k - 2)
    between = (clock[k : n - k + 1] + clock[k - 1 : n - k]) / 2
    before, after = slice(0, n - 2 * k + 1), slice(k, n - k + 1)
    back, on = between - middle[before], between - middle[after]
    inside = slice(k, n - k + 1)
    step[inside] = level[after] + slope[after] * on - level[before] - slope[before] * back
    moves = np.abs(np.diff(read))
    coarse = float(moves[moves > 1e-9].min()) if (moves > 1e-9).any() else 0.0
    noise = np.maximum((left[before] + left[after]) / 2, max(float(np.median(left)), coarse**2 / 12, 1e-18))
    leverage = 2 / k + back**2 / spread[before] + on**2 / spread[after]
    sure[inside] = np.abs(step[inside]) / np.sqrt(noise * leverage)
    if going.all():
        return step, sure
    joined = _line_mismatch(clock, read - np.cumsum(np.where(going, 0.0, step)), k, np.ones(n, dtype=bool))
    return np.where(going, joined[0], step), np.where(going, joined[1], sure)


def _stretches(flags: np.ndarray, least: int) -> list[tuple[int, int]]:
    """First and last row of the stretches of True that have so many rows."""
    return [(int(a), int(b) - 1) for a, b in zip(*stretches(flags), strict=True) if b - a >= least]
