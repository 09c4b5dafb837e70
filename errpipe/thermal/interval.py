"""Prediction intervals of a season model: conformal half widths over held-out runs and held-out environments.

    half width = (1 + |predicted| / 50 um) x (known share x known + (1 - known share) x unknown) / fade
                 + widening x distance

known        half width for held-out runs, other runs of whose season took part
unknown      half width for held-out environments (seasons)
known share  0..1, per run and from its first readings: how much the fitted correction improved runs with a similar
             start temperature. It is one only where several such runs were seen and were predicted well
1 / 50 um    errors grow with the prediction and also drift: on held-out seasons a constant and a
             proportional width missed by the same factor on either side; their mean covers both. More where one
             day alone was fitted (`GAIN_SPREAD`)
distance     outside the temperatures seen, in ranges summed over the sensors
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.fitting.statistics import normal_quantile
from errpipe.thermal.arithmetic import conformal_half_width

GROWTH = 1.0 / 50.0  # 1/um
DAY = 86400.0  # s: the next day shares of one day's warmth what it starts with; neighbouring hours share nearly all
# Times the half width that covers one half of a run, predicted by the other, so that it covers the next run. Chosen on
# logs of 1, 3 and 8 days of 12 machines (seeds 5101 and 5102 of `trials.thermal --log-days`), four later logs of each:
# 92, 91 and 91 % of the rows are covered (1.0: 88, 85, 84 %; 1.5: 95, 94, 95 %).
NEXT_RUN = 1.25
# The same of a log that is shorter than three days. Chosen on single days of 165 machines (seed 901 of `trials.thermal`
# and formulas): 88 to 92 % of the rows of later days of three kinds are covered, 75 % where a heat is not measured.
NEXT_DAY = 1.6
# Standard deviation of the gain from day to day that is presumed where one day was fitted, for it cannot show any: an
# assumption, not a measurement. Chosen on 16 spindles by formulas (seeds 200 to 215), six later days of each: where the
# gain changes by a tenth, 74 % of the rows are covered (57 without, 88 with 0.08), and where it does not the width is
# 1.9 times that without (0.08: 3.1 times).
GAIN_SPREAD = 0.04
DOUBLED = 1.2  # ranges summed over the sensors (2 K on each of six): this far outside the interval is twice as wide


@dataclass(frozen=True)
class Intervals:
    """Half widths in um of a prediction of zero; `widening` is added per range outside of what was seen.

    growth: share by which a prediction of 1 um is wider than one of zero, 1/um.
    """

    known: float
    unknown: float
    widening: float
    growth: float = GROWTH

    def half_width(self, predicted: np.ndarray, factor: np.ndarray, away: np.ndarray) -> np.ndarray:
        """um, shape (rows,). predicted: um; factor: values of `factor()`; away: ranges outside."""
        return (1.0 + self.growth * np.abs(predicted)) * self.unknown * factor + self.widening * away

    def factor(self, known_share: d.Driver, fading: d.Driver) -> d.Driver:
        """What the half width at a prediction of zero is multiplied by.

        known_share: 0..1; fading: 1 or more where a run started so far outside that less than the model is used.
        """
        less = self.known / self.unknown - 1.0 if self.unknown > 0 else 0.0
        return d.Product(of=(fading, d.Affine(offset=1.0, weights=(less,), of=(known_share,))))


@dataclass(frozen=True)
class LeftOut:
    """Rows judged by gains that never saw them: error and prediction, um, (rows,); NaN where nothing judged."""

    error: np.ndarray
    predicted: np.ndarray

    def half_width(
        self,
        group: np.ndarray,
        level: float,
        runs: int | None = None,
        raised: bool = True,
        factor: np.ndarray | float = 1.0,
        growth: float = GROWTH,
    ) -> float:
        """Half width of a prediction of zero that covers a row of a new group, um; 0 where nothing was judged.

        factor: what the half width of each row is multiplied by, (rows,); growth: 1/um, of `Intervals`.
        """
        finite = np.isfinite(self.error)
        if not finite.any():
            return 0.0
        wider = np.broadcast_to(factor, self.error.shape)[finite]
        scaled = np.abs(self.error[finite]) / (1.0 + growth * np.abs(self.predicted[finite])) / wider
        return conformal_half_width(scaled, group[finite], level, runs, raised)


def of_next_run(left: LeftOut, group: np.ndarray, level: float, factor: np.ndarray, within_one_day: bool) -> float:
    """Half width of a prediction of zero in the next run, um, from halves of one run predicted by each other.

    within_one_day: whether the run holds fewer days than could be left out.
    """
    return (NEXT_DAY if within_one_day else NEXT_RUN) * left.half_width(group, level, None, False, factor)


def growth_of_one_day(half: float, level: float) -> float:
    """`growth` of a model of one day, 1/um: also what `GAIN_SPREAD` adds to the half width of a prediction of zero."""
    return max(GROWTH, normal_quantile((1.0 + level) / 2) * GAIN_SPREAD / half) if half > 0.0 else GROWTH


def independent_runs(recording: Recording, rows: np.ndarray) -> int:
    """How many independent runs the rows of a mask are: a log of several days in one run counts as its days."""
    t, run = recording.time()[rows], recording.run_codes()[rows]
    return sum(max(int(np.ptp(t[run == code]) // DAY), 1) for code in np.unique(run))


def calibrate(near: LeftOut, afar: LeftOut, group: np.ndarray, level: float, runs: int) -> Intervals:
    """Half widths from runs left out (`near`) and surroundings left out (`afar`); the unknown one is never smaller.

    group: run of each row; runs: how many independent ones there are.
    """
    known = near.half_width(group, level, runs)
    unknown = max(known, afar.half_width(group, level, runs))
    return Intervals(known, unknown, unknown / DOUBLED)
