"""What the measuring chain does to a recording: noise, outliers, displays, gaps, repeated rows, a dead sensor."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter


def measuring_noise(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Unit noise, white with 0 to 14 % of its variance correlated over 3 to 15 rows."""
    share = rng.uniform(0, 0.14)
    keep = np.exp(-1 / rng.uniform(3, 15))
    slow = lfilter([np.sqrt(1 - keep**2)], [1, -keep], rng.normal(size=rows + 60))[60:]
    return np.sqrt(1 - share) * rng.normal(size=rows) + np.sqrt(share) * slow


def outliers(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Additions in units of the noise: none in a quarter of the files, else on 0.3 to 0.95 % of the rows."""
    add = np.zeros(rows)
    if rng.random() < 0.75:
        hit = rng.random(rows) < rng.uniform(0.003, 0.0095)
        add[hit] = rng.choice([-1, 1], hit.sum()) * rng.uniform(5.5, 17, hit.sum())
    return add


def display_step(rng: np.random.Generator, choices: tuple[float, ...], noise: float) -> float:
    """A display's step, at most half the noise where there is a choice."""
    good = [s for s in choices if s <= 0.55 * noise] or [min(choices)]
    return float(rng.choice(good))


def empty_cells(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Cells of one column that were not written: in a quarter of the columns, up to 1 % of them."""
    if rng.random() > 0.25:
        return np.zeros(rows, bool)
    return rng.random(rows) < rng.uniform(0.001, 0.011)


def row_order(rng: np.random.Generator, rows: int) -> np.ndarray:
    """Which rows the log holds, in order: some are missing (half of the files), some stand twice (a quarter)."""
    keep = np.arange(rows)
    if rng.random() < 0.5:
        keep = keep[rng.random(rows) > rng.uniform(0.001, 0.02)]
    if rng.random() < 0.25:
        twice = np.flatnonzero(rng.random(len(keep)) < rng.uniform(0.001, 0.008))
        keep = np.insert(keep, twice, keep[twice])
    return keep
