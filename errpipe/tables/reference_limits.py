"""Limits of the plain-Python evaluator: from deviations to corrections that a machine can follow."""

from __future__ import annotations

from errpipe.domain import table as t
from errpipe.kernels.motion import closing_rate, towards


class Limits:
    """Ramp, magnitude, slew and acceleration of one table's outputs. status: bits of the last cycle."""

    def __init__(self, table: t.CompensationTable):
        self.table = table
        self._rules_of_2 = table.table > 1
        self._ramp = 0.0
        self._correction = [0.0] * len(table.outputs)
        self.reset()

    def reset(self) -> None:
        """The next cycle is the first of a run; corrections and the ramp stay (those of version 1 begin at 0)."""
        outputs = len(self.table.outputs)
        if not self._rules_of_2:
            self._ramp = 0.0
            self._correction = [0.0] * outputs
        self._rate = [0.0] * outputs
        self._target = list(self._correction)
        self.status = 0

    def continue_from(self, before: Limits) -> None:
        """Begin where the outputs of another table stand: its corrections and its ramp."""
        self._correction, self._ramp = list(before._correction), before._ramp
        self._target = list(self._correction)

    def limited(self, deviation: list[float], dt: float, replay: bool, enable: bool, hold: bool) -> list[float]:
        """The corrections of a cycle, each in its own unit."""
        self.status = 0
        if hold:
            self.status |= t.STATUS_BIT["holding"]
        else:
            self._ramp = towards(self._ramp, 1.0 if enable else 0.0, dt, 0.0 if replay else self.table.ramp_s)
        if self._ramp >= 1.0:
            self.status |= t.STATUS_BIT["active"]
        elif self._ramp > 0.0:
            self.status |= t.STATUS_BIT["ramping"]
        out = []
        for n, output in enumerate(self.table.outputs):
            target = -deviation[n] * self._ramp
            if output.magnitude is not None:
                if target > output.magnitude:
                    target = output.magnitude
                    self.status |= t.STATUS_BIT["at_magnitude"]
                if target < -output.magnitude:
                    target = -output.magnitude
                    self.status |= t.STATUS_BIT["at_magnitude"]
            if hold:
                self._rate[n] = 0.0
                self._target[n] = target
            elif replay or (output.slew is None and output.acceleration is None):
                self._correction[n] = target
            else:
                self._approach_target(n, output, target, dt)
            out.append(self._correction[n] * output.factor)
        return out

    def _approach_target(self, n: int, output: t.Output, target: float, dt: float) -> None:
        """Move a correction to its target within slew and acceleration limits, without overshoot.

        Rates are per cycle. Of the rates reachable in this cycle the fastest is taken from which the
        closing speed can still be braked before the target.
        """
        way = target - self._correction[n]
        drift = target - self._target[n]
        self._target[n] = target
        slowest, fastest = -t.LARGEST_RESULT, t.LARGEST_RESULT
        brake = 0.0
        if output.slew is not None:
            fastest = output.slew * dt
            slowest = -fastest
        if output.acceleration is not None:
            brake = output.acceleration * dt * dt
            if self._rate[n] + brake < fastest:
                fastest = self._rate[n] + brake
            if self._rate[n] - brake > slowest:
                slowest = self._rate[n] - brake
        arrives = slowest <= way <= fastest
        if arrives and brake > 0.0:
            landing = way - drift
            arrives = -brake <= landing <= brake
        if arrives:
            self._rate[n] = way
            self._correction[n] = target
            return
        self.status |= t.STATUS_BIT["at_rate"]
        rate = closing_rate(self._rate[n], way, drift, slowest, fastest, brake)
        before = self._correction[n]
        self._rate[n] = rate
        self._correction[n] = before + rate
        if output.magnitude is not None and self._rules_of_2:
            bound = max(output.magnitude, abs(before))  # beyond it where another table left it: comes back at its rate
            bounded = min(max(self._correction[n], -bound), bound)
            if bounded != self._correction[n]:
                self.status |= t.STATUS_BIT["at_magnitude"]
                self._correction[n] = bounded
                self._rate[n] = bounded - before
