"""Refractive index of air after Edlén (1966, Birch and Downs 1994), without humidity's small part in the slope."""

from __future__ import annotations

import numpy as np


def index_minus_one(celsius: np.ndarray, hpa: np.ndarray, vapour_pa: float = 1100.0) -> np.ndarray:
    """n - 1 at 633 nm for temperature in degC, pressure in hPa, water vapour in Pa."""
    sigma2 = (1.0 / 0.6329912) ** 2
    standard = 1e-8 * (8342.54 + 2406147.0 / (130.0 - sigma2) + 15998.0 / (38.9 - sigma2))
    pa = np.asarray(hpa) * 100.0
    factor = (1.0 + 1e-8 * (0.601 - 0.00972 * celsius) * pa) / (1.0 + 0.0036610 * celsius)
    return standard * pa / 96095.43 * factor - 1e-10 * vapour_pa * (3.7345 - 0.0401 * sigma2)


def path_error(x_mm: np.ndarray, celsius: np.ndarray, hpa: np.ndarray, at_start: tuple[float, float]) -> np.ndarray:
    """What an uncorrected interferometer reads too much, um, on a path of x mm; its index was set at the start."""
    start = index_minus_one(np.array(at_start[0]), np.array(at_start[1]))
    return x_mm * 1e3 * (index_minus_one(celsius, hpa) - start)
