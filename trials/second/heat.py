"""Heat at a low level: rods in finite volumes, lumped bodies, rooms. Temperatures in K above the start, times in s."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm
from scipy.signal import lfilter


def lagged(t: np.ndarray, u: np.ndarray, tau: float, step: float | None = None) -> np.ndarray:
    """Exact response of `tau dy/dt + y = u`, y starting at u[0], for u linear between even points; by interpolation."""
    span = t[-1] - t[0]
    step = step or max(span / 4000.0, 1e-9)
    grid = np.arange(t[0], t[-1] + step, step)
    v = np.interp(grid, t, u)
    keep = np.exp(-step / tau)
    mid = np.concatenate([[v[0]], 0.5 * (v[1:] + v[:-1])])
    y, _ = lfilter([1 - keep], [1, -keep], mid, zi=[keep * v[0]])
    return np.interp(t, grid, y)


def bodies(
    step: float,
    capacity: np.ndarray,
    links: np.ndarray,
    power: np.ndarray,
    outside: np.ndarray,
    loss: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    """Lumped bodies [J/K] joined by conductances [W/K], heated [W] (steps x n), losing to `outside` (steps).

    Exact for inputs held over a step (matrix exponential). Returns temperatures (steps x n).
    """
    n = len(capacity)
    a = (links - np.diag(links.sum(1) + loss)) / capacity[:, None]
    big = np.zeros((n + n, n + n))
    big[:n, :n], big[:n, n:] = a, np.eye(n)
    e = expm(big * step)
    phi, gam = e[:n, :n], e[:n, n:]
    out, x = np.empty((len(outside), n)), start.astype(float).copy()
    drive = (power + outside[:, None] * loss) / capacity
    for i in range(len(outside)):
        out[i] = x
        x = phi @ x + gam @ drive[i]
    return out


def rod(
    step: float,
    cells: int,
    length: float,
    diffusivity: float,
    source: np.ndarray,
    loss: np.ndarray,
    end_loss: float = 0.0,
) -> np.ndarray:
    """Temperature rise of a rod in finite volumes, backward Euler. source [K/s] steps x cells, loss [1/s] per step.

    The loss may change from step to step (a spindle cools better when it turns). Returns steps x cells.
    """
    h = length / cells
    k = diffusivity / h**2
    lap = np.diag(np.full(cells, -2.0)) + np.diag(np.ones(cells - 1), 1) + np.diag(np.ones(cells - 1), -1)
    lap[0, 0] = lap[-1, -1] = -1.0
    ends = np.zeros(cells)
    ends[0] = ends[-1] = end_loss
    cache: dict[float, np.ndarray] = {}
    x, out = np.zeros(cells), np.empty_like(source)
    for i in range(len(source)):
        key = round(float(loss[i]), 9)
        if key not in cache:
            cache[key] = np.linalg.inv(np.eye(cells) - step * (k * lap - np.diag(key + ends)))
        x = cache[key] @ (x + step * source[i])
        out[i] = x
    return out


def room(rng: np.random.Generator, t: np.ndarray, base: float, swing: float) -> np.ndarray:
    """A workshop's air: day and night, weather, an air conditioner that cycles, doors' noise. degC."""
    day = swing * np.sin(2 * np.pi * t / 86400 + rng.uniform(0, 6.28))
    walk = np.cumsum(rng.normal(0, 1, len(t)))
    walk = lagged(t, walk - np.linspace(0, walk[-1], len(t)), 1500.0)
    walk *= 0.35 * swing / (np.std(walk) + 1e-9)
    cycle = rng.uniform(0.05, 0.25) * np.sin(2 * np.pi * t / rng.uniform(1500, 3500) + rng.uniform(0, 6))
    air = day + walk + lagged(t, cycle, 300.0)
    return base + air - air[0]


def refractivity(temp: np.ndarray, pressure_hpa: np.ndarray, water_hpa: float = 10.0) -> np.ndarray:
    """(n - 1) of air for a red He-Ne laser: Edlen's equation as revised by Birch and Downs (1994)."""
    p, s = pressure_hpa * 100.0, (1 / 0.6328) ** 2
    base = 1e-8 * (8342.54 + 2406147 / (130 - s) + 15998 / (38.9 - s))
    dry = base * p / 96095.43 * (1 + 1e-8 * (0.601 - 0.00972 * temp) * p) / (1 + 0.003661 * temp)
    return dry - water_hpa * 100.0 * (3.7345 - 0.0401 * s) * 1e-10
