"""A reading that no longer changes: a logger that repeats its last value, a hung transmitter."""

from __future__ import annotations

import math
from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.domain import driver as d
from errpipe.guard import composed as c
from errpipe.guard import rates
from errpipe.guard.rows import HealthyReadings
from errpipe.guard.rules._base import FALSE_ALARMS, FREEZE_S, Rule, activity, activity_of

REVIVED = 4.0  # times `still`: hysteresis, the activity from which a frozen sensor is accepted again (by judgement)
# For a sensor without replacement, where a false alarm costs the whole correction: a healthy one always shows its own
# noise, unless its resolution hides it; and the air of a hall changes by a kelvin a minute when a door opens.
NOISE_SHARE, MOST_EQUAL = 0.1, 0.05  # least share of its variance in an active one; share of equal successive readings
# Coarse readings repeat for as long as the temperature rests, which the longest of few hours does not bound: the time
# until such a sensor counts as frozen is multiplied. Chosen on `trials.thermal` 45011 to 45014, 256 sensors of 0.1 K:
# in the third season 11 healthy ones are called frozen with 1, 2 with 1.25, 1 with 1.5; 2 leaves a fifth untested.
LONGER = 1.5
MIN_ACTIVITY = 1e-12  # of the median activity: reached 2.3 h after a reading froze; the limit of single precision
STILL_MORE = 20.0  # factor on the rate at which a healthy sensor may look frozen: it is accepted again when it changes


class FrozenReading(Rule):
    """1 while a reading is constant for longer than any healthy one.

    Activity is zero at the start, so what fades to `still` in half the time that `usual` does is added: a run has
    one start, and a coarse reading rests a hundred times. `trials.thermal` 45011 to 45014, 256 sensors of 0.1 K: 1
    healthy one is called frozen with half of the time, 3 with a third, 16 with a quarter.
    """

    rule: Literal["frozen_reading"] = "frozen_reading"
    still: float = Field(ge=0, description="Threshold of the lagged square.")
    usual: float = Field(gt=0, description="Mean of the lagged square of healthy readings.")
    symptom: ClassVar[str] = "loses its own noise"
    nodes: ClassVar[int] = 6

    @classmethod
    def learn(cls, rows: HealthyReadings, i: int, per_hour: float) -> FrozenReading | None:
        """Near 0 a square of noise follows a power law, and that of a reading that rests fades exponentially, so minus
        its logarithm has Gumbel's tail."""
        usual, alive = _activity(rows, i)
        if usual <= 0:
            return None
        first = np.r_[True, rows.run[1:] != rows.run[:-1]]
        alive = alive + rows.lagged(usual * first[:, None], FREEZE_S)[:, 0]
        rate = STILL_MORE * per_hour
        level = float(np.exp(-rows.rare(-np.log(np.maximum(alive, np.finfo(float).tiny)), rate, max_shape=1e-6)))
        if _coarse(rows, i):
            level = usual * (level / usual) ** LONGER
        return cls(still=level, usual=usual) if level > MIN_ACTIVITY * np.median(alive) else None

    @classmethod
    def alone(cls, rows: HealthyReadings, i: int) -> FrozenReading | None:
        """Of a sensor that has lost its own noise.

        A lag holds N = 2 / w - 1 readings, w the weight of one: the mean of N squares is below a share s of their
        variance with a probability of at most (e s)^(N / 2) (Chernoff's bound), held at the rate of false alarms.
        """
        x, within = rows.x[:, i], rows.run[1:] == rows.run[:-1]
        noise = rates.noise_of(x, rows.run)
        if not within.any() or _coarse(rows, i) or noise <= 0.0:
            return None
        step = float(np.median(np.diff(rows.t)[within]))
        new = -np.expm1(-step / FREEZE_S)  # weight of one reading
        rare = (FALSE_ALARMS / 1000 * step / 3600) ** (2.0 * new / (2.0 - new)) / np.e
        return cls(still=float(min(NOISE_SHARE, rare)) * noise**2, usual=_activity(rows, i)[0])

    def flag(self, reading: d.Driver) -> d.Driver:
        fading = c.lag(c.none_of(d.lag(d.ONE, c.AT_ONCE)), FREEZE_S)
        at_start = max(math.sqrt(self.usual * self.still), 2.0 * REVIVED * self.still)
        alive = d.Affine(weights=(-1.0, -at_start), of=(activity(reading), fading))
        return d.Switch(of=alive, on=-self.still, off=-REVIVED * self.still)

    def widened(self, times: float) -> FrozenReading:
        return FrozenReading(still=self.still / times**2, usual=self.usual)

    def not_below(self, other: Rule | None) -> FrozenReading:
        return FrozenReading(still=self.still, usual=other.usual if isinstance(other, FrozenReading) else self.usual)

    @classmethod
    def example(cls, t: np.ndarray, healthy: np.ndarray) -> np.ndarray:
        half = int(np.searchsorted(t, np.median(t)))
        return np.where(np.arange(t.size) < half, healthy, healthy[half])


def _activity(rows: HealthyReadings, i: int) -> tuple[float, np.ndarray]:
    """Mean activity of one sensor, K2, and of each row."""
    alive = activity_of(rows)
    return float(np.mean(alive, axis=0)[i]), alive[:, i]


def _coarse(rows: HealthyReadings, i: int) -> bool:
    """Whether the resolution of a sensor hides its noise: successive readings are often equal."""
    within = rows.run[1:] == rows.run[:-1]
    return bool(within.any()) and float(np.mean((np.diff(rows.x[:, i]) == 0.0)[within])) > MOST_EQUAL
