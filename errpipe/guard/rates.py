"""Rate of change and noise of each sensor in a recording: the limits within which a controller accepts a reading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from errpipe.domain.recording import Recording

FASTER = 2.0  # times the fastest recorded change: another shift may warm a machine faster
NOISE_SIGMAS = 6.0  # standard deviations of the noise: 2 in 1e9 samples of a normal distribution are beyond


@dataclass(frozen=True)
class Bounds:
    """Smallest and largest rate, per s, and smallest noise of a role's readings, in its canonical unit."""

    slowest: float
    fastest: float
    noise: float


# Chosen on: a shop sensor of the 0.1 K class has 0.2 K of noise and resolution; the air of a hall changes by a kelvin
# a minute when a door opens, and no machine body changes faster than 2 K/s.
ROLES = {
    "temperature": Bounds(1 / 60, 2.0, 0.2),
    "pressure": Bounds(1 / 60, 10.0, 0.5),
    "humidity": Bounds(5 / 60, 10.0, 1.0),
}


@dataclass(frozen=True)
class ReadingRate:
    """Largest plausible change of a reading: `max_rate` per s, and `noise` on top of it, in the column's unit."""

    max_rate: float
    noise: float


def estimate_rates(recording: Recording) -> dict[str, ReadingRate]:
    """Column -> rate and noise, for temperatures, pressures and humidities; without times the smallest of its role."""
    run = recording.run_codes()
    time = recording.time() if recording.name("time") is not None else np.full(len(recording), np.nan)
    limits = {}
    for role, bounds in ROLES.items():
        for name in recording.names(role):
            limits[name] = of_readings(recording.array(name), time, run, bounds)
    return limits


def of_readings(values: np.ndarray, time: np.ndarray, run: np.ndarray, bounds: Bounds) -> ReadingRate:
    """Rate and noise of one sensor: values, time in s and run, each of shape (rows,)."""
    seen = np.isfinite(values)
    values, time, run = values[seen], time[seen], run[seen]
    step, span = np.diff(values), np.diff(time)
    within = (run[1:] == run[:-1]) & (span > 0)
    noise = max(bounds.noise, NOISE_SIGMAS * noise_of(values, run))
    if not within.any():
        return ReadingRate(bounds.slowest, noise)
    moved = np.maximum(np.abs(step[within]) - noise, 0.0)
    fastest = FASTER * float((moved / span[within]).max())
    return ReadingRate(min(max(fastest, bounds.slowest), bounds.fastest), noise)


def noise_of(values: np.ndarray, run: np.ndarray) -> float:
    """Standard deviation of the noise, from the median of second differences: insensitive to drift and single jumps.

    A second difference of white noise has six times its variance; 0.6745 is the median of |x| of a standard normal.
    """
    if values.size < 3:
        return 0.0
    bend = np.diff(values, n=2)[run[2:] == run[:-2]]
    return float(np.median(np.abs(bend)) / 0.6745 / np.sqrt(6.0)) if bend.size else 0.0
