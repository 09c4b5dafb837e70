"""Thinning of long logs before diagnosis, by a rule that uses inputs and the clock, never the mismatch.

Selected are whole stretches of neighbouring rows at the original rate: one at a random place in each of equal parts of
the log (stratified random sampling), and for a fast log as many around reversals. A row keeps its own values in
all columns, so nothing is averaged, filtered or aliased: a wave over position or an effect of speed remains visible
down to the row spacing. The cost of thinning is power, and rare events between the stretches.

Rows between stretches provide context: one at a random place in each block and every row at a reversal, with no
response, so that lags, directions and distances are continuous. Temperatures are block means.

Rare events are searched for in every row of the mismatch (`events`), and spectral lines in all rows
(`lines`); both are reported, but are not findings.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.prepare import SLOW_ROLES, distance_from_neighbours, motion
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, direction, position
from errpipe.drivers.sessions import sessions
from errpipe.kernels import responses

MOST_ROWS = 100_000  # a log up to this length is not thinned
FAST = 0.1  # s; rows closer than this are a trace of motion
JUDGED_FAST, JUDGED_SLOW = 20_000, 4_000  # selected rows, as many as of a shorter recording (`prepare`)
STRETCH = 250  # neighbouring rows of a fast log: about 30 correlation lengths of the noise
CONTEXT = 5_000  # blocks between stretches
MOST_TURNS = 8_000  # rows kept because the axis reverses there
TURN = 1e-3  # of an axis' range: a shorter return is not a reversal
WIDTHS = (1, 4, 16, 64, 256, 1024)  # rows over which means are tested for events
EVENT = 7.0  # robust standard deviations: below one false event in 10^9 means of Gaussian noise
RARE = 0.005  # largest share of outlying means that count as events instead of noise
LINE = 30.0  # times the local level; the largest of a million noise powers stays below 14 times their mean
MIN_LINE = 0.05  # amplitude of a line, in robust standard deviations of the mismatch; smaller ones are not reported
MOST_LINES, SLOWEST = 3, 50  # lines reported; periods within the log below which a line is a drift
PLACES = 64  # bins over each axis, whose means by direction are removed before lines are searched for


@dataclass(frozen=True)
class Thinned:
    """The thinned recording, a description of what was done, and the selected rows of the original."""

    recording: Recording
    notes: tuple[str, ...]
    rows: np.ndarray


def thinned(recording: Recording, seed: int = 0) -> Thinned:
    """A recording of at most about 40,000 rows; a short one is returned unchanged. Equal input gives equal rows."""
    n = len(recording)
    if n <= MOST_ROWS:
        return Thinned(recording, (), np.arange(n))
    rng = np.random.default_rng(seed)
    step = np.diff(recording.time())
    step = step[step > 0]
    fast = recording.name("time") is not None and bool(step.size) and float(np.median(step)) < FAST
    usual = float(np.median(step)) if step.size else 1.0
    turns = _turns(recording)
    judged = _judged(n, fast, turns, rng)
    kept = judged.copy()
    kept[rng.integers(0, n // CONTEXT, CONTEXT) + np.arange(CONTEXT) * (n // CONTEXT)] = True
    near = turns if turns.size <= MOST_TURNS // 2 else rng.choice(turns, MOST_TURNS // 2, replace=False)
    kept[near] = kept[np.maximum(near - 1, 0)] = True
    run = recording.run_codes()
    kept[np.r_[0, np.flatnonzero(np.diff(run)) + 1, n - 1]] = True
    rows = np.flatnonzero(kept)
    frame = recording.frame.iloc[rows].reset_index(drop=True)
    columns = {name: values[rows] for name, values in _settled(recording, fast).items()}
    for name in recording.names("error"):
        columns[name] = np.where(judged[rows], recording.array(name)[rows], np.nan)
    short = Recording(recording.manifest, frame.assign(**columns), recording.between)
    return Thinned(short, (_rule_text(n, judged, usual, fast), *_screens(recording, turns, usual)), rows)


def _judged(n: int, fast: bool, turns: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Mask of the selected rows: stratified over the log, and around reversals."""
    length, count = (STRETCH, JUDGED_FAST) if fast else (1, JUDGED_SLOW)
    around = min(turns.size, count // (2 * length)) if fast else 0
    edges = np.linspace(0, n - length, count // length - around + 1).astype(int)
    first = rng.integers(edges[:-1], np.maximum(edges[1:] - length, edges[:-1] + 1))
    if around:
        at = np.sort(rng.choice(turns, around, replace=False))
        first = np.r_[first, np.clip(at - rng.integers(0, length, around), 0, n - length)]
    out = np.zeros(n, dtype=bool)
    for k in range(length):
        out[first + k] = True
    return out


def _turns(recording: Recording) -> np.ndarray:
    """Rows at reversals of an axis, determined from its position alone."""
    out = [np.zeros(0, dtype=int)]
    for kind in ("linear", "rotary"):
        for axis in axes(recording, kind):
            x = position(recording, axis)
            if np.isfinite(x).all() and np.ptp(x) > 0:
                side = responses.direction_of_travel(sessions(recording), x, TURN * float(np.ptp(x)), 1)
                out.append(np.flatnonzero(np.diff(side) != 0) + 1)
    return np.unique(np.concatenate(out))


def _settled(recording: Recording, fast: bool) -> dict[str, np.ndarray]:
    """Columns that all rows estimate better: slow sensors as block means, speeds from positions."""
    out: dict[str, np.ndarray] = {}
    run, n = recording.run_codes(), len(recording)
    block = np.arange(n) * CONTEXT // n + CONTEXT * run.astype(np.int64)
    first = np.r_[0, np.flatnonzero(np.diff(block)) + 1]
    t = recording.time()
    for role in SLOW_ROLES if fast else ():
        for name in recording.names(role):
            values = recording.array(name)
            if np.isfinite(values).all():
                count = np.diff(np.r_[first, n])
                middle = np.add.reduceat(t, first) / count
                out[name] = np.interp(t, middle, np.add.reduceat(values, first) / count)
    if fast and np.isfinite(t).all():
        named = (*recording.names("velocity"), *recording.names("acceleration"), *recording.names("command"))
        columns = {name: recording.array(name) for name in (*named, *recording.names("position"))}
        if all(np.isfinite(v).all() for v in columns.values()):
            out |= motion(recording, columns)
    return out


def _rule_text(n: int, judged: np.ndarray, usual: float, fast: bool) -> str:
    """Description of what was done."""
    count = int(judged.sum())
    if not fast:
        return (
            f"{n} rows: {count} of them are judged, one at a random place in each part of the recording; the others "
            "give lags and sides their past. Events between judged rows are looked for in all rows."
        )
    stretches = int((np.diff(judged.astype(int)) == 1).sum() + judged[0])
    length = STRETCH * usual
    return (
        f"{n} rows every {usual:.3g} s: {count} of them are judged, {stretches} stretches of {length:.3g} s or more at "
        "the log's own rate, at random places and where axes turn; the others give lags and sides their past. Nothing "
        "is averaged: waves down to two rows are seen. The price is power (an effect is seen as well as in "
        f"{count} rows), and events rarer than one in {n / max(count, 1) * length:.3g} s are seen by the screen of all "
        "rows alone."
    )


def _screens(recording: Recording, turns: np.ndarray, usual: float) -> list[str]:
    """Description of rare events and spectral lines of the mismatch in all rows, by response."""
    out = []
    for error in recording.names("error"):
        component = str(recording.manifest.columns[error].component)
        twin = recording.name("simulated", component=component)
        if twin is None:
            continue
        mismatch = recording.array(error) - recording.array(twin)
        if np.isfinite(mismatch).mean() < 0.5:
            continue
        unit = recording.manifest.columns[error].unit or "um"
        t = recording.time()
        outliers = events(mismatch)
        if outliers is not None:
            out.append(f"{component}: {_events_text(outliers, t, turns, usual, unit)}")
        if recording.name("time") is not None:
            still = _without_motion(recording, mismatch)
            peaks = ", ".join(f"{f:.5g} Hz ({a:.3g} {unit})" for f, a in lines(still, usual))
            if peaks:
                out.append(f"{component}: with motion removed, the spectrum of all rows has lines at {peaks}")
    return out


@dataclass(frozen=True)
class Events:
    """Rows of rare events, their median height, and the number of rows averaged."""

    rows: np.ndarray
    height: float
    width: int


def events(mismatch: np.ndarray) -> Events | None:
    """Outlying means over 1 to 1024 rows whose neighbours agree (a step is no event), of the most conspicuous width."""
    best: tuple[float, Events] | None = None
    for width in WIDTHS:
        count = mismatch.size // width
        if count < 200:
            break
        means = mismatch[: count * width].reshape(count, width).mean(axis=1)
        places, gap, scale = _outlying_means(means)
        if 0 < places.size <= RARE * count:
            size = float(np.median(np.abs(gap[places]))) / scale
            if best is None or size > best[0]:
                best = size, Events(places * width + width // 2, float(np.median(gap[places])), width)
    return None if best is None else best[1]


def _outlying_means(values: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Distances from the median of the six neighbours, (n,): rows far from it, all distances, their robust spread."""
    gap, spread = distance_from_neighbours(values)
    scale = 1.4826 * float(np.nanmedian(np.abs(gap))) + 1e-300
    gap[:3] = gap[-3:] = 0.0  # too few neighbours
    return np.flatnonzero(np.abs(gap) > EVENT * np.maximum(scale, 2.0 * spread)), gap, scale


def _events_text(spikes: Events, t: np.ndarray, turns: np.ndarray, usual: float, unit: str) -> str:
    """Description of events: number, height, frequency, and whether they occur at reversals."""
    at = t[spikes.rows]
    intervals = np.diff(at)
    often = ""
    if intervals.size:
        middle, spread = float(np.median(intervals)), float(np.median(np.abs(intervals - np.median(intervals))))
        often = f", {'every' if spread < 0.05 * middle else 'on average one in'} {middle:.3g} s"
    near = 0.0
    if turns.size:
        after = t[turns][np.clip(np.searchsorted(turns, spikes.rows, side="right") - 1, 0, None)]
        near = float(np.mean((at >= after) & (at - after < 200 * usual)))
    where = f", {near:.0%} of them within {200 * usual:.2g} s after an axis turned" if near > 0.5 else ""
    many = "s" if spikes.rows.size > 1 else ""
    length = f"row{many}" if spikes.width == 1 else f"stretch{'e' * len(many)}{many} of about {spikes.width} rows"
    first = f"the first at {at[0]:.6g} s" if many else f"at {at[0]:.6g} s"
    text = f"{spikes.rows.size} {'single ' * (spikes.width == 1)}{length} standing out by {spikes.height:.3g} {unit}"
    return f"{text}{often}{where} ({first}); too rare to weigh in what is judged"


def _without_motion(recording: Recording, mismatch: np.ndarray) -> np.ndarray:
    """The mismatch minus its means by position and direction, and minus its correlation with speed.

    Reciprocating motion would otherwise add its own spectral lines.
    """
    known = np.isfinite(mismatch)
    places, moving = [], (*recording.names("velocity"), *recording.names("acceleration"))
    for axis in (*axes(recording), *axes(recording, "rotary")):
        x = position(recording, axis)
        if np.isfinite(x).all() and np.ptp(x) > 0:
            side = direction(recording, axis, TURN * float(np.ptp(x))) > 0
            places.append(np.minimum((x - x.min()) / np.ptp(x) * PLACES, PLACES - 1).astype(int) + PLACES * side)

    def within(values: np.ndarray) -> np.ndarray:
        """Values minus their mean, and minus the mean of each bin."""
        residual = values - np.mean(values[known])
        for place in places * (1 if len(places) == 1 else 3):
            count = np.maximum(np.bincount(place[known], minlength=2 * PLACES), 1)
            residual = residual - (np.bincount(place[known], residual[known], 2 * PLACES) / count)[place]
        return residual

    residual = within(mismatch)
    if moving:
        columns = np.column_stack([within(np.nan_to_num(recording.array(name))) for name in moving])
        residual = residual - columns @ np.linalg.lstsq(columns[known], residual[known], rcond=None)[0]
    return residual


def lines(mismatch: np.ndarray, usual: float) -> list[tuple[float, float]]:
    """Strongest lines of the mismatch's spectrum, from SLOWEST periods in the log on: frequency in Hz and amplitude.

    Gaps are interpolated. A line exceeds the noise around it and has a minimum share of the whole.
    """
    known = np.isfinite(mismatch)
    values = np.interp(np.arange(mismatch.size), np.flatnonzero(known), mismatch[known])
    window = np.hanning(values.size)
    power = np.abs(np.fft.rfft((values - values.mean()) * window)) ** 2
    around = max(power.size // 400, 50)
    blocks = power[: power.size // around * around].reshape(-1, around)
    level = np.repeat(np.median(blocks, axis=1) / np.log(2.0), around)  # of noise: the mean of its power
    ratio = power[: level.size] / np.maximum(level, 1e-300)
    amplitude = 2.0 * np.sqrt(power[: level.size]) / window.sum()
    ratio[:SLOWEST] = 0.0
    ratio[amplitude < MIN_LINE * 1.4826 * np.median(np.abs(values - np.median(values)))] = 0.0
    out: list[tuple[float, float]] = []
    for _ in range(MOST_LINES):
        k = int(np.argmax(ratio))
        if ratio[k] < LINE:
            break
        out.append((k / (values.size * usual), float(amplitude[k])))
        ratio[max(k - 20, 0) : k + 21] = 0.0
    return out
