"""How a non-linear parameter is searched: the values tried before any fit, and how the best of them is refined.

A parameter states its search, or is searched by its unit (`search_of`): a new term with a time constant in s needs no
more than its typical range. A search gives the values to try for a term on a recording, the neighbours of the best
one, and the interval that a set of neighbours stands for.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position
from errpipe.terms._base import Parameter, Search, Term

STEPS = 9  # points of a refinement, the best one in their middle
PER_DECADE = 5  # values tried per decade of a scale; neighbours then overlap within a factor of 1.6


@dataclass(frozen=True)
class Signals:
    """Signals in which waves are looked for: judged rows (indices into the recording) and values there."""

    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    values: tuple[np.ndarray, ...] = ()


@dataclass(frozen=True)
class Listed:
    """Values listed by the term; refined by factors of up to exp(reach)."""

    listed: tuple[float, ...] = ()
    reach: float = 0.6

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        return self.listed

    def neighbours(self, value: float) -> np.ndarray:
        """Values near the best one."""
        return value * np.exp(self.reach * np.linspace(-1.0, 1.0, STEPS))

    def widened(self, low: float, high: float) -> tuple[float, float]:
        """Ends of an interval, half-way to the next neighbours."""
        half = np.exp(self.reach / (STEPS - 1))
        return low / half, high * half


@dataclass(frozen=True)
class Scale(Listed):
    """A scale of unknown size: values spread evenly over the logarithm of the parameter's typical range."""

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        low, high = next(p for p in term.nonlinear() if p.name == name).typical
        if low <= 0:
            return tuple(np.linspace(low, high, PER_DECADE))
        count = max(int(np.ceil(PER_DECADE * np.log10(high / low))) + 1, 2)
        return tuple(np.geomspace(low, high, count))


@dataclass(frozen=True)
class Waves(Listed):
    """Length of a wave along the term's axis: the strongest waves of the signals, from mm to the travel."""

    reach: float = 0.02
    least_places: int = 0  # fewer different positions show no wave of unknown length

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        x = position(recording, term.axis)
        if np.unique(x).size <= self.least_places:
            return ()
        return periods(x[signals.rows], signals.values)


@dataclass(frozen=True)
class Places(Listed):
    """A place along the term's axis; refined by shifts of up to `shift` mm."""

    shift: float = 40.0

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        x = position(recording, term.axis)
        return tuple(np.linspace(np.nanmin(x), np.nanmax(x), 25)[1:-1])

    def neighbours(self, value: float) -> np.ndarray:
        """Values near the best one."""
        return value + self.shift * np.linspace(-1.0, 1.0, STEPS)

    def widened(self, low: float, high: float) -> tuple[float, float]:
        """Ends of an interval, half-way to the next neighbours."""
        return low - self.shift / (STEPS - 1), high + self.shift / (STEPS - 1)


@dataclass(frozen=True)
class Widths(Listed):
    """Length of a stretch, as shares of the positions that the recording covers, of 1 m at most."""

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        x = position(recording, term.axis)
        span = min(float(np.nanmax(x) - np.nanmin(x)), 1000.0)
        return tuple(span * f for f in (0.02, 0.035, 0.055, 0.08))


@dataclass(frozen=True)
class Shifts(Listed):
    """A shift in time within the term's `shortest` and `longest`, either way; it is not refined."""

    def values(self, term: Term, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        """Values to try."""
        if term.longest < 20.0:
            return ()  # clocks of loggers differ by seconds and minutes, not by samples of a fast trace
        half = np.geomspace(max(term.shortest, 5.0), min(term.longest, 900.0), 14)
        return tuple(np.r_[-half[::-1], half])

    def neighbours(self, value: float) -> np.ndarray:
        """None: the grid is as fine as the noise allows."""
        return np.array([value])

    def widened(self, low: float, high: float) -> tuple[float, float]:
        """A fifth to either side."""
        return (low * 0.8, high * 1.25) if low > 0 else (low * 1.25, high * 0.8)


def search_of(parameter: Parameter) -> Search:
    """How a parameter is searched: as it states, else as a scale over its typical range."""
    return parameter.search or Scale()


def periods(
    at: np.ndarray, signals: tuple[np.ndarray, ...], shortest: float = 0.6, longest: float = 60.0, most: int = 24
) -> tuple[float, ...]:
    """Lengths of the strongest waves of each signal along `at`, with neighbours a quarter of a turn apart."""
    span = float(at.max() - at.min())
    if span <= 0:
        return ()
    step = shortest / 4
    cell = ((at - at.min()) / step).astype(int)
    count = int(2 ** np.ceil(np.log2(cell.max() + 1))) * 4
    rows_in = np.bincount(cell, minlength=count)
    inside, place = rows_in > 0, np.arange(count)
    strongest: set[float] = set()
    for signal in signals:
        total = np.bincount(cell, weights=signal - signal.mean(), minlength=count)
        mean = np.where(inside, total / np.maximum(rows_in, 1), 0.0)
        # slow shapes are not waves: a cubic is taken away before the transform
        mean[inside] -= np.polyval(np.polyfit(place[inside], mean[inside], 3), place[inside])
        power = np.abs(np.fft.rfft(mean * np.sqrt(rows_in)))
        frequency = np.fft.rfftfreq(count, step)
        allowed = (frequency >= max(1 / longest, 2.5 / span)) & (frequency <= 1 / shortest)
        power = np.where(allowed, power, 0.0)
        peaks = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
        for k in peaks[np.argsort(-power[peaks], kind="stable")][: most // 2]:
            for shift in (-0.25, -0.125, 0.0, 0.125, 0.25):
                strongest.add(float(1.0 / max(frequency[k] + shift / span, 1e-6)))
    return tuple(sorted(strongest))
