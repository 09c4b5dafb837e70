"""A reading that jumps: a loose plug, a broken wire, another sensor connected."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np
from pydantic import Field

from errpipe.domain import driver as d
from errpipe.guard import rates
from errpipe.guard.composed import UNTIL_RESTART
from errpipe.guard.rows import HealthyReadings
from errpipe.guard.rules._base import FREEZE_S, Rule, squared_change

JUMP_MARGIN = 1.5  # factor: an opening door in another season is faster
MIN_JUMP = 1.0  # K: a smaller jump does little harm, and noise of a slowly sampled sensor may look like one
QUICKER = 2.0  # times the largest change in one run: a single run does not bound later ones


class SuddenChange(Rule):
    """1 from the first change that is faster than any healthy one on, until the next start."""

    rule: Literal["sudden_change"] = "sudden_change"
    jump: float = Field(gt=0, description="Largest distance of a healthy reading from its lag of `freeze`, K.")
    symptom: ClassVar[str] = "jumps by several kelvin"
    nodes: ClassVar[int] = 1  # besides those of the activity

    @classmethod
    def learn(cls, rows: HealthyReadings, i: int, per_hour: float) -> SuddenChange:
        return cls(jump=_fastest(rows, i, per_hour))

    @classmethod
    def alone(cls, rows: HealthyReadings, i: int) -> SuddenChange:
        return cls(jump=max(QUICKER * _fastest(rows, i, 0.0), rates.ROLES["temperature"].slowest * FREEZE_S))

    def flag(self, reading: d.Driver) -> d.Driver:
        return d.Switch(of=squared_change(reading), on=self.jump**2, off=UNTIL_RESTART)

    def widened(self, times: float) -> SuddenChange:
        return SuddenChange(jump=times * self.jump)

    def not_below(self, other: Rule | None) -> SuddenChange:
        return SuddenChange(jump=max(self.jump, other.jump if isinstance(other, SuddenChange) else 0.0))

    @classmethod
    def example(cls, t: np.ndarray, healthy: np.ndarray) -> np.ndarray:
        return healthy + 30.0 * (t >= np.median(t))


def _fastest(rows: HealthyReadings, i: int, per_hour: float) -> float:
    """The fastest change of a healthy reading, K, exceeded at the stated rate.

    Of a row's reading minus the lag before it: a controller, which samples faster, may see all of a row's change.
    """
    x, before = rows.x[:, [i]], rows.lagged(rows.x[:, [i]], FREEZE_S)
    first = np.r_[True, rows.run[1:] != rows.run[:-1]]
    quick = np.abs(x - np.where(first[:, None], x, np.roll(before, 1, axis=0)))[:, 0]
    return float(max(JUMP_MARGIN * (rows.rare(quick, per_hour) if per_hour else quick.max()), MIN_JUMP))
