"""A sensor guard: what healthy temperatures have to do with each other, and what is done when one fails.

After Ni (1997, Fig. 10), T27 = g(T26, T29): every sensor is estimated from the others. Method: leave-one-sensor-out
regression with a generalised likelihood ratio test per sensor, as in fault detection by parity relations (Willsky and
Jones 1976; Gertler 1998). With x the readings and C the covariance of u for healthy sensors, P = (C + ridge)^-1,

    u_i = x_i - lag(x_i, horizon)                 what the last hour brought
    s_i = (P u)_i / sqrt(P_ii) / threshold         standardised residual of sensor i given all others: (P u)_i / P_ii is
                                                 its leave-one-out regression residual, s_i^2 its likelihood ratio
    a_i = 1 where s_i^2 >= 1 and is the largest    sensor i explains the readings best. A fault of i alone shows in
                                                 every other s_j by |P_ij| / sqrt(P_ii P_jj) < 1, so it is the largest
    a2_j = the same with the sensor of the largest s left out: a second one that fails (two whose plugs were swapped).
                                                 A frozen sensor is left out first: its held reading is in every s
    frozen_i = lag((x_i - lag(x_i, freeze))^2, freeze) <= still_i: less alive than it ever was when healthy
    jumped_i = 1 from the first |x_i - lag(x_i, freeze)| >= jump_i on: quicker than it ever was when healthy
    fault_i = 1 from the first a_i, a2_i or jumped_i on, until the next start; or while frozen

What stands in for a failed reading:

    r_i = x_i - sum v_ij x_j, less its value at the start     residual of the best estimate of a shift's changes
    m_i = lag(r_i, settle) as it was when the largest s^2 was last below QUIET_SHARE and x_i moved
    guarded reading = x_i - f_i,  f_i = r_i - m_i + sum v_ij f_j over failed j: the last trusted reading, carried on
               by its estimate from the others. Solved exactly for two failed sensors, approximately for more (frozen)

The correction fades to zero (`trust`) where more than `most_failed` sensors are at fault, and where one is whose
stand-in is of no use (`errpipe.stages._guarded`). A guard without P (one sensor, one run) has no stand-in: a sensor
that freezes or jumps fades it.

All of it is built of the operations of `errpipe.domain.driver`, so it is compiled, exported and evaluated like any
driver, causally. Empty, impossible and racing readings are caught before, by each input's own range, rate and hold
(`low`, `high`, `max_rate`); a held reading is a frozen one.

Limits. A fault that is there at the start and constant does not show, and does no harm to a model of rises. Drifts so
slow that `horizon` forgets them do not show either: the smallest fault per sensor is `smallest`, in K per horizon.
Two sensors that always move together cannot be distinguished: the ridge is raised until no fault shows in another
sensor by more than MAX_CORRELATION of its own size (`errpipe.guard.learn`).
"""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from errpipe.domain.recording import Frozen


class GuardedSensor(Frozen):
    """One sensor. Units: the sensor's own (degC; differences K), s."""

    name: str
    low: float = Field(description="No healthy reading lies below.")
    high: float = Field(description="No healthy reading lies above.")
    max_rate: float = Field(gt=0, description="No healthy reading changes faster, per s.")
    precision: tuple[float, ...] = Field((), description="Row of P, 1/K2, sensors in the guard's order; none: no P.")
    estimate: tuple[float, ...] = Field(description="Weights v of the sensors in the guard's order; 0 for itself.")
    smallest: float | None = Field(None, gt=0, description="Smallest fault that reaches the threshold, K.")
    jump: float = Field(gt=0, description="No healthy reading is further from its lag of `freeze`, K.")
    stands_in: bool = Field(True, description="Whether its estimate is of use; else the correction fades.")
    reach: float = Field(gt=0, description="Largest residual r that is remembered; twice what a healthy one had.")
    lively: float | None = Field(None, description="Of the lagged square; a healthy reading is mostly above.")
    still: float | None = Field(None, description="Of the lagged square; None: it stands still when healthy.")


class SensorGuard(Frozen):
    """Format version 3. `false_alarms` is the rate the thresholds were set for, on healthy sensors."""

    sensor_guard: Literal[3] = 3
    sensors: tuple[GuardedSensor, ...]
    threshold: float = Field(1.0, gt=0, description="Of the standardised residual; reached at the stated rate.")
    horizon_s: float = Field(gt=0, description="Time constant of what the test forgets.")
    freeze_s: float = Field(gt=0, description="Time constant of the stillness.")
    settle_s: float = Field(gt=0, description="Time constant of what is remembered of a residual.")
    most_failed: int = Field(1, ge=0, description="Sensors that may be at fault; with one more the correction fades.")
    false_alarms: float = Field(description="Expected per 1000 hours, all sensors together.")
    hours: float = Field(description="Hours of healthy readings the thresholds come from.")
    correlation: float = Field(0.0, description="Largest share of a fault that shows in another sensor's s.")

    def widened(self, times: float) -> SensorGuard:
        """The guard that accepts residuals and jumps that many times as large, and activity as many times as small."""
        wider = tuple(
            s.model_copy(
                update={
                    "smallest": s.smallest and times * s.smallest,
                    "jump": times * s.jump,
                    "still": s.still and s.still / times**2,
                }
            )
            for s in self.sensors
        )
        return self.model_copy(update={"threshold": times * self.threshold, "sensors": wider})

    @property
    def compares(self) -> bool:
        """Whether sensors are judged by each other, and stand in for each other."""
        return bool(self.sensors[0].precision)

    def names(self) -> tuple[str, ...]:
        """Names of the guarded sensors."""
        return tuple(s.name for s in self.sensors)
