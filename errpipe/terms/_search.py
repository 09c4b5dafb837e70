"""How a non-linear parameter is searched: the values tried before any fit, and how the best of them is refined.

A parameter states its search, or is searched by its unit (`search_of`): a new term with a time constant in s needs no
more than its typical range. Ranges come from what the recording resolves (sampling step and length in time, travel and
step between places, speed); typical sizes are a prior whose width is TYPICAL_WIDTH, never a limit.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.motion import position
from errpipe.drivers.sessions import sessions
from errpipe.terms._base import Parameter, Search, Term
from errpipe.terms._lines import MIN_TURNS_OF_WAVE, periods

Estimates = Iterator[tuple[Term, tuple[float, ...]]]  # bindings with non-linear values estimated from signals
STEPS = 9  # points of a refinement, the best one in their middle
RATIO = 1.6  # from value to value of a scale within its typical range; neighbours overlap within half of that
COARSE_RATIO = 2.5  # and outside of it
TYPICAL_WIDTH = 5.0  # factor beyond the typical range that counts as one standard deviation


@dataclass(frozen=True)
class Signals:
    """Signals from which values are estimated, on the judged rows (indices into the recording); the mismatch first.

    values: with the axes' speeds and accelerations projected out; motion: orthonormal columns of these (rows, k).
    """

    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=int))
    values: tuple[np.ndarray, ...] = ()
    mismatch: np.ndarray | None = None  # as it is; none: the first of the values
    motion: np.ndarray | None = None

    def whole(self) -> np.ndarray:
        """The mismatch, unmodified."""
        return self.values[0] if self.mismatch is None else self.mismatch

    def still(self, columns: np.ndarray) -> np.ndarray:
        """Columns (rows, k) projected orthogonal to the motion, like the values."""
        return columns if self.motion is None else columns - self.motion @ (self.motion.T @ columns)


def resolved_times(recording: Recording) -> tuple[float, float]:
    """Sampling step and duration of the longest session in s; (1, 1) if time does not advance."""
    t, session = recording.time(), sessions(recording)
    step = np.diff(t)[np.diff(session) == 0]
    step = step[step > 0]
    if not step.size:
        return 1.0, 1.0
    longest = max(float(np.ptp(t[session == s])) for s in np.unique(session))
    return float(np.median(step)), max(longest, float(np.median(step)))


def resolved_lengths(recording: Recording, axis: str) -> tuple[float, float]:
    """Usual move from row to row of an axis and the range of its positions, in mm (deg)."""
    x = position(recording, axis)
    moves = np.abs(np.diff(x))
    span = float(np.nanmax(x) - np.nanmin(x)) or 1.0
    moves = moves[moves > 1e-6 * span]
    return float(np.median(moves)) if moves.size else span, span


def of_encoder(recording: Recording, axis: str, period: float) -> bool:
    """Is a wave as long as the stated signal period of the axis' encoder, to a turn over the positions covered?"""
    known = recording.manifest.axis(axis)
    own = known.encoder_period if known is not None else None
    return own is not None and abs(1.0 / period - 1.0 / own) * resolved_lengths(recording, axis)[1] < 1.0


@dataclass(frozen=True)
class Listed:
    """Values listed by the term, of a parameter without a scale (a power); refined by factors of up to exp(reach)."""

    listed: tuple[float, ...] = ()
    reach: float = 0.6
    bounded: ClassVar[bool] = True  # False: the recording sets the limits, not the parameter's bounds

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        return self.listed

    def neighbours(self, value: float, term: Any, recording: Recording) -> np.ndarray:
        """Values near the best one."""
        return value * np.exp(self.reach * np.linspace(-1.0, 1.0, STEPS))

    def widened(self, low: float, high: float, term: Any, recording: Recording) -> tuple[float, float]:
        """Ends of an interval, half-way to the next neighbours."""
        half = np.exp(self.reach / (STEPS - 1))
        return low / half, high * half

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """Smallest and largest value that the recording resolves."""
        return -np.inf, np.inf

    def log_prior(self, value: float, parameter: Parameter) -> float:
        """Log prior density of a value relative to typical ones."""
        return 0.0


@dataclass(frozen=True)
class Scale(Listed):
    """A scale of unknown size: its typical range as far as the recording resolves it, and coarser all else it does."""

    bounded: ClassVar[bool] = False

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        typical = next(p for p in term.nonlinear() if p.name == name).typical
        low, high = self.limits(term, recording)
        if not 0 < low < high < np.inf:
            return geometric(typical[0], typical[1], RATIO)
        inner = max(low, typical[0] / 1.5), min(high, typical[1] * 1.5)
        if inner[0] >= inner[1]:
            return geometric(low, high, COARSE_RATIO)
        below = geometric(low, inner[0], COARSE_RATIO)[:-1]
        above = geometric(inner[1], high, COARSE_RATIO)[1:]
        return (*below, *geometric(*inner, RATIO), *above)

    def log_prior(self, value: float, parameter: Parameter) -> float:
        """Half a normal distribution of the logarithm on either side of the typical range."""
        low, high = parameter.typical
        if value <= 0 or low <= 0:
            return 0.0
        beyond = max(np.log(low / value), np.log(value / high), 0.0) / np.log(TYPICAL_WIDTH)
        return -0.5 * float(beyond) ** 2


@dataclass(frozen=True)
class Times(Scale):
    """A time constant: from the sampling step to one and a half times the longest session."""

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        step, longest = resolved_times(recording)
        return step, 1.5 * longest


@dataclass(frozen=True)
class Lengths(Scale):
    """A length along the term's axis: from the usual move between rows to a third of the positions covered.

    Where a side of approach is recorded but not the approach, from a fortieth of the term's `overrun`.
    """

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        step, span = resolved_lengths(recording, term.axis)
        overrun = getattr(term, "overrun", 0.0)
        return (overrun / 40 if overrun else min(step, 1e-2 * span)), span / 3


@dataclass(frozen=True)
class Speeds(Listed):
    """A speed, as shares of the highest speed of the term's column."""

    bounded: ClassVar[bool] = False
    shares: tuple[float, ...] = (0.003, 0.006, 0.012, 0.025, 0.05, 0.1, 0.2, 0.4)
    fades: bool = False  # does the effect fade within this speed? Beyond the largest share nothing shows that it does

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        fastest = float(np.nanquantile(np.abs(recording.array(term.column)), 0.999))
        return tuple(fastest * s for s in self.shares)

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """Of what fades up to the largest speed tried; it may fade within less than the smallest."""
        if not self.fades:
            return super().limits(term, recording)
        return 0.0, self.values(term, "", recording, Signals())[-1]


@dataclass(frozen=True)
class Waves(Listed):
    """Length of a wave along the term's axis: the strongest waves of the signals, refined within a quarter turn."""

    bounded: ClassVar[bool] = False

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        x = position(recording, term.axis)
        found = periods(x[signals.rows], signals.values)
        return tuple(p for p in found if not of_encoder(recording, term.axis, p))

    def neighbours(self, value: float, term: Any, recording: Recording) -> np.ndarray:
        _, span = resolved_lengths(recording, term.axis)
        fewest = min(1.0 / value, MIN_TURNS_OF_WAVE / span)
        return 1.0 / np.unique(np.maximum(1.0 / value + 0.25 / span * np.linspace(-1.0, 1.0, 4 * STEPS), fewest))

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        return 0.0, resolved_lengths(recording, term.axis)[1] / MIN_TURNS_OF_WAVE

    def widened(self, low: float, high: float, term: Any, recording: Recording) -> tuple[float, float]:
        _, span = resolved_lengths(recording, term.axis)
        half = 0.25 / span / (4 * STEPS - 1)
        return 1.0 / (1.0 / low + half), 1.0 / max(1.0 / high - half, 1e-12 / span)


@dataclass(frozen=True)
class Places(Listed):
    """A place along the term's axis, one in 25 of the positions covered; refined between its neighbours."""

    bounded: ClassVar[bool] = False
    count: int = 25

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        x = position(recording, term.axis)
        return tuple(np.linspace(np.nanmin(x), np.nanmax(x), self.count)[1:-1])

    def neighbours(self, value: float, term: Any, recording: Recording) -> np.ndarray:
        return value + resolved_lengths(recording, term.axis)[1] / (self.count - 1) * np.linspace(-1.0, 1.0, STEPS)

    def widened(self, low: float, high: float, term: Any, recording: Recording) -> tuple[float, float]:
        half = resolved_lengths(recording, term.axis)[1] / (self.count - 1) / (STEPS - 1)
        return low - half, high + half


@dataclass(frozen=True)
class Widths(Listed):
    """Length of a stretch, as shares of the positions that the recording covers."""

    bounded: ClassVar[bool] = False
    # Wider ones also fit a step or a decay at an end of the travel: 0.12 named eight of ten of these with about 0.8.
    shares: tuple[float, ...] = (0.02, 0.035, 0.055, 0.08)

    def values(self, term: Any, name: str, recording: Recording, signals: Signals) -> tuple[float, ...]:
        _, span = resolved_lengths(recording, term.axis)
        return tuple(span * s for s in self.shares)

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """To what the widest share is refined: a wider bell is a bow of the whole axis."""
        return 0.0, float(np.exp(self.reach)) * self.shares[-1] * resolved_lengths(recording, term.axis)[1]


@dataclass(frozen=True)
class Resonances(Listed):
    """A natural frequency; estimated by the term; from three turns in the longest session to a fifth of the rate."""

    reach: float = 0.04

    def limits(self, term: Any, recording: Recording) -> tuple[float, float]:
        """Smallest and largest frequency that the recording resolves."""
        step, longest = resolved_times(recording)
        return 3.0 / longest, 0.2 / step


@dataclass(frozen=True)
class Delays(Listed):
    """A delay; estimated by the term; refined from a hundredth of a sampling step to ten of them."""

    reach: float = 10.0

    def neighbours(self, value: float, term: Any, recording: Recording) -> np.ndarray:
        late = resolved_times(recording)[0] * np.geomspace(1e-3 * self.reach, self.reach, STEPS)
        return value + np.r_[-late[::-1], late]

    def widened(self, low: float, high: float, term: Any, recording: Recording) -> tuple[float, float]:
        """Ends of an interval, half-way to the next neighbours."""
        near = 1e-3 * self.reach * resolved_times(recording)[0]
        half = max(0.5 * (high - low) * 1e3 ** (0.5 / (STEPS - 1)), 0.5 * near)
        return 0.5 * (low + high) - half, 0.5 * (low + high) + half

    def log_prior(self, value: float, parameter: Parameter) -> float:
        """The log prior of a scale, for an early or a late recording."""
        return Scale().log_prior(abs(value), parameter)


BY_UNIT: dict[str, Search] = {"s": Times(), "mm": Lengths(), "mm/s": Speeds()}


def search_of(parameter: Parameter) -> Search:
    """How a parameter is searched: as it states, else by its unit."""
    return parameter.search or BY_UNIT.get(parameter.unit, Scale())


def geometric(low: float, high: float, ratio: float) -> tuple[float, ...]:
    """Values from low to high, both included, even in the logarithm, at most `ratio` from one to the next."""
    if low <= 0:
        return tuple(np.linspace(low, high, STEPS // 2))
    return tuple(np.geomspace(low, high, max(int(np.ceil(np.log(high / low) / np.log(ratio))), 1) + 1))
