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
from errpipe.terms._place import linear_axes_acting
from errpipe.terms._slack import Slack
from errpipe.terms._warm import sensors

ROWS_EACH_SIDE = 5  # rows on either side of a jump whose medians give its step
LEAST_ROWS = 8  # of a stretch; one in which a sensor stands still has four times as many, or a thirtieth of all
ALIKE = 2.0  # factor between a jump off and the jump back
# Of the fault: prior standard deviation of what the reading drawn through the gap misses (chosen on 40 faults)
DRAWN = 0.3
BENDS = 4  # half waves along the stretch, from which that may be made
STILL = 0.05  # of a jump, within which a reading stands still before it


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
    misread = True
    in_part = "never"
    form = "any shape"  # what it would have read is drawn from the other sensors
    prior_log_odds = -3.0
    _silent: bool = PrivateAttr(False)  # did it read nothing? Then that it failed is seen, and no choice among jumps

    def log_prior_odds(self) -> float:
        return 0.0 if self._silent else self.prior_log_odds

    def linear(self) -> tuple[Parameter, ...]:
        unit = "um/m/K" if self.axis else "um/K"
        return (Parameter("gain", unit, (0.5, 20.0), (-500.0, 500.0), "what the simulation makes of a kelvin"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.sensor,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[SensorFault]:
        if is_deviation(component):
            for sensor in recording.names("temperature"):
                gaps = set(silent(recording.array(sensor)))
                for first, last in suspicious(recording.array(sensor), recording.time()):
                    stepped = (False, True) if step_of(recording.array(sensor), first, last) else (False,)
                    for axis, how in itertools.product((None, *linear_axes_acting(recording, component)), stepped):
                        term = cls(sensor=sensor, first=first, last=last, axis=axis, stepped=how)
                        term._silent = (first, last) in gaps
                        yield term

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        read = recording.array(self.sensor)
        rows = np.arange(len(read))
        inside = (rows >= self.first) & (rows <= self.last)
        if self.stepped:
            lie = np.full(len(read), -step_of(read, self.first, self.last))
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
        yield inside, DRAWN
        yield inside * along, DRAWN
        run = sessions(recording)
        if run[max(self.first - 1, 0)] != run[self.first]:
            return  # it begins with a session: no reading beside it from which a bend is drawn
        for wave in range(1, BENDS + 1):
            yield inside * np.sin(np.pi * wave * along), DRAWN / wave

    def acts_where(self, recording: Recording, *nonlinear: float) -> dict[str, tuple[float, float]]:
        clock, t = recording.name("time"), recording.time()
        return {} if clock is None else {clock: (float(t[self.first]), float(t[self.last]))}

    @classmethod
    def hypotheses(cls, recording: Recording, raw: Recording, component: str) -> Iterator[SensorFault]:
        """Bindings to the sensors as they were read, in which failures show; those left out as unusable are no use."""
        return (term for term in cls.bind(raw, component) if term.sensor in recording.frame.columns)


def step_of(values: np.ndarray, first: int, last: int) -> float:
    """Step by which readings of a stretch are off: they jump by it and back, or to the end; else 0."""
    a, b = first, last + 1
    ends = (max(a - ROWS_EACH_SIDE, 0), a), (a, a + ROWS_EACH_SIDE), (b - ROWS_EACH_SIDE, b), (b, b + ROWS_EACH_SIDE)
    level = [np.median(read) if (read := values[low:high]).size else np.nan for low, high in ends]
    on, off = level[1] - level[0], level[2] - level[3]
    off = on if b == values.size else off
    return float(on + off) / 2 if on * off > 0 and max(on / off, off / on) < ALIKE else 0.0


def reconstructed(recording: Recording, sensor: str, first: int, last: int) -> np.ndarray:
    """What a sensor should have read: from the others, now and late, as they went together outside rows first..last.

    What they miss of the readings on either side is drawn on between them. How they went together is kept: the fault
    is tried on every axis and response.
    """
    read = recording.array(sensor)
    if ("others", sensor) not in recording.derived:
        recording.derived["others", sensor] = _others(recording, sensor)
    if ("others", sensor, first, last) not in recording.derived:
        good = np.isfinite(read)
        good[first : last + 1] = False
        recording.derived["others", sensor, first, last] = _together(recording.derived["others", sensor], read, good)
    size, weights = recording.derived["others", sensor, first, last]
    if not weights.size:
        return read
    drawn = recording.derived["others", sensor] / size @ weights
    sides = [(max(first - ROWS_EACH_SIDE, 0), first), (last + 1, last + 1 + ROWS_EACH_SIDE)]
    ends = [(row, read[a:b] - drawn[a:b]) for (a, b), row in zip(sides, (first, last + 1), strict=True)]
    missed = {row: float(np.nanmedian(gap)) for row, gap in ends if np.isfinite(gap).any()}
    return drawn + np.interp(np.arange(len(read)), [*missed], [*missed.values()]) if missed else drawn


def _together(others: np.ndarray, read: np.ndarray, good: np.ndarray) -> np.ndarray:
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


def _others(recording: Recording, sensor: str) -> np.ndarray:
    """A constant, the other temperatures and spindle speeds, each now and late, shape (rows, k)."""
    run, t = sessions(recording), recording.time()
    columns = [np.ones(len(recording))]
    for name in sensors(recording):
        other = recording.array(name)
        if name == sensor or not np.isfinite(other).all():
            continue
        columns += [other - other.mean()]
        columns += [lag(run, t, other - other.mean(), tau, tau, True) for tau in (1000.0, 5000.0)]
    for name in recording.names("spindle_speed"):
        speed = recording.array(name)
        if np.isfinite(speed).all():
            columns += [lag(run, t, speed / max(speed.max(), 1.0), tau, tau, True) for tau in (800.0, 4000.0)]
    return np.column_stack(columns)


def suspicious(values: np.ndarray, t: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of stretches where a sensor is missing, stands still, or sits between two jumps."""
    n = values.size
    finite = np.isfinite(values)
    if finite.sum() < 30:
        return []
    out, long = silent(values), max(4 * LEAST_ROWS, n // 30)
    filled = np.interp(np.arange(n), np.flatnonzero(finite), values[finite])
    step = np.abs(np.diff(filled))
    usual = np.median(step) + 1e-9
    wide = _rolling_median(step, 25)
    pause = np.diff(t)
    beside = np.maximum(np.r_[pause[1:], 0.0], np.r_[0.0, pause[:-1]])
    jumps = np.flatnonzero((step > 10 * np.maximum(wide, usual)) & (step > 0.35)) + 1
    jumps = jumps[finite[np.minimum(jumps, n - 1)] & finite[np.maximum(jumps - 1, 0)]]
    typical = np.median(np.abs(filled))
    if typical > 5.0:  # a dead channel reads nought
        out += _stretches(finite & (np.abs(values) < 0.05 * typical), LEAST_ROWS)
    stuck = _rolling_range(filled, 9) <= 0.3 * np.median(_rolling_range(filled, 9)) + 1e-12
    stuck_stretches = _stretches(stuck & finite, long)
    paused = pause[jumps - 1] > 2.0 * beside[jumps - 1]  # bodies cool by themselves then: such jumps come last
    strongest = jumps[np.lexsort((-step[jumps - 1], paused))][:4]
    edges = np.sort(strongest)
    for i, a in enumerate(edges):
        out += [(int(a), int(b) - 1) for b in edges[i + 1 :] if b - a >= LEAST_ROWS]
        out += [(int(a), n - 1)] if n - a >= LEAST_ROWS else []
        off = np.abs(_rolling_median(filled[:a], 9) - np.median(filled[max(a - ROWS_EACH_SIDE, 0) : a]))
        away = np.flatnonzero(off > usual + STILL * step[a - 1])
        start = int(away[-1]) + 1 if away.size else 0  # stood still until it jumped
        out += [(start, int(a) - 1)] if a - start >= long else []
    out += stuck_stretches[:3]
    return sorted(set(out))[:24]


def silent(values: np.ndarray) -> list[tuple[int, int]]:
    """First and last row of stretches where a sensor reads nothing."""
    return _stretches(~np.isfinite(values), max(LEAST_ROWS, values.size // 100))


def _stretches(flags: np.ndarray, least: int) -> list[tuple[int, int]]:
    """First and last row of the stretches of True that have so many rows."""
    return [(int(a), int(b) - 1) for a, b in zip(*stretches(flags), strict=True) if b - a >= least]


def _rolling_median(values: np.ndarray, width: int) -> np.ndarray:
    half = width // 2
    padded = np.pad(values, half, mode="reflect") if values.size > half else np.pad(values, half, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, width), axis=1)


def _rolling_range(values: np.ndarray, width: int) -> np.ndarray:
    half = width // 2
    window = np.lib.stride_tricks.sliding_window_view(np.pad(values, half, mode="edge"), width)
    return window.max(axis=1) - window.min(axis=1)
