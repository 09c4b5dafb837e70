"""How far one sensor's reading is from proportional to an error, place by place, and how it extrapolates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from errpipe.errors import DataError


@dataclass(frozen=True)
class Placement:
    """Nonlinearity per candidate place (share of the error's range) and the best of them."""

    residual: np.ndarray
    gain: np.ndarray
    best: int


def linearity(readings: np.ndarray, error: np.ndarray, criterion: Literal["rms", "max"] = "rms") -> Placement:
    """Residual of error = gain x reading at each place. readings: (times, places); error: (times,).

    The gain is the least-squares slope through the origin. Raises DataError where the error never moves.
    """
    span = float(np.ptp(np.r_[0.0, error]))
    if span == 0.0:
        raise DataError("placement: the error never changes, so no place can predict it")
    power = np.sum(readings**2, axis=0)
    gain = np.where(power > 0, readings.T @ error / np.where(power > 0, power, 1.0), 0.0)
    residual = error[:, None] - readings * gain
    size = np.sqrt(np.mean(residual**2, axis=0)) if criterion == "rms" else np.abs(residual).max(axis=0)
    return Placement(size / span, gain, int(np.argmin(size)))


def finest(places: np.ndarray, residual: np.ndarray) -> float:
    """Place of least residual, refined by a parabola through its neighbours. places: (n,), equidistant."""
    k = int(np.argmin(residual))
    if k in (0, residual.size - 1):
        return float(places[k])
    low, mid, high = residual[k - 1] ** 2, residual[k] ** 2, residual[k + 1] ** 2
    bend = low - 2.0 * mid + high
    shift = 0.5 * (low - high) / bend if bend > 0 else 0.0
    return float(places[k] + shift * (places[1] - places[0]))


def extrapolation(
    reading: np.ndarray, error: np.ndarray, new_reading: np.ndarray, new_error: np.ndarray, degree: int
) -> float:
    """rms error, as a share of the new range, of a polynomial through the origin fitted on one run and used on another.

    reading, error: (n,) of the run that fits; new_*: (m,) of the other; degree 1 is the proportional model.
    """
    powers = np.arange(1, degree + 1)
    scale = float(np.abs(reading).max()) or 1.0
    weights = np.linalg.lstsq((reading[:, None] / scale) ** powers, error, rcond=None)[0]
    residual = new_error - (new_reading[:, None] / scale) ** powers @ weights
    return float(np.sqrt(np.mean(residual**2)) / np.ptp(new_error))
