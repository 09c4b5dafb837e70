"""How far a season model may be wrong: conformal half widths over runs left out and over surroundings left out.

    half width = (1 + |predicted| / 50 um) x (known share x known + (1 - known share) x unknown) / fade
                 + widening x distance

known        what runs left out needed: other runs of their season took part
unknown      what surroundings (seasons) left out whole needed
known share  0..1, per run and from its first readings: how much the learnt correction earned on runs that started as
             warm. It is one only where several such runs were seen and were predicted well
1 / 50 um    a model is wrong by a share of its own movement as well as by a drift: on seasons left out both ways
             of counting missed by the same factor, one to either side; their middle covers both
distance     outside the temperatures seen, in ranges summed over the sensors
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d
from errpipe.fitting.thermal_arithmetic import conformal_half_width

GROWTH = 1.0 / 50.0  # 1/um
DOUBLED = 1.2  # ranges summed over the sensors (2 K on each of six): this far outside the interval is twice as wide


@dataclass(frozen=True)
class Intervals:
    """Half widths in um of a prediction of zero; `widening` is added per range outside of what was seen."""

    known: float
    unknown: float
    widening: float

    def half_width(self, predicted: np.ndarray, factor: np.ndarray, away: np.ndarray) -> np.ndarray:
        """um, shape (rows,). predicted: um; factor: values of `factor()`; away: ranges outside."""
        return (1.0 + GROWTH * np.abs(predicted)) * self.unknown * factor + self.widening * away

    def factor(self, known_share: d.Driver, fading: d.Driver) -> d.Driver:
        """What the half width where nothing is known is multiplied by.

        known_share: 0..1; fading: 1 or more where a run started so far outside that less than the model is used.
        """
        less = self.known / self.unknown - 1.0 if self.unknown > 0 else 0.0
        return d.Product(of=(fading, d.Affine(offset=1.0, weights=(less,), of=(known_share,))))


@dataclass(frozen=True)
class LeftOut:
    """Rows judged by gains that never saw them: error and prediction, um, (rows,); NaN where nothing judged."""

    error: np.ndarray
    predicted: np.ndarray

    def half_width(self, group: np.ndarray, level: float, runs: int, raised: bool = True) -> float:
        """Half width of a prediction of zero that covers a row of a new group, um; 0 where nothing was judged."""
        seen = np.isfinite(self.error)
        if not seen.any():
            return 0.0
        scaled = np.abs(self.error[seen]) / (1.0 + GROWTH * np.abs(self.predicted[seen]))
        return conformal_half_width(scaled, group[seen], level, runs, raised)


def calibrate(near: LeftOut, afar: LeftOut, group: np.ndarray, level: float, runs: int) -> Intervals:
    """Half widths from runs left out (`near`) and surroundings left out (`afar`); the unknown is never the narrower.

    group: run of each row; runs: how many independent ones there are.
    """
    known = near.half_width(group, level, runs)
    unknown = max(known, afar.half_width(group, level, runs))
    return Intervals(known, unknown, unknown / DOUBLED)
