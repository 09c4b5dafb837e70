"""Lines of a spectrum over position: the strongest waves of a signal, and which of them are orders of one wave."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

CELLS = 2**15  # most cells of a search for waves; the shortest wave is four of them long
# Turns that a wave makes within the positions covered: with fewer it is any smooth curve
MIN_TURNS_OF_WAVE = 1.25
MIN_REPEATED_TURNS = 2.5  # and from which its harmonics are distinguished: with fewer too little repeats
MULTIPLES = (2, 3, 4)  # of a wave at few places, which may stand out beside it
STRONGEST = 12  # waves kept of each signal
MAX_LINES = 6  # waves of one signal
# Turns over the positions covered by which two lines differ at least: nearer ones would cancel each other
MIN_SEPARATION = 1.0
# Power of a line over the mean power of white noise; the largest of 10^6 noise powers stays below 14
MIN_POWER_RATIO = 30.0
# Turns of the base within the positions covered: with fewer every line is near some multiple of it
MIN_BASE_TURNS = 6.0
MAX_ORDER = 100  # highest multiple of a base that is looked for
NEAR = 0.35  # turns over the positions covered by which a line may miss a multiple of the base
KNOWN_BASE_DISTANCE = 0.12  # and of a base that is known, for it may make few turns
MISSING_BASE = 4  # the base itself may be absent down to this share of the lowest line (cogging: slots and poles)
FEW_PLACES = 40  # up to so many a repeated profile of chance looks like a wave: see `waves_of_few_places`
SCATTER = 0.02  # of the longest way between neighbouring places: actual positions nearer than that are of one target
FALSE_ALARMS = 0.01  # false-alarm probability of the strongest wave of a random profile
MAX_WAVES_PER_STEP = 2.0  # waves within the mean step between places, the most that uneven places are asked about
BOWED = 0.5  # share of a wave at the places that a cubic must leave: one that even places fold down to a bow is a bow
FOLDED = 0.5  # share of the residual of longer waves that one shorter than two steps, an alias else, must go below
CLEARLY = 1.1  # factor by which a longer base must explain more power than a shorter one


def periods(at: np.ndarray, signals: tuple[np.ndarray, ...]) -> tuple[float, ...]:
    """Lengths of the strongest waves of each signal along `at`, each with neighbours an eighth of a turn apart."""
    span, at = float(np.ptp(at)) if at.size else 0.0, at_targets(at)
    strongest: set[float] = set()
    few = np.unique(at).size <= FEW_PLACES
    for signal in signals:
        for f in waves_of_few_places(at, signal) if few else peaks(at, signal, STRONGEST):
            for shift in (-0.25, -0.125, 0.0, 0.125, 0.25):
                strongest.add(float(1.0 / max(f + shift / span, MIN_TURNS_OF_WAVE / span)))
    return tuple(sorted(strongest))


def at_targets(at: np.ndarray) -> np.ndarray:
    """The positions, or where they are actual ones that scatter about targets the mean of each target's, shape (rows,).

    Rows of one target share its error, and the ways between targets limit the waves that they show, not the scatter.
    """
    order = np.argsort(at, kind="stable")
    ways = np.diff(at[order])
    scatter = SCATTER * float(ways.max(initial=0.0))
    target = np.empty(at.size, dtype=int)
    target[order] = np.r_[0, np.cumsum(ways > scatter)][: at.size]
    first, last = (np.flatnonzero(np.diff(target[order], **end)) for end in ({"prepend": -1}, {"append": -1}))
    if np.any(at[order][last] - at[order][first] > scatter):
        return at  # a scan, or stretches that are scanned
    return (np.bincount(target, at) / np.bincount(target))[target]


def peaks(at: np.ndarray, signal: np.ndarray, max_peaks: int) -> np.ndarray:
    """Frequencies (1/length) of the strongest waves along `at`, strongest first, to a quarter turn over the span.

    From twice the step between places to the positions covered over MIN_TURNS_OF_WAVE. Periodogram of the means of
    narrow cells, padded fourfold; a cubic is subtracted first.
    """
    places = np.unique(at)
    span = float(places[-1] - places[0]) if places.size > 1 else 0.0
    if span <= 0:
        return np.zeros(0)
    cells = int(np.clip(8 * places.size, 64, CELLS))
    step = span / (cells - 1)
    shortest = max(2.0 * span / (places.size - 1), 4.0 * step)
    cell = np.minimum(((at - places[0]) / step).astype(int), cells - 1)
    rows_in = np.bincount(cell, minlength=cells)
    inside, place = rows_in > 0, np.linspace(-1.0, 1.0, cells)
    count = 4 * int(2 ** np.ceil(np.log2(cells)))
    frequency = np.fft.rfftfreq(count, step)
    total = np.bincount(cell, weights=signal - signal.mean(), minlength=cells)
    mean = np.where(inside, total / np.maximum(rows_in, 1), 0.0)
    weight = np.sqrt(rows_in)
    if inside.sum() > 4:
        mean[inside] -= np.polyval(np.polyfit(place[inside], mean[inside], 3, w=weight[inside]), place[inside])
    allowed = (frequency >= MIN_TURNS_OF_WAVE / span) & (frequency <= 1 / shortest)
    power = np.where(allowed, np.abs(np.fft.rfft(mean * weight, count)), 0.0)
    tops = np.flatnonzero((power[1:-1] >= power[:-2]) & (power[1:-1] > power[2:])) + 1
    return frequency[tops[np.argsort(-power[tops], kind="stable")][:max_peaks]]


def waves_of_few_places(at: np.ndarray, signal: np.ndarray) -> np.ndarray:
    """Frequencies (1/length) of waves that stand out of the means of a few places, visited often, strongest first.

    Rows of one place share its error, so places are counted, not rows: beside a cubic, P places and a wave that leaves
    the share q of the sum of squares, chance leaves as little with q^((P - 6) / 2) times the number of frequencies
    (F test; Lomb-Scargle false-alarm probability). From MIN_TURNS_OF_WAVE to half the mean step between places: uneven
    places distinguish waves that even places alias. A wave shorter than two steps must leave less than FOLDED of what
    longer ones do, and one about as long as a step between even places is a slope or a bow there (BOWED).
    """
    places, index = np.unique(at, return_inverse=True)
    free = places.size - 6
    if free < 1:
        return np.zeros(0)
    mean = np.bincount(index, signal) / np.bincount(index)
    span = float(places[-1] - places[0])
    highest = MAX_WAVES_PER_STEP * (places.size - 1) / span
    frequency = np.arange(MIN_TURNS_OF_WAVE / span, highest * (1 + 1e-9), 0.125 / span)
    cubic = np.polynomial.chebyshev.chebvander(2 * (places - places[0]) / span - 1, 3)
    rest = _residual(cubic, mean)
    long = frequency <= 0.5 * (places.size - 1) / span
    beside = [_residual(cubic, waves(places, f)) for f in frequency]
    # sine and cosine: places.size in all
    bowed = ~long & np.array([np.sum(wave**2) < BOWED * places.size for wave in beside], dtype=bool)
    left = np.where(bowed, np.inf, [_squares(_residual(wave, rest)) for wave in beside])
    if not left.size or _squares(rest) <= 0:
        return np.zeros(0)
    chance = max(highest * span, 1.0) * (left / _squares(rest)) ** (free / 2)
    padded = np.r_[np.inf, left, np.inf]
    clear = long | (left < FOLDED * left[long].min(initial=np.inf))
    best = np.flatnonzero((left <= padded[:-2]) & (left < padded[2:]) & (chance < FALSE_ALARMS) & clear)
    chosen = frequency[best[np.argsort(left[best], kind="stable")][:STRONGEST]]
    return np.array([_between(cubic, places, rest, f, 0.125 / span) for f in chosen])


def _between(cubic: np.ndarray, places: np.ndarray, rest: np.ndarray, f: float, step: float) -> float:
    """The frequency within a step of f whose wave, beside a cubic, leaves least of the residual."""
    trial = np.maximum(f + step * np.linspace(-1.0, 1.0, 17), MIN_TURNS_OF_WAVE / float(np.ptp(places)))
    return float(min(trial, key=lambda one: _squares(_residual(_residual(cubic, waves(places, one)), rest))))


def harmonics_of_few_places(at: np.ndarray, signal: np.ndarray) -> Iterator[tuple[float, tuple[float, ...]]]:
    """Waves of a few places (1/length) that repeat, and which of their multiples stand out beside them (F test)."""
    places, index = np.unique(at, return_inverse=True)
    mean, span = np.bincount(index, signal) / np.bincount(index), float(places[-1] - places[0])
    cubic = np.polynomial.chebyshev.chebvander(2 * (places - places[0]) / (span or 1.0) - 1, 3)
    for f in waves_of_few_places(at, signal):
        orders: list[float] = []
        block = np.column_stack([cubic, waves(places, f)])
        for k in MULTIPLES if f * span >= MIN_REPEATED_TURNS else ():
            more, free = np.column_stack([block, waves(places, k * f)]), places.size - block.shape[1] - 3
            if 2 * k * f <= (places.size - 1) / span and free > 0:
                left = _squares(_residual(more, mean)) / max(_squares(_residual(block, mean)), 1e-300)
                if left ** (free / 2) < FALSE_ALARMS:
                    block, orders = more, [*orders, float(k)]
        if orders:
            yield float(f), (1.0, *orders)


def _residual(block: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Residual of a fit of a block's columns to values (rows,) or (rows, k)."""
    return values - block @ np.linalg.lstsq(block, values, rcond=None)[0]


def _squares(values: np.ndarray) -> float:
    return float(values @ values)


def lines(at: np.ndarray, signal: np.ndarray) -> list[tuple[float, float]]:
    """Waves of a signal along `at`, strongest first, as (1/length, amplitude): one is taken away, the next found.

    The textbook method is CLEAN (Hoegbom 1974) with all waves refitted at each step.
    """
    span = float(np.ptp(at))
    frequencies: list[float] = []
    amplitude: list[float] = []
    base = np.polynomial.chebyshev.chebvander(2 * (at - at.min()) / max(span, 1e-300) - 1, 3)
    rest = _residual(base, signal)
    while len(frequencies) < MAX_LINES:
        rough = peaks(at, rest, 1)
        if not rough.size:
            break
        best = float(rough[0])
        for reach in (0.5, 0.05, 0.005):
            trial = best + reach / span * np.linspace(-1, 1, 21)
            best = float(max(trial[trial > 0], key=lambda f: power(at, rest, f)))
        gained = power(at, rest, best)
        if gained < MIN_POWER_RATIO * (float(rest @ rest) - gained) / at.size:
            break
        if any(abs(best - f) * span < MIN_SEPARATION for f in frequencies):
            break  # a wave that is stronger here than there, or no wave
        frequencies.append(best)
        block = np.column_stack([base, *(waves(at, f) for f in frequencies)])
        fitted = np.linalg.lstsq(block, signal, rcond=None)[0]
        rest = signal - block @ fitted
        amplitude = [float(np.hypot(*fitted[k : k + 2])) for k in range(base.shape[1], block.shape[1], 2)]
    return sorted(zip(frequencies, amplitude, strict=True), key=lambda line: -line[1])


def waves(at: np.ndarray, frequency: float) -> np.ndarray:
    """Sine and cosine, shape (rows, 2)."""
    angle = 2 * np.pi * frequency * at
    return np.column_stack([np.sin(angle), np.cos(angle)])


def power(at: np.ndarray, signal: np.ndarray, frequency: float) -> float:
    """Sum of squares that a wave explains."""
    block = waves(at, frequency)
    return float(block.T @ signal @ np.linalg.lstsq(block, signal, rcond=None)[0])


def harmonic_series(
    lines: list[tuple[float, float]], span: float, known: Iterable[float] = ()
) -> Iterator[tuple[float, tuple[float, ...], bool]]:
    """Bases (1/length) of which lines are orders, these orders, the strongest first, and whether the base is known.

    At least two lines of an unknown base; where it does not hold all lines, also these as multiples, whole or not, of
    the strongest (a screw and a coupling). A known base may have a single order; it may make a single turn, and lines
    then have to agree more closely.
    """
    best: tuple[float, float, tuple[int, ...]] | None = None
    bases = {f / m for f, _ in lines for m in range(1, MISSING_BASE + 1)}
    for base in sorted((b for b in bases if b * span >= MIN_BASE_TURNS), reverse=True):
        orders = _orders(lines, base, NEAR / span)
        total = sum(a**2 for _, _, a in orders)
        if len(orders) > 1 and (best is None or total > CLEARLY * best[0]):
            refined = sum(f * k * a**2 for k, f, a in orders) / sum(k**2 * a**2 for k, _, a in orders)
            best = (total, refined, tuple(k for k, _, _ in orders))
    if best is not None:
        yield best[1], best[2], False
    every = [(f, a) for f, a in lines if f * span >= MIN_BASE_TURNS]
    if len(every) > 1 and (best is None or len(best[2]) < len(every)):
        yield every[0][0], tuple(_ratio(f / every[0][0], f * span) for f, _ in every), False
    for base in known:
        orders = _orders(lines, base, KNOWN_BASE_DISTANCE / span)
        if orders and (len(orders) > 1 or orders[0][0] > 1):
            yield base, tuple(k for k, _, _ in orders), True


def _ratio(ratio: float, turns: float) -> float:
    """The whole number within NEAR of a ratio of two lines, else the ratio; turns: of the line over the span."""
    whole = round(ratio)
    return float(whole) if whole >= 1 and abs(whole / ratio - 1) * turns < NEAR else round(ratio, 4)


def _orders(lines: list[tuple[float, float]], base: float, near: float) -> list[tuple[int, float, float]]:
    """Orders of a base among the lines, each with its strongest line, the strongest first."""
    out: dict[int, tuple[int, float, float]] = {}
    for f, a in sorted(lines, key=lambda line: -line[1]):
        k = round(f / base)
        if 1 <= k <= MAX_ORDER and abs(f - k * base) < near:
            out.setdefault(k, (k, f, a))
    return list(out.values())
