"""Interface of a rule of the sensor guard: limits learnt from healthy readings, and a driver that flags a fault."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import lru_cache
from typing import ClassVar

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import FrozenModel
from errpipe.guard import composed as c
from errpipe.guard.rows import HealthyReadings

FALSE_ALARMS = 0.5  # expected per 1000 hours, all sensors together, or of one that no other replaces
FREEZE_S = 300.0  # heaters and pumps switch every few minutes, so a healthy reading moves within this


class Rule(FrozenModel, ABC):
    """A test of one sensor's reading without the others. The fields of a subclass are its limits, in K and K2."""

    rule: str
    symptom: ClassVar[str]  # continues the sentence `a temperature that ...`
    nodes: ClassVar[int]  # operations that it adds to a table for each sensor

    @classmethod
    @abstractmethod
    def learn(cls, rows: HealthyReadings, i: int, per_hour: float) -> Rule | None:
        """Limits of sensor i that healthy readings pass `per_hour` times an hour; None: the rule does not suit it."""

    @classmethod
    @abstractmethod
    def alone(cls, rows: HealthyReadings, i: int) -> Rule | None:
        """Limits of a sensor that no other replaces: a false alarm costs the whole correction."""

    @abstractmethod
    def flag(self, reading: d.Driver) -> d.Driver:
        """1 while, or from the first time on that, the reading is faulty; else 0."""

    @abstractmethod
    def widened(self, times: float) -> Rule:
        """The rule with a threshold that is `times` as far from healthy readings."""

    def not_below(self, other: Rule | None) -> Rule:
        """The rule with limits at least as wide as those of the same rule with a replacement, if that matters."""
        return self

    @classmethod
    @abstractmethod
    def example(cls, t: np.ndarray, healthy: np.ndarray) -> np.ndarray:
        """Readings, K, that become faulty at half of the time t, s: what the rule must detect."""


@lru_cache(maxsize=64)  # one object a reading, so that a table contains it once
def activity(reading: d.Driver) -> d.Driver:
    """Activity of one reading: the lagged square of its high-pass filtered value, K2."""
    return c.lag(squared_change(reading), FREEZE_S)


@lru_cache(maxsize=64)
def squared_change(reading: d.Driver) -> d.Driver:
    """Square of the change of one reading over the last minutes, K2."""
    return c.squared(d.Affine(weights=(1.0, -1.0), of=(reading, c.lag(reading, FREEZE_S))))


def activity_of(rows: HealthyReadings) -> np.ndarray:
    """`activity` of healthy readings, K2, (rows, sensors)."""
    return rows.lagged((rows.x - rows.lagged(rows.x, FREEZE_S)) ** 2, FREEZE_S)
