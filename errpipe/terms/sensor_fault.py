"""The mismatch is confined to where one sensor is stuck, dead or stepped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.terms._base import Parameter, Term
from errpipe.terms._warm import sensors


class SensorFault(Term):
    """A sensor that the simulation reads lied for a while: stuck, dead or stepped.

    Equation   deviation = gain * (T_true - T_read) on rows first..last, 0 elsewhere; T_true drawn through the gap
    Assumes    the simulation follows that sensor with `gain`
    Typical    any
    Moves      nothing outside the faulty stretch
    Source     Ni 1997, recovery from sensor failure
    """

    term: Literal["sensor_fault"] = "sensor_fault"
    sensor: str
    first: int
    last: int
    reports_as = "sensor_fault"
    family = "measurement"
    compensable = False

    def linear(self) -> tuple[Parameter, ...]:
        return (Parameter("gain", "um/K", (0.5, 20.0), (-500.0, 500.0), "what the simulation makes of a kelvin"),)

    def drivers(self, recording: Recording) -> tuple[str, ...]:
        return (self.sensor,)

    @classmethod
    def bind(cls, recording: Recording, component: str) -> Iterator[SensorFault]:
        """Stretches where a living sensor stands still much longer than it does elsewhere."""
        for sensor in sensors(recording):
            for first, last in stuck(recording.array(sensor)):
                yield cls(sensor=sensor, first=first, last=last)

    def basis(self, recording: Recording, *nonlinear: float) -> np.ndarray:
        read = recording.array(self.sensor)
        rows = np.arange(len(read))
        inside = (rows >= self.first) & (rows <= self.last)
        good = ~inside & np.isfinite(read)
        true = np.interp(rows, rows[good], read[good]) if good.any() else read
        return np.where(inside, true - np.where(np.isfinite(read), read, true), 0.0)[:, None]


def stuck(values: np.ndarray, least: int = 20) -> list[tuple[int, int]]:
    """First and last row of stretches where a reading stays the same far longer than usual, or is missing."""
    finite = np.isfinite(values)
    same = np.r_[False, (values[1:] == values[:-1]) | ~finite[1:]]
    edges = np.flatnonzero(np.diff(np.r_[False, same, False].astype(int)))
    starts, ends = edges[::2], edges[1::2]
    lengths = ends - starts
    if lengths.size == 0:
        return []
    usual = np.percentile(lengths, 90)
    limit = max(least, 4 * usual)
    return [(int(a), int(b - 1)) for a, b, n in zip(starts, ends, lengths, strict=True) if n >= limit]
