"""Corrections of a table within magnitude, slew and acceleration, to the bit as in the reference evaluator."""

from __future__ import annotations

from errpipe.kernels import bare_kernel
from errpipe.kernels.elementary import closing_rate
from errpipe.kernels.table_codes import AT_MAGNITUDE, AT_RATE, HAS_ACCELERATION, HAS_MAGNITUDE, HAS_SLEW, LARGEST


@bare_kernel
def approach_target(output, own, target, dt):
    """Move a correction to its target within slew and acceleration; True where they held it back."""
    way = target - own.limited
    drift = target - own.target
    own.target = target
    slowest, fastest = -LARGEST, LARGEST
    brake = 0.0
    if output.flags & HAS_SLEW:
        fastest = output.slew * dt
        slowest = -fastest
    if output.flags & HAS_ACCELERATION:
        brake = output.acceleration * dt * dt
        if own.rate + brake < fastest:
            fastest = own.rate + brake
        if own.rate - brake > slowest:
            slowest = own.rate - brake
    arrives = slowest <= way and way <= fastest
    if arrives and brake > 0.0:
        landing = way - drift
        arrives = -brake <= landing and landing <= brake
    if arrives:
        own.rate = way
        own.limited = target
        return False
    rate = closing_rate(own.rate, way, drift, slowest, fastest, brake)
    own.rate = rate
    own.limited = own.limited + rate
    return True


@bare_kernel
def bound(magnitude, own, before):
    """Keep a correction within its magnitude, or within what another table left; True where it would have gone on."""
    most = max(magnitude, abs(before))
    if own.limited > most:
        own.limited = most
    elif own.limited < -most:
        own.limited = -most
    else:
        return False
    own.rate = own.limited - before
    return True


@bare_kernel
def limit(outputs, state, ramp, dt, replay, hold, bounds_last):
    """Corrections from deviations: magnitude, slew and acceleration; returns status bits."""
    status = 0
    for o in range(outputs.size):
        output = outputs[o]
        own = state[o]
        target = -own.deviation * ramp
        if output.flags & HAS_MAGNITUDE:
            if target > output.magnitude:
                target = output.magnitude
                status |= AT_MAGNITUDE
            if target < -output.magnitude:
                target = -output.magnitude
                status |= AT_MAGNITUDE
        if hold:
            own.rate = 0.0
            own.target = target
        elif replay or not output.flags & (HAS_SLEW | HAS_ACCELERATION):
            own.limited = target
        else:
            before = own.limited
            if approach_target(output, own, target, dt):
                status |= AT_RATE
                if bounds_last and output.flags & HAS_MAGNITUDE and bound(output.magnitude, own, before):
                    status |= AT_MAGNITUDE
        own.correction = own.limited * output.factor
    return status
