"""A sensor guard: the relations between healthy temperatures, and the response to a failed one.

After Ni (1997, Fig. 10), T27 = g(T26, T29): every sensor is estimated from the others. Method: leave-one-sensor-out
regression with a generalised likelihood ratio test per sensor, as in fault detection by parity relations (Willsky and
Jones 1976; Gertler 1998). With x the readings and C the covariance of u for healthy sensors, P = (C + ridge)^-1,

    u_i = x_i - lag(x_i, horizon)                 change over about the last hour
    s_i = (P u)_i / sqrt(P_ii) / threshold         standardised residual of sensor i given all others: (P u)_i / P_ii is
                                                 its leave-one-out regression residual, s_i^2 its likelihood ratio
    a_i = 1 where s_i^2 >= 1 and is the largest    sensor i explains the readings best. A fault of i alone shows in
                                                 every other s_j by |P_ij| / sqrt(P_ii P_jj) < 1, so it is the largest
    a2_j = the same with the sensor of the largest s excluded: a second failed sensor (two exchanged plugs).
                                                 A frozen sensor is excluded first: its held reading affects every s
    own_i = 1 where a rule of `errpipe.guard.rules` flags the reading by itself: frozen, changed suddenly
    fault_i = 1 from the first a_i or a2_i on, until the next start; or while own_i

Replacement of a failed reading:

    r_i = x_i - sum v_ij x_j, minus its value at the start    residual of the best estimate of changes within a shift
    m_i = lag(r_i, settle) when the largest s^2 was last below QUIET_SHARE and x_i changed
    guarded reading = x_i - f_i,  f_i = r_i - m_i + sum v_ij f_j over failed j: the last trusted reading, continued
               by its estimate from the others. Exact for two failed sensors, approximate for more (frozen)

The correction fades to zero (`trust`) if more than `most_failed` sensors have failed, or if one has whose
replacement is too inaccurate (`errpipe.stages._guarded`). A guard without P (one sensor, one run) replaces nothing: a
sensor that a rule flags fades the correction.

Sensors beyond those that are compared are kept consistent with them. With b = x_k - sum v_kj (guarded reading of j),
minus its value at the start, the reading counts as x_k + clip(b, -within, within) - b: unchanged in conditions like
those of the recording; frozen, lost, jumped or drifting, it is wrong by at most about `within`. No state, no decision.
Where a table has no room for that, those of little influence are held: without a reading they keep the last one.

A sensor without a reading when the run starts: lags and rises of the others count from the start. Its own rise
counts from the reading that it usually has at a start, by those of the others, if that is known much better than the
rise that would be missed (`errpipe.guard.learn`); else, where it can be replaced, from the estimate sum v_ij x_j, minus
its value at the start, at its first reading; else from zero there.

The guard consists of operations of `errpipe.domain.driver`, so it is compiled, exported and evaluated like any
driver, causally. Missing, implausible and too fast readings are rejected before, by each input's own range, rate and
hold (`low`, `high`, `max_rate`); a held reading is a frozen one.

Limits. A constant fault that exists at the start is not detected, and does not affect a model of rises. Drifts slower
than `horizon` are not detected either: the smallest detectable fault per sensor is `smallest`, in K per horizon.
Two sensors that always move together cannot be distinguished: the ridge is raised until no fault appears in another
sensor by more than MAX_CORRELATION of its own size (`errpipe.guard.learn`).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.domain.recording import FrozenModel
from errpipe.guard.rules import AnyRule, Rule


class Start(FrozenModel):
    """The reading that a sensor usually has at a start: sum of weights times those of the others, plus `usual`, K."""

    weights: tuple[float, ...] = Field(description="Of the sensors in the guard's order; 0 for itself.")
    usual: float = Field(description="Usual difference, K.")
    limits: tuple[float, float] = Field(description="Smallest and largest rise soon after a start, K.")


class GuardedSensor(FrozenModel):
    """One sensor. Units: the sensor's own (degC; differences K), s."""

    name: str
    low: float = Field(description="Healthy readings are above it.")
    high: float = Field(description="Healthy readings are below it.")
    max_rate: float = Field(gt=0, description="Fastest change of a healthy reading, per s.")
    precision: tuple[float, ...] = Field((), description="Row of P, 1/K2, sensors in the guard's order; none: no P.")
    estimate: tuple[float, ...] = Field(description="Weights v of the sensors in the guard's order; 0 for itself.")
    smallest: float | None = Field(None, gt=0, description="Smallest fault that reaches the threshold, K.")
    stands_in: bool = Field(True, description="Whether its estimate is accurate enough; else the correction fades.")
    reach: float = Field(gt=0, description="Largest residual r that is latched; twice that of healthy readings.")
    lively: float | None = Field(None, description="Threshold of the lagged square; healthy readings are mostly above.")
    start: Start | None = Field(None, description="Its reading at the start; none: not known well enough.")
    rules: tuple[AnyRule, ...] = Field((), description="Tests of its reading by itself, with their limits.")

    def rule(self, kind: str) -> Rule | None:
        """The rule of a kind; None if it is not applied to this sensor."""
        return next((r for r in self.rules if r.rule == kind), None)


class KeptSensor(FrozenModel):
    """A sensor that is not compared, but kept consistent with those that are. Units: K."""

    name: str
    low: float = Field(description="Healthy readings are above it.")
    high: float = Field(description="Healthy readings are below it.")
    estimate: tuple[float, ...] = Field(description="Weights of the compared sensors in the guard's order.")
    within: float = Field(gt=0, description="Largest difference of its rise from the estimate that counts.")


class SensorGuard(FrozenModel):
    """Format version 6. `false_alarms` is the rate for which the thresholds were set, on healthy sensors."""

    sensor_guard: Literal[6] = 6
    sensors: tuple[GuardedSensor, ...]
    kept: tuple[KeptSensor, ...] = ()
    held: tuple[str, ...] = Field((), description="Neither: a lost one keeps its last reading, and nothing fades.")
    threshold: float = Field(1.0, gt=0, description="Of the standardised residual; reached at the stated rate.")
    horizon_s: float = Field(gt=0, description="Time constant of the test's high-pass filter.")
    settle_s: float = Field(gt=0, description="Time constant of the latched residual.")
    most_failed: int = Field(1, ge=0, description="Largest number of failed sensors; above it the correction fades.")
    false_alarms: float = Field(description="Expected per 1000 hours, all sensors together.")
    hours: float = Field(description="Hours of healthy readings behind the thresholds.")
    correlation: float = Field(0.0, description="Largest share of a fault that appears in another sensor's s.")

    def widened(self, times: float) -> SensorGuard:
        """The guard with thresholds that are `times` as far from healthy readings."""
        wider = tuple(
            s.model_copy(
                update={
                    "smallest": s.smallest and times * s.smallest,
                    "rules": tuple(r.widened(times) for r in s.rules),
                }
            )
            for s in self.sensors
        )
        kept = tuple(s.model_copy(update={"within": times * s.within}) for s in self.kept)
        return self.model_copy(update={"threshold": times * self.threshold, "sensors": wider, "kept": kept})

    @property
    def compares(self) -> bool:
        """Whether sensors are compared with each other, and replace each other."""
        return bool(self.sensors[0].precision)

    def names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.sensors)

    def kept_names(self) -> tuple[str, ...]:
        return tuple(s.name for s in self.kept)
