"""Noise of a response: white with a slowly varying share, fitted to what an explanation leaves.

The slow share is a first-order process of some memory (in rows) that starts anew with each run; beside white noise it
is an ARMA(1,1) process, which a filter makes white. Share 1 and a memory of many rows is a random walk.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import noise


class Colour(NamedTuple):
    """memory: correlation length of the slow share, rows; share: its part of the noise variance."""

    memory: float
    share: float

    def filter(self) -> tuple[float, float, float]:
        """phi, theta and gain of the filter that makes noise of unit variance white."""
        phi = float(np.exp(-1.0 / self.memory))
        g0 = self.share * (1 - phi**2) + (1.0 - self.share) * (1 + phi**2)
        g1 = phi * (1.0 - self.share)
        theta = (g0 - np.sqrt(max(g0**2 - 4 * g1**2, 0.0))) / (2 * g1)
        return phi, float(theta), float(np.sqrt(g1 / theta))


USUAL = Colour(8.0, 0.06)  # of most measurements (public blind trials: memory 5 to 12, share 0 to 0.12)
MEMORIES = np.geomspace(2.0, 3000.0, 16)  # tried in a fit, in rows,
SHARES = (0.06, 0.12, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.87, 0.92, 0.95, 0.97, 0.98, 0.99, 0.995, 0.999)  # and these
HEAVY = 4.0  # robust standard deviations at which whitened rows are clipped: outliers must not decide the colour


def whiten(columns: np.ndarray, run: np.ndarray, colour: Colour = USUAL) -> np.ndarray:
    """Columns (rows,) or (rows, k) filtered so that noise of this colour and unit variance becomes white."""
    flat = columns.ndim == 1
    two = np.ascontiguousarray(columns[:, None] if flat else columns, dtype=float)
    out = noise.whiten(run, two, *colour.filter())
    return out[:, 0] if flat else out


def recolour(columns: np.ndarray, run: np.ndarray, old: Colour, new: Colour) -> np.ndarray:
    """Columns (rows, k) that were whitened by one colour, whitened by another."""
    return noise.whiten(run, noise.coloured(run, np.ascontiguousarray(columns), *old.filter()), *new.filter())


def fitted(left: np.ndarray, run: np.ndarray) -> Colour:
    """Likeliest colour of a residual (rows,)."""
    tried = [USUAL, *(Colour(float(m), s) for m in MEMORIES for s in SHARES)]
    return max(tried, key=lambda colour: _likelihood(left, run, colour))


def _likelihood(left: np.ndarray, run: np.ndarray, colour: Colour) -> float:
    """Log likelihood of a residual in noise of this colour, its variance profiled."""
    white = whiten(left, run, colour)
    most = HEAVY * 1.4826 * float(np.median(np.abs(white))) + 1e-300
    size = float(np.mean(np.clip(white, -most, most) ** 2)) + 1e-300
    return -0.5 * left.size * np.log(size) - scale(colour, run)


def scale(colour: Colour, run: np.ndarray) -> float:
    """Log of the factor by which whitening shrinks a volume of signals: the price of a colour in a likelihood."""
    return float(np.count_nonzero(run[1:] == run[:-1]) * np.log(colour.filter()[2]))


def correlation_time(left: np.ndarray, run: np.ndarray) -> float:
    """Rows per independent row of a whitened residual: 1 + 2 sum of its autocorrelation while that is positive."""
    centred = left - left.mean()
    power = float(centred @ centred)
    if power <= 0 or left.size < 20:
        return 1.0
    total = 1.0
    for lag in range(1, left.size // 4):
        same = run[lag:] == run[:-lag]
        rho = float(centred[lag:][same] @ centred[:-lag][same]) / power
        if rho < 0.05:
            break
        total += 2 * rho
    return total
