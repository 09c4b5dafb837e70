"""Location of the mismatch: rms before and after by run, direction, stretch, temperature, speed and coolant."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np

from errpipe.diagnosis.hypotheses import Hypothesis
from errpipe.diagnosis.whiteness import both_ways
from errpipe.domain.diagnosis import ChangePoint, Extent, Regime
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, position_name

LEAST_ROWS = 10  # rows: a regime or stretch with fewer is not reported
BLOCKS = 120  # stretches of time whose means are searched for changes
SHORTEST = 3  # blocks between two changes
MOST_CHANGES = 4  # change points reported; more indicate a drift
CHANGE = 25.0  # squared contrast, in variances of independent block means, from which a change is significant


def extent_of(h: Hypothesis, recording: Recording, nonlinear: tuple[float, ...]) -> Extent:
    """The range to which a hypothesis is limited."""
    if h.mask and h.mask[0] == "runs":
        return Extent(runs=tuple(h.mask[1]))
    if h.mask:
        return Extent(ranges={h.mask[1]: (float(h.mask[2]), float(h.mask[3]))})
    return Extent(ranges=h.terms[0].active_ranges(recording, *nonlinear))


def regimes(
    recording: Recording, rows: np.ndarray, before: np.ndarray, after: np.ndarray, mismatch: np.ndarray, noise: float
) -> tuple[Regime, ...]:
    """rms of the mismatch before and after in each part of the recording, and the part's share of the variance.

    mismatch: with datum and gains of the simulation fitted; its energy beyond `noise` (rms) is divided among the parts.
    """
    out, energy = [], mismatch**2 - noise**2
    total = float(energy.sum())
    for what, inside in _parts(recording, rows):
        if inside.sum() >= LEAST_ROWS:
            b, a = (float(np.sqrt(np.mean(v[inside] ** 2))) for v in (before, after))
            exceeds = total > 0.1 * rows.size * noise**2
            share = float(np.clip(energy[inside].sum() / total, 0.0, 1.0)) if exceeds else None
            out.append(Regime(what=what, rows=int(inside.sum()), rms_before_um=b, rms_after_um=a, share=share))
    return tuple(out)


def between_runs(run: np.ndarray, mismatch: np.ndarray, noise: float) -> float | None:
    """Share of the mismatch's energy beyond the noise that is one offset per run; None if none is significant."""
    codes, inside, count = np.unique(run, return_inverse=True, return_counts=True)
    total = float(np.sum((mismatch - mismatch.mean()) ** 2)) - run.size * noise**2
    if codes.size < 3 or total <= 0.1 * run.size * noise**2:
        return None
    mean = np.bincount(inside, mismatch) / count - mismatch.mean()
    return float(np.clip((np.sum(count * mean**2) - codes.size * noise**2) / total, 0.0, 1.0))


def changes(recording: Recording, rows: np.ndarray, mismatch: np.ndarray) -> tuple[ChangePoint, ...]:
    """Lasting changes of the mismatch's level or size: binary segmentation of its block means in time.

    The autocorrelation of block means reduces the evidence, so that a random walk has no change points.
    """
    clock = recording.name("time")
    t = recording.time()[rows] if clock else rows.astype(float)
    count = int(np.clip(rows.size // 12, 8, BLOCKS))
    block = np.arange(rows.size) * count // rows.size
    first = np.searchsorted(block, np.arange(count))
    fill = np.bincount(block)
    level = np.bincount(block, mismatch) / fill
    spread = np.sqrt(np.bincount(block, (mismatch - level[block]) ** 2) / fill)
    change_points = []
    for what, values in (("level", level), ("size", np.log(spread + 1e-3 * spread.mean() + 1e-300))):
        for k, low, high in _segments(values):
            if what == "size":
                low, high = float(np.exp(low)), float(np.exp(high))
            at = float(t[first[k]])
            change_points.append(ChangePoint(column=clock or "row", at=at, what=what, before_um=low, after_um=high))
    return tuple(sorted(change_points, key=lambda c: c.at))


def _segments(values: np.ndarray) -> list[tuple[int, float, float]]:
    """Cuts of a series into level stretches: (first index after the cut, mean before, mean after)."""
    cuts = [0, values.size]
    while len(cuts) < MOST_CHANGES + 2:
        best = (0.0, 0)
        for a, b in itertools.pairwise(cuts):
            for k in range(a + SHORTEST, b - SHORTEST + 1):
                gain = (values[a:k].mean() - values[k:b].mean()) ** 2 * (k - a) * (b - k) / (b - a)
                best = max(best, (float(gain), k))
        if not best[1]:
            break
        fresh = sorted([*cuts, best[1]])
        residual = np.concatenate([values[a:b] - values[a:b].mean() for a, b in itertools.pairwise(fresh)])
        rho = float(np.clip(residual[1:] @ residual[:-1] / max(residual @ residual, 1e-300), 0.0, 0.95))
        if best[0] * (1 - rho) / (1 + rho) < CHANGE * float(residual @ residual) / max(values.size - len(fresh), 1):
            break
        cuts = fresh
    means = [float(values[a:b].mean()) for a, b in itertools.pairwise(cuts)]
    return [(k, low, high) for k, low, high in zip(cuts[1:-1], means[:-1], means[1:], strict=True)]


def _parts(recording: Recording, rows: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    run, labels = recording.run_codes()[rows], recording.run_labels()
    codes, sides = np.unique(run), both_ways(recording, rows)
    for c in codes if codes.size > 1 else ():
        yield f"run {labels[c]}", run == c
    for axis in axes(recording):
        name = position_name(recording, axis)
        x = recording.array(name)[rows]
        if axis in sides:
            yield f"{name} approached from below", sides[axis] > 0
            yield f"{name} approached from above", sides[axis] < 0
        cuts = np.quantile(x, [0.0, 1 / 3, 2 / 3, 1.0])
        for word, low, high in zip(("lower", "middle", "upper"), cuts[:-1], cuts[1:], strict=True):
            yield f"{word} third of {name}", (x >= low) & (x <= high)
    for name in (n for role in ("temperature", "spindle_speed", "feed", "load") for n in recording.names(role)):
        u = recording.array(name)[rows]
        middle = np.median(u)
        if (u > middle).any():
            yield f"{name} up to {middle:.4g}", u <= middle
            yield f"{name} above {middle:.4g}", u > middle
    for u in (recording.array(name)[rows] for name in recording.names("coolant")):
        if np.unique(u).size > 1:
            yield "coolant on", u > 0.5
            yield "coolant off", u <= 0.5
