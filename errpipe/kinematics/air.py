"""The refractive index of the air in a laser's beam."""

from __future__ import annotations

from typing import Any

import numpy as np

# Default if not measured, as in displays without weather station: degC, hPa, %.
STANDARD_AIR = (20.0, 1013.25, 50.0)
WAVELENGTH = 0.6329908  # um in vacuum, helium-neon
UNMEASURED_HUMIDITY = 14.0  # %: standard uncertainty of an unmeasured humidity, 25 to 75 %


def index_change(temperature: Any = None, pressure: Any = None, humidity: Any = None, since: Any = None) -> Any:
    """n / n_0 - 1 of the air along a record (degC, hPa, %); n_0 of its first reading, or of the air `since`.

    Unrecorded quantities are taken as at n_0; for humidity the vapour pressure, which warming does not change.
    """
    series = [None if v is None else np.asarray(v, dtype=float) for v in (temperature, pressure, humidity)]
    if all(v is None for v in series):
        return 0.0
    first = [x if v is None else v[np.isfinite(v)][0] for v, x in zip(series, STANDARD_AIR, strict=True)]
    t0, p0, h0 = first if since is None else since
    t = t0 if series[0] is None else series[0]
    p = p0 if series[1] is None else series[1]
    vapour = vapour_pressure(t0, h0) if series[2] is None else vapour_pressure(t, series[2])
    start = refractivity(t0, p0, vapour_pressure(t0, h0))
    return (refractivity(t, p, vapour) - start) / (1.0 + start)


def index_uncertainty(sensors: tuple[float, float, float]) -> float:
    """Standard uncertainty of n, 1e-6, from those of temperature, pressure and humidity (K, hPa, %)."""
    there = refractivity(*STANDARD_AIR[:2], vapour_pressure(STANDARD_AIR[0], STANDARD_AIR[2]))
    moved = np.add(STANDARD_AIR, np.diag(sensors))
    steps = [refractivity(t, p, vapour_pressure(t, h)) - there for t, p, h in moved]
    return 1e6 * float(np.linalg.norm(steps))


def refractivity(temperature: Any, pressure: Any, vapour: Any) -> Any:
    """n - 1 of air (degC, hPa, Pa of water vapour) for a helium-neon laser.

    Source: Birch and Downs, Metrologia 30 (1993) 155 and 31 (1994) 315, the revised Edlen equation; within 3e-8.
    """
    wave, pascal = WAVELENGTH**-2, 100.0 * pressure
    dry = (8342.54 + 2406147.0 / (130.0 - wave) + 15998.0 / (38.9 - wave)) * 1e-8 * pascal / 96095.43
    dense = (1.0 + 1e-8 * (0.601 - 0.00972 * temperature) * pascal) / (1.0 + 0.003661 * temperature)
    return dry * dense - vapour * (3.7345 - 0.0401 * wave) * 1e-10


def vapour_pressure(temperature: Any, humidity: Any) -> Any:
    """Pa of water vapour in air (degC, %), by Magnus' formula (WMO-No. 8: 6.112 hPa, 17.62, 243.12 degC)."""
    return 0.01 * humidity * 611.2 * np.exp(17.62 * temperature / (243.12 + temperature))
