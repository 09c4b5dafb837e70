"""Smooth curves over an axis' travel: a straight line and the bending modes of a free beam, or a Fourier series.

The free beam's modes are the functions that minimise bending energy, are orthogonal to offset and slope over
the travel, and need no knots; so "straightness has no slope" holds by construction. A full turn uses sines and
cosines. Mode j has the bending wave number beta_j, and a smooth curve's coefficients fall with a power of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.optimize import brentq

FULL_TURN = 359.0  # deg of travel from which a rotary axis is taken as closed


@lru_cache(maxsize=64)
def wave_numbers(modes: int) -> tuple[float, ...]:
    """Bending wave numbers of a free-free beam of length 1: cos(b) cosh(b) = 1 (4.730, 7.853, ...)."""
    roots = []
    for j in range(1, modes + 1):
        middle = (j + 0.5) * np.pi
        roots.append(brentq(lambda b: np.cos(b) - 1.0 / np.cosh(b), middle - 0.3, middle + 0.3))
    return tuple(roots)


def beam_modes(t: np.ndarray, modes: int) -> np.ndarray:
    """Modes of a free beam at t in [0, 1], mean square 1, shape (n, modes); straight continuation outside."""
    u = np.clip(np.asarray(t, dtype=float), 0.0, 1.0) - 0.5
    out = np.empty((u.size, modes))
    for j, b in enumerate(wave_numbers(modes)):
        grow = np.exp(b * (np.abs(u) - 0.5)) * (1.0 + np.exp(-2 * b * np.abs(u)))  # cosh(bu)/cosh(b/2), nearly
        if j % 2 == 0:
            value = np.cos(b * u) / np.cos(b / 2) + grow / (1.0 + np.exp(-b))
        else:
            rise = np.exp(b * (np.abs(u) - 0.5)) * (1.0 - np.exp(-2 * b * np.abs(u))) * np.sign(u)
            value = np.sin(b * u) / np.sin(b / 2) + rise / (1.0 - np.exp(-b))
        out[:, j] = value
    return out


@dataclass(frozen=True)
class AxisBasis:
    """Functions of one axis' position. rough: per function, wave number relative to the lowest bend (0: the line)."""

    low: float
    high: float
    closed: bool
    modes: int

    @property
    def size(self) -> int:
        """Number of functions: the line (open travel only) and the modes."""
        return self.modes + (0 if self.closed else 1)

    @property
    def rough(self) -> np.ndarray:
        """Relative wave number of each function, shape (size,)."""
        if self.closed:
            return np.repeat(np.arange(1, self.modes // 2 + 1), 2).astype(float)
        b = np.array(wave_numbers(self.modes))
        return np.r_[0.0, b / b[0]]

    def __call__(self, position: np.ndarray) -> np.ndarray:
        """Values at positions (mm, deg), shape (n, size); each has mean 0 and mean square 1 over the travel."""
        position = np.asarray(position, dtype=float)
        if self.closed:
            angle = np.radians(position)
            parts = [f(h * angle) for h in range(1, self.modes // 2 + 1) for f in (np.cos, np.sin)]
            return np.sqrt(2.0) * np.stack(parts, axis=1)
        t = np.clip((position - self.low) / (self.high - self.low), 0.0, 1.0)
        return np.column_stack([(t - 0.5) * np.sqrt(12.0), beam_modes(t, self.modes)])


def of_axis(kind: str, travel: tuple[float, float], modes: int = 12) -> AxisBasis:
    """The basis of an axis: Fourier for a rotary axis that closes on itself, else line and beam modes."""
    closed = kind == "rotary" and travel[1] - travel[0] >= FULL_TURN
    return AxisBasis(float(travel[0]), float(travel[1]), closed, modes - modes % 2 if closed else modes)
