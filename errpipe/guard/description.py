"""A sensor guard: which readings to expect from each sensor, and what to use instead of one that fails.

After Ni (1997, Fig. 10), T27 = g(T26, T29): every sensor is estimated from the others. With x the readings and
`start` the first reading of the run (on a controller: since it was switched on),

    r_i = x_i - sum v_ij x_j, less its value at the start     departure from the best estimate, which also
                                                            reads first-order lags of the others
    p_i = x_i - sum w_ij x_j, less its value at the start     departure that tells sensors apart
    slow_i  = lag(p_i, filter) / its threshold                  over minutes, so that noise says nothing;
               its size less 1 per K that the session began outside the starts learnt from
    quick_i = lag(p_i - lag(p_i, horizon), filter) / its threshold     what came in the last hour: smaller faults

    blamed_i = 1 for good once |quick_i| >= 1 + c_ij |quick_j| for every other j; or so for slow
    frozen_i = 1 while lag((x_i - lag(x_i, freeze))^2, freeze) <= still_i: less alive than ever when healthy,
               no sooner than WARM_UP freeze times after the start
    m_i = lag(r_i - e_i, settle) as it was when last all was calm and x_i alive: what the estimate is off by
    swapped_ij = 1 for good once x_i, x_j read what x_j, x_i did when last nothing had jumped, by far better than what
               they did themselves, and are further apart than the difference of healthy ones ever turns round
               within minutes; by no less than a fault must be where a sensor is blamed already
    e_i = how far x_i has moved, over hours, beyond what *both* its witnesses allow (disjoint sets of other sensors):
               the lesser of the two excesses where they agree in sign, else 0; 0 once any sensor is found at fault.
               Only for sensors that have witnesses
    guarded reading = x_i - e_i, less (r_i - m_i + sum v_ij (r_j - m_j) over failed j) while it is blamed or frozen:
               its last trusted reading, carried on as its estimate from what stands in for the others;
               x_j where it is swapped with j

e_i bounds what a fault does before it is found: nobody has to know which sensor lies, because one witness that
lies is outvoted by the reading and the other witness. Half the harm of slow drifts is done before any alarm.

Two sets of weights, because the estimate that follows best cannot tell which of two close sensors failed: their
departures are one and the same. The w give up some closeness, so that a fault of sensor j shows in p_i less than
in p_j. How much less is known, so c_ij = MARGIN x that share keeps i from being blamed for j's fault, and leaves
it free to be blamed for its own beside it (two that are swapped). All of it is built of the operations of
`errpipe.domain.driver`, so it is compiled, exported and evaluated like any driver, causally.

Limits. What is blamed stays out until the next start. A fault that is there at the start and constant does not
show, and does no harm to a model of rises. Empty, impossible and racing readings are caught before, by each
input's own range, rate and hold (`low`, `high`, `max_rate`); a held reading is a frozen one.
"""

from __future__ import annotations

from itertools import combinations
from typing import Literal

from pydantic import Field

from errpipe.domain.recording import Frozen


class Source(Frozen):
    """A sensor's reading, or its first-order lag, that says something about another sensor."""

    name: str
    lag_s: float | None = Field(None, gt=0)


class Witness(Frozen):
    """A few other sensors that tell how one should move: sum of weights x sources."""

    sources: tuple[Source, ...]
    weights: tuple[float, ...]
    within: float = Field(gt=0, description="K; a healthy reading mostly departs less within hours.")


class GuardedSensor(Frozen):
    """One sensor. Units: the sensor's own (degC; differences K), s."""

    name: str
    low: float = Field(description="No healthy reading lies below.")
    high: float = Field(description="No healthy reading lies above.")
    max_rate: float = Field(gt=0, description="No healthy reading changes faster, per s.")
    others: tuple[str, ...] = Field(description="The other sensors.")
    weights: tuple[float, ...] = Field(description="Weights w of the others, which keep faults apart.")
    sources: tuple[Source, ...] = Field(description="What it is best estimated from.")
    estimate: tuple[float, ...] = Field(description="Weights v of the sources.")
    static: tuple[float, ...] = Field(description="Weights of the others where neither lag nor start is known:")
    offset: float = Field(description="reading = offset + sum of static weights x the others' readings.")
    residual: float = Field(ge=0, description="Standard deviation of r on groups that had no part in the weights.")
    quick: float = Field(gt=0, description="Threshold of the quick departure.")
    slow: float = Field(gt=0, description="Threshold of the slow departure.")
    starts: tuple[float, float] = Field(description="Lowest and highest reading at the start of a session.")
    reach: float = Field(gt=0, description="Largest departure r that is remembered; twice what a healthy one had.")
    witnesses: tuple[Witness, ...] = Field((), description="Disjoint sets of others that a reading is held between.")
    lively: float | None = Field(None, description="Of the lagged square; a healthy one seldom is below.")
    still: float | None = Field(None, description="Of the lagged square; None: it stands still when healthy.")


class SensorGuard(Frozen):
    """Format version 1. `false_alarms` is the rate the thresholds were set for, on healthy sensors."""

    sensor_guard: Literal[1] = 1
    sensors: tuple[GuardedSensor, ...]
    filter_s: float = Field(gt=0, description="Time constant of the statistics.")
    horizon_s: float = Field(gt=0, description="Time constant of what the quick statistic forgets.")
    freeze_s: float = Field(gt=0, description="Time constant of the stillness.")
    settle_s: float = Field(gt=0, description="Time constant of what is remembered of a departure.")
    swap_s: float = Field(gt=0, description="Time constant of where a reading was before a swap.")
    corridor_s: float = Field(7200.0, gt=0, description="Time constant of what a witness forgets.")
    turns: tuple[float, ...] = Field(description="K; healthy ones this far apart never turn round; pairs in order.")
    false_alarms: float = Field(description="Expected per 1000 hours, all sensors together.")
    hours: float = Field(description="Hours of healthy readings the thresholds come from.")
    shows_elsewhere: float = Field(description="Largest share of a fault that shows in another sensor's p.")

    def sensor(self, name: str) -> GuardedSensor:
        """The sensor of a name. Raises KeyError."""
        return {s.name: s for s in self.sensors}[name]

    def turn(self, one: str, other: str) -> float:
        """How far the difference of two healthy readings does not turn round, K. Raises KeyError."""
        return dict(zip(combinations(self.names(), 2), self.turns, strict=True))[one, other]

    def names(self) -> tuple[str, ...]:
        """Names of the guarded sensors."""
        return tuple(s.name for s in self.sensors)
