"""Noise and sampling patterns of real recordings, resampled; synthetic ones where no real recording is at hand.

The noise of a real recording is what one of its repetitions leaves of another (trials.real); it keeps its colour, tails
and quantisation, because whole blocks of it are laid one after the other.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.signal import lfilter

from trials.folder import Array
from trials.real.recordings import sources
from trials.real.repetitions import twins

Rng = np.random.Generator
REAL = Path(os.environ.get("ERRPIPE_REAL_DATA", Path(__file__).parents[3] / "shared" / "real-data"))
LEAST = 200  # readings that a pool of real noise must hold
TAIL = 6.0  # rms beyond which a gap is a step or a transient of its own, not noise


@dataclass(frozen=True)
class Pool:
    """Real gaps of rms 1 in their order, and the real times of their rows in units of the shortest usual step."""

    name: str
    gaps: Array
    ticks: Array


@cache
def pools() -> tuple[Pool, ...]:
    """Every real recording with a repetition; none where the folder is absent."""
    if not REAL.is_dir():
        return ()
    out = []
    for name, sheet in sources([REAL]):
        for twin in twins(name, sheet):
            gap = twin.gap()
            gap = gap - np.median(gap)
            gap = gap[np.abs(gap) < TAIL * np.std(gap)]
            if gap.size >= LEAST:
                out.append(Pool(f"{twin.source}, {twin.kind}", gap / np.std(gap), _ticks(sheet)))
    return tuple(out)


def _ticks(sheet) -> Array:
    """Row times counted in the tenth percentile of the steps, rounded; empty where there is no clock."""
    times = sheet.names("time")
    if not times:
        return np.zeros(0, int)
    t = sheet.values(times[0])
    steps = np.diff(t)
    steps = steps[(steps > 0) & (steps < 50 * np.median(steps[steps > 0]))]
    return np.round(np.r_[0.0, np.cumsum(steps)] / np.quantile(steps, 0.1)).astype(int)


def noise(rng: Rng, rows: int) -> tuple[Array, str]:
    """Noise of rms 1 and where it is from."""
    real = pools()
    if real and rng.random() < 0.75:
        pool = real[int(rng.integers(len(real)))]
        return _blocks(rng, pool.gaps, rows), pool.name
    return _synthetic(rng, rows)


def _blocks(rng: Rng, gaps: Array, rows: int) -> Array:
    """Blocks of the real gaps, each a tenth of them or more, one after the other, either sign."""
    out: list[Array] = []
    have = 0
    while have < rows:
        length = int(rng.integers(max(gaps.size // 10, 30), gaps.size + 1))
        start = int(rng.integers(0, gaps.size - length + 1))
        out.append(gaps[start : start + length] * rng.choice([-1, 1]))
        have += length
    whole = np.concatenate(out)[:rows]
    return whole / max(float(np.std(whole)), 1e-12)


def _synthetic(rng: Rng, rows: int) -> tuple[Array, str]:
    """Coloured, heavy-tailed, or of a size that varies from stretch to stretch."""
    kind = str(rng.choice(["coloured", "heavy-tailed", "uneven"]))
    white = rng.normal(size=rows)
    if kind == "coloured":
        keep = np.exp(-1 / rng.uniform(2, 30))
        share = rng.uniform(0.2, 0.7)
        slow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=rows + 100))[100:]
        white = np.sqrt(1 - share) * white + np.sqrt(share) * slow
    elif kind == "heavy-tailed":
        white = rng.standard_t(rng.uniform(3, 6), size=rows)
    else:
        pieces = np.exp(rng.normal(0, 0.5, 8))
        white = white * np.repeat(pieces, -(-rows // 8))[:rows]
    return white / np.std(white), kind


def kept_rows(rng: Rng, rows: int) -> Array:
    """Which rows a logger with the gaps of a real one would have kept; all where none fits."""
    real = [p for p in pools() if p.ticks.size > 100]
    if not real or rng.random() < 0.4:
        return np.arange(rows)
    ticks = real[int(rng.integers(len(real)))].ticks
    start = int(rng.integers(0, max(ticks.size // 2, 1)))
    kept = np.unique(ticks[start:] - ticks[start])
    kept = np.concatenate([kept + k * (kept[-1] + 1) for k in range(-(-rows // (int(kept[-1]) + 1)))])
    kept = kept[kept < rows]
    return kept if kept.size >= max(200, 0.15 * rows) else np.arange(rows)
