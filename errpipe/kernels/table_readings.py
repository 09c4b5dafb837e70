"""Readings of a table's inputs: acceptance, substitutes for rejected ones, and validity.

`program` and `state` are as in `table_cycle`; the rules are those of the reference evaluator, to the bit.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import bare_kernel
from errpipe.kernels import table_codes as codes


@bare_kernel
def follows(channel, own, v, fresh, unwatched, thermal_s):
    """Whether a reading lies where its rate and noise let it be; the anchor follows it at that rate."""
    if unwatched and not own.seen:
        own.anchor = v
        return True
    reach = channel.max_rate * own.age
    moved = v - own.anchor
    if moved > reach + channel.noise or -moved > reach + channel.noise:
        if not own.seen:
            own.anchor = v
            own.age = 0.0
        elif fresh:
            own.rejected = (own.rejected + 1) & 0xFFFFFFFF
        return False
    if not own.seen and own.age < 0.5 * thermal_s:
        return False
    own.anchor = own.anchor + reach if moved > reach else own.anchor - reach if -moved > reach else v
    return True


@bare_kernel
def condition(inputs, substitutes, state, readings, fresh, dt, unwatched, thermal_s):
    """Accept or reject all readings, then substitute the rejected ones.

    unwatched: the first reading of a run is accepted at once. Returns the status bits, bit 31 set where an input that
    matters is down to its default.
    """
    doubtful = 0
    for i in range(inputs.size):
        channel = inputs[i]
        own = state[i]
        own.age = own.age + dt
        own.wait = own.wait + dt
        if fresh[i]:
            own.raw = readings[i]
            own.wait = 0.0
        v = own.raw
        fault = 0
        if not (v >= -codes.LARGEST and v <= codes.LARGEST):
            fault = 1
        elif channel.flags & codes.HAS_STALE and own.wait > channel.stale:
            fault = 2
        elif v < channel.low or v > channel.high:
            fault = 3
        elif channel.flags & codes.HAS_MAX_RATE and not follows(channel, own, v, fresh[i], unwatched, thermal_s):
            fault = 4
        own.fault = fault
        own.source = 0
        if fault == 0:
            own.good = own.now = v
            own.age = 0.0
            own.seen = own.usable = 1
        else:
            doubtful += 1
    return substitute(inputs, substitutes, state) if doubtful else 0


@bare_kernel
def show(inputs, state, every, clamped):
    """Inputs clipped to validity (without `every`, only fast ones), and the share of the table that applies."""
    for i in range(inputs.size):
        channel = inputs[i]
        own = state[i]
        if channel.kind >= codes.SLOW_KINDS and not every:
            continue
        v = own.now
        own.left = 1.0
        if channel.flags & codes.HAS_VALID:
            outside = channel.valid_low - v if v < channel.valid_low else v - channel.valid_high
            if outside > 0.0:
                own.left = 1.0 - outside / channel.margin
                if clamped:
                    v = channel.valid_low if v < channel.valid_low else channel.valid_high
        own.value = v


@bare_kernel
def substitute(inputs, substitutes, state):
    """What replaces the readings that are rejected; status bits as in `condition`."""
    status = 0
    for i in range(inputs.size):
        channel = inputs[i]
        own = state[i]
        if own.fault == 0:
            continue
        own.source = 3
        if channel.flags & codes.OPTIONAL:
            own.now = channel.default
            continue
        begin = np.int64(channel.first)
        whole = channel.count > 0
        for s in range(begin, begin + channel.count):
            if state[substitutes[s].number].fault != 0:
                whole = False
        if whole:
            v = channel.substitute_offset
            for s in range(begin, begin + channel.count):
                v = v + substitutes[s].weight * state[substitutes[s].number].good
            if v < channel.low:
                v = channel.low
            if v > channel.high:
                v = channel.high
            own.now = v
            own.usable = 1
            own.source = 1
            status |= codes.SUBSTITUTED
        elif own.seen and (not channel.flags & codes.HAS_HOLD or own.age < channel.hold):
            own.now = own.good
            own.source = 2
            status |= codes.HELD
        else:
            own.now = channel.default
            status |= codes.DEFAULTED
            if channel.flags & codes.FADE_ON_DEFAULT:
                status |= codes.LOST
    return status
