"""One cycle of a compensation table, and the replay of a recording, on plain arrays.

The operations and their order are those of the reference evaluator (`errpipe/tables/reference.py`), to the bit.
Nothing is allocated in a cycle. `Program` and `State` are made by `errpipe/tables/pack.py`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import kernel

CONSTANT, INPUT, AFFINE, FIRST, LAG, PRODUCT, POWER, CLIP, SWITCH, DIRECTION, APPROACH, LOOKUP = range(1, 13)
OPTIONAL, FADE_ON_DEFAULT, HAS_VALID, HAS_MAX_RATE, HAS_STALE, HAS_HOLD = 1, 2, 4, 8, 16, 32
HAS_MAGNITUDE, HAS_SLEW, HAS_ACCELERATION = 1, 2, 4
RUNNING, ACTIVE, RAMPING, SUBSTITUTED, HELD, DEFAULTED, FADING, FADED = 1, 2, 4, 8, 16, 32, 64, 128
AT_MAGNITUDE, AT_RATE, BEYOND_PROFILE, WAITING, NOT_FINITE = 256, 512, 1024, 2048, 4096
LARGEST = 1e30

LOG2_E = 1.4426950408889634
LN2_HIGH = 0.6931471803691238
LN2_LOW = 1.9082149292705877e-10
SQRT2 = 1.4142135623730951
EXP = np.array([
    1.6059043836821613e-10, 2.08767569878681e-09, 2.505210838544172e-08, 2.755731922398589e-07,
    2.7557319223985893e-06, 2.48015873015873e-05, 0.0001984126984126984, 0.001388888888888889,
    0.008333333333333333, 0.041666666666666664, 0.16666666666666666, 0.5, 1.0, 1.0,
])  # fmt: skip
LN = np.array([
    0.047619047619047616, 0.05263157894736842, 0.058823529411764705, 0.06666666666666667, 0.07692307692307693,
    0.09090909090909091, 0.1111111111111111, 0.14285714285714285, 0.2, 0.3333333333333333, 1.0,
])  # fmt: skip


class Program(NamedTuple):
    """A table as arrays. Numbers in *_first arrays have one more entry: the end of the last."""

    slow_every: int
    cycle_s: float
    ramp_s: float
    fade_s: float
    in_flags: np.ndarray  # (inputs,)
    in_real: np.ndarray  # (inputs, 10): low high max_rate stale hold default offset valid_low valid_high margin
    sub_first: np.ndarray  # (inputs + 1,)
    sub_input: np.ndarray
    sub_weight: np.ndarray
    op: np.ndarray  # (nodes,)
    slow: np.ndarray
    other: np.ndarray  # input number, or 1 for a lag that starts at zero, or first lookup value
    others: np.ndarray  # count of lookup values
    par: np.ndarray  # (nodes, 4)
    of_first: np.ndarray  # (nodes + 1,)
    of: np.ndarray
    weight: np.ndarray
    reals: np.ndarray
    fast: np.ndarray  # numbers of the nodes that are not slow
    p_input: np.ndarray  # (profiles,), -1: constant
    p_periodic: np.ndarray
    p_first: np.ndarray
    p_last: np.ndarray
    p_real: np.ndarray  # (profiles, 4): start, 1 / step, scale, 1 / intervals
    values: np.ndarray  # int32
    pair: np.ndarray  # (pairs, 4): component, profile, node, keep
    o_flags: np.ndarray  # (outputs,)
    o_real: np.ndarray  # (outputs, 4): factor, magnitude, slew, acceleration
    term_first: np.ndarray  # (outputs + 1,)
    term: np.ndarray  # (terms, 6): component, count, four nodes
    term_weight: np.ndarray


class State(NamedTuple):
    """Everything that lasts from one cycle to the next, and the results of the last one."""

    raw: np.ndarray
    wait: np.ndarray
    good: np.ndarray
    age: np.ndarray
    seen: np.ndarray
    usable: np.ndarray
    value: np.ndarray
    fault: np.ndarray
    source: np.ndarray
    node: np.ndarray
    a: np.ndarray
    ready: np.ndarray
    profile: np.ndarray
    component: np.ndarray
    deviation: np.ndarray
    correction: np.ndarray  # in correction_unit
    limited: np.ndarray  # in the deviation's unit
    rate: np.ndarray
    target: np.ndarray
    real: np.ndarray  # fade, ramp
    count: np.ndarray  # until_slow, heartbeat, status, nodes that are not ready


@kernel
def exp(y):
    """e**y from + - * alone; 0 below -700, e**700 above 700."""
    if y < -700.0:
        return 0.0
    if y > 700.0:
        y = 700.0
    n = int(y * LOG2_E + 0.5) if y >= 0.0 else int(y * LOG2_E - 0.5)
    r = (y - n * LN2_HIGH) - n * LN2_LOW
    p = EXP[0]
    for i in range(1, 14):
        p = p * r + EXP[i]
    w = 2.0 if n >= 0 else 0.5
    m = n if n >= 0 else -n
    while m > 0:
        if m & 1:
            p = p * w
        w = w * w
        m = m >> 1
    return p


@kernel
def ln(a):
    """Natural logarithm of a >= 1e-30."""
    k = 0
    e = 512
    while e > 0:
        w = two_to(e)
        if a >= w:
            a = a / w
            k = k + e
        e = e >> 1
    if a < 1.0:
        e = 512
        while e > 0:
            w = two_to(e)
            if a * w < 2.0:
                a = a * w
                k = k - e
            e = e >> 1
    if a > SQRT2:
        a = a * 0.5
        k = k + 1
    s = (a - 1.0) / (a + 1.0)
    z = s * s
    p = LN[0]
    for i in range(1, 11):
        p = p * z + LN[i]
    return k * LN2_HIGH + (2.0 * s * p + k * LN2_LOW)


@kernel
def two_to(e):
    """2**e for e a power of two up to 512."""
    w = 2.0
    while e > 1:
        w = w * w
        e = e >> 1
    return w


@kernel
def power(u, exponent):
    """sign(u) * |u|**exponent; 0 where |u| < 1e-30."""
    a = -u if u < 0.0 else u
    if a < 1e-30:
        return 0.0
    if exponent == 1.0:
        p = a
    elif exponent == 2.0:
        p = a * a
    elif exponent == 3.0:
        p = a * a * a
    else:
        p = exp(exponent * ln(a))
    return -p if u < 0.0 else p


@kernel
def towards(value, target, dt, whole):
    """From value to target by at most dt / whole; at once where whole is 0."""
    if whole <= 0.0:
        return target
    step = dt / whole
    if target > value + step:
        return value + step
    if target < value - step:
        return value - step
    return target


@kernel
def reset(program, state):
    """The next cycle is the first of a run."""
    state.raw[:] = np.nan
    state.wait[:] = 0.0
    state.good[:] = 0.0
    state.age[:] = 0.0
    state.seen[:] = 0
    for i in range(state.usable.size):
        state.usable[i] = 1 if program.in_flags[i] & OPTIONAL else 0
    state.value[:] = 0.0
    state.node[:] = 0.0
    state.a[:] = 0.0
    state.ready[:] = 0
    state.limited[:] = 0.0
    state.rate[:] = 0.0
    state.target[:] = 0.0
    state.real[0] = -1.0
    state.real[1] = 0.0
    state.count[0] = 0
    state.count[1] = 0
    state.count[2] = 0
    state.count[3] = program.op.size


@kernel
def judge(program, state, i, fresh, reading, dt):
    """Fault code of one input: 0 believed, 1 missing, 2 stale, 3 out of range, 4 too fast."""
    flags = program.in_flags[i]
    real = program.in_real[i]
    state.age[i] = state.age[i] + dt
    state.wait[i] = state.wait[i] + dt
    if fresh:
        state.raw[i] = reading
        state.wait[i] = 0.0
    v = state.raw[i]
    if not (v >= -LARGEST and v <= LARGEST):
        return 1
    if flags & HAS_STALE and state.wait[i] > real[3]:
        return 2
    if v < real[0] or v > real[1]:
        return 3
    if flags & HAS_MAX_RATE and state.seen[i]:
        moved = v - state.good[i]
        if moved < 0.0:
            moved = -moved
        if moved > real[2] * state.age[i]:
            return 4
    state.good[i] = v
    state.value[i] = v
    state.age[i] = 0.0
    state.seen[i] = 1
    state.usable[i] = 1
    return 0


@kernel
def stand_in(program, state, i):
    """What replaces a reading that is not believed: 1 substitute, 2 held, 3 default."""
    flags = program.in_flags[i]
    real = program.in_real[i]
    if flags & OPTIONAL:
        state.value[i] = real[5]
        return 3
    first, end = program.sub_first[i], program.sub_first[i + 1]
    whole = end > first
    for s in range(first, end):
        if state.fault[program.sub_input[s]] != 0:
            whole = False
    if whole:
        v = real[6]
        for s in range(first, end):
            v = v + program.sub_weight[s] * state.good[program.sub_input[s]]
        if v < real[0]:
            v = real[0]
        if v > real[1]:
            v = real[1]
        state.value[i] = v
        state.usable[i] = 1
        return 1
    if state.seen[i] and (not flags & HAS_HOLD or state.age[i] <= real[4]):
        state.value[i] = state.good[i]
        return 2
    state.value[i] = real[5]
    return 3


@kernel
def condition(program, state, readings, fresh, dt):
    """Condition all inputs; returns whether one that matters is down to its default."""
    for i in range(state.value.size):
        state.fault[i] = judge(program, state, i, fresh[i] != 0, readings[i], dt)
    lost = False
    for i in range(state.value.size):
        state.source[i] = 0
        if state.fault[i] != 0:
            source = stand_in(program, state, i)
            state.source[i] = source
            if not program.in_flags[i] & OPTIONAL:
                state.count[2] |= SUBSTITUTED if source == 1 else HELD if source == 2 else DEFAULTED
                if source == 3 and program.in_flags[i] & FADE_ON_DEFAULT:
                    lost = True
    return lost


@kernel
def direction(program, state, n, started):
    """Side an axis was last moved from."""
    first = program.of_first[n]
    x = state.node[program.of[first]]
    known = 0.0
    if program.of_first[n + 1] - first > 1:
        known = state.node[program.of[first + 1]]
    side = state.node[n]
    if not started:
        side = program.par[n, 1]
        state.a[n] = x
    if known > 0.0:
        side = 1.0
        state.a[n] = x
    elif known < 0.0:
        side = -1.0
        state.a[n] = x
    elif side > 0.0:
        if x >= state.a[n]:
            state.a[n] = x
        elif state.a[n] - x > program.par[n, 0]:
            side = -1.0
            state.a[n] = x
    elif x <= state.a[n]:
        state.a[n] = x
    elif x - state.a[n] > program.par[n, 0]:
        side = 1.0
        state.a[n] = x
    return side


@kernel
def lag(program, state, n, u, started, dt, replay):
    """First-order lag, exact for an operand held over the cycle."""
    before, y = state.a[n], state.node[n]
    state.a[n] = u
    if not started:
        return 0.0 if program.other[n] == 1 else u
    if replay:
        alpha = exp(-(dt / (program.par[n, 0] if before >= y else program.par[n, 1])))
    else:
        alpha = program.par[n, 2] if before >= y else program.par[n, 3]
    return before + (y - before) * alpha


@kernel
def approach(program, state, n, x, side, started):
    """Exponential approach to the side over travelled length."""
    way = x - state.a[n]
    state.a[n] = x
    if not started:
        return side
    if way < 0.0:
        way = -way
    z = state.node[n]
    return side - (side - z) * exp(-(way / program.par[n, 0])) if way > 0.0 else z


@kernel
def lookup(program, n, u):
    """Straight lines between uniform values, held at the ends."""
    first, last = program.other[n], program.others[n] - 1
    s = (u - program.par[n, 0]) * program.par[n, 2]
    if s < 0.0:
        s = 0.0
    if s > last:
        s = float(last)
    j = int(s)
    if j > last - 1:
        j = last - 1
    f = s - j
    left = program.reals[first + j]
    return left + f * (program.reals[first + j + 1] - left)


@kernel
def node_value(program, state, n, started, dt, replay):
    """Value of one node."""
    op = program.op[n]
    first, end = program.of_first[n], program.of_first[n + 1]
    if op == INPUT:
        return state.value[program.other[n]]
    if op == CONSTANT:
        return program.par[n, 0]
    if op == AFFINE:
        total = program.par[n, 0]
        for k in range(first, end):
            total = total + program.weight[k] * state.node[program.of[k]]
        return total
    u = state.node[program.of[first]]
    if op == PRODUCT:
        for k in range(first + 1, end):
            u = u * state.node[program.of[k]]
        return u
    if op == FIRST:
        return state.node[n] if started else u
    if op == LAG:
        return lag(program, state, n, u, started, dt, replay)
    if op == POWER:
        return power(u, program.par[n, 0])
    if op == CLIP:
        low, high = program.par[n, 0], program.par[n, 1]
        return low if u < low else high if u > high else u
    if op == SWITCH:
        return 1.0 if u >= program.par[n, 0] else 0.0 if u <= program.par[n, 1] else state.node[n]
    if op == DIRECTION:
        return direction(program, state, n, started)
    if op == APPROACH:
        return approach(program, state, n, u, state.node[program.of[first + 1]], started)
    return lookup(program, n, u)


@kernel
def run_node(program, state, n, dt, replay):
    """Run one node; what is not finite counts as 0."""
    started = state.ready[n] != 0
    if not started:
        ready = True
        if program.op[n] == INPUT:
            ready = state.usable[program.other[n]] != 0
        for k in range(program.of_first[n], program.of_first[n + 1]):
            if state.ready[program.of[k]] == 0:
                ready = False
        if ready:
            state.ready[n] = 1
            state.count[3] -= 1
    value = node_value(program, state, n, started, dt, replay)
    if not (value >= -LARGEST and value <= LARGEST):
        value = 0.0
        state.count[2] |= NOT_FINITE
    state.node[n] = value


@kernel
def run_nodes(program, state, slow, dt, replay):
    """Run the nodes of this cycle in order."""
    if slow:
        for n in range(program.op.size):
            run_node(program, state, n, dt, replay)
    else:
        for k in range(program.fast.size):
            run_node(program, state, program.fast[k], dt, replay)
    if state.count[3] > 0:
        state.count[2] |= WAITING


@kernel
def fade_target(program, state, lost):
    """1 inside the validity box, falling to 0 over the margin outside it."""
    if lost:
        return 0.0
    target = 1.0
    for i in range(state.value.size):
        if program.in_flags[i] & HAS_VALID:
            v = state.value[i]
            low, high = program.in_real[i, 7], program.in_real[i, 8]
            outside = low - v if v < low else v - high
            if outside > 0.0:
                left = 1.0 - outside / program.in_real[i, 9]
                if left < target:
                    target = left
    return target if target > 0.0 else 0.0


@kernel
def run_profiles(program, state):
    """Values of all profiles."""
    for p in range(program.p_input.size):
        first, last = program.p_first[p], program.p_last[p]
        if program.p_input[p] < 0:
            state.profile[p] = program.values[first] * program.p_real[p, 2]
            continue
        s = (state.value[program.p_input[p]] - program.p_real[p, 0]) * program.p_real[p, 1]
        if program.p_periodic[p]:
            turns = s * program.p_real[p, 3]
            whole = int(turns)
            if turns < whole:
                whole -= 1
            s = s - float(whole) * last
        elif s < 0.0 or s > last:
            state.count[2] |= BEYOND_PROFILE
        if s < 0.0:
            s = 0.0
        if s > last:
            s = float(last)
        j = int(s)
        if j > last - 1:
            j = last - 1
        f = s - j
        left, right = program.values[first + j], program.values[first + j + 1]
        state.profile[p] = (left + f * (right - left)) * program.p_real[p, 2]


@kernel
def synthesis(program, state):
    """Components from pairs, outputs from components."""
    state.component[:] = 0.0
    for k in range(program.pair.shape[0]):
        part = state.profile[program.pair[k, 1]] * state.node[program.pair[k, 2]]
        if program.pair[k, 3] == 0:
            part = part * state.real[0]
        state.component[program.pair[k, 0]] += part
    for o in range(state.deviation.size):
        total = 0.0
        for k in range(program.term_first[o], program.term_first[o + 1]):
            part = program.term_weight[k] * state.component[program.term[k, 0]]
            for f in range(program.term[k, 1]):
                part = part * state.node[program.term[k, 2 + f]]
            total = total + part
        if not (total >= -LARGEST and total <= LARGEST):
            total = 0.0
            state.count[2] |= NOT_FINITE
        state.deviation[o] = total


@kernel
def can_stop(closing, left, brake):
    """Whether a closing speed can be braked within what is left of the way (per cycle)."""
    if closing <= 0.0:
        return True
    return closing * closing + closing * brake <= 2.0 * brake * left


@kernel
def closing_rate(keep, way, drift, slowest, fastest, brake):
    """Of full towards, keep, full away: the fastest that can still be braked before the target."""
    if keep > fastest:
        keep = fastest
    if keep < slowest:
        keep = slowest
    if way > 0.0:
        forward, away, sign = fastest, slowest, 1.0
    else:
        forward, away, sign = slowest, fastest, -1.0
    if brake <= 0.0:
        return forward
    if can_stop(sign * (forward - drift), sign * (way - forward), brake):
        return forward
    if can_stop(sign * (keep - drift), sign * (way - keep), brake):
        return keep
    return away


@kernel
def approach_target(program, state, o, target, dt):
    """Move a correction to its target within slew and acceleration."""
    way = target - state.limited[o]
    drift = target - state.target[o]
    state.target[o] = target
    slowest, fastest = -LARGEST, LARGEST
    brake = 0.0
    if program.o_flags[o] & HAS_SLEW:
        fastest = program.o_real[o, 2] * dt
        slowest = -fastest
    if program.o_flags[o] & HAS_ACCELERATION:
        brake = program.o_real[o, 3] * dt * dt
        if state.rate[o] + brake < fastest:
            fastest = state.rate[o] + brake
        if state.rate[o] - brake > slowest:
            slowest = state.rate[o] - brake
    arrives = slowest <= way and way <= fastest
    if arrives and brake > 0.0:
        landing = way - drift
        arrives = -brake <= landing and landing <= brake
    if arrives:
        state.rate[o] = way
        state.limited[o] = target
        return
    state.count[2] |= AT_RATE
    rate = closing_rate(state.rate[o], way, drift, slowest, fastest, brake)
    state.rate[o] = rate
    state.limited[o] = state.limited[o] + rate


@kernel
def limit(program, state, dt, replay, enable):
    """Corrections from deviations: ramp, magnitude, slew and acceleration."""
    state.real[1] = towards(state.real[1], 1.0 if enable else 0.0, dt, 0.0 if replay else program.ramp_s)
    ramp = state.real[1]
    if ramp >= 1.0:
        state.count[2] |= ACTIVE
    elif ramp > 0.0:
        state.count[2] |= RAMPING
    for o in range(state.deviation.size):
        target = -state.deviation[o] * ramp
        if program.o_flags[o] & HAS_MAGNITUDE:
            if target > program.o_real[o, 1]:
                target = program.o_real[o, 1]
                state.count[2] |= AT_MAGNITUDE
            if target < -program.o_real[o, 1]:
                target = -program.o_real[o, 1]
                state.count[2] |= AT_MAGNITUDE
        if replay or not program.o_flags[o] & (HAS_SLEW | HAS_ACCELERATION):
            state.limited[o] = target
        else:
            approach_target(program, state, o, target, dt)
        state.correction[o] = state.limited[o] * program.o_real[o, 0]


@kernel
def cycle(program, state, readings, fresh, dt, replay, enable):
    """One cycle. fresh: non-zero where readings holds a new one; dt in s (of the row before, when replaying)."""
    state.count[2] = RUNNING
    slow = replay or state.count[0] == 0
    state.count[0] = (program.slow_every if slow else state.count[0]) - 1
    lost = condition(program, state, readings, fresh, dt)
    run_nodes(program, state, slow, dt, replay)
    target = fade_target(program, state, lost)
    whole = 0.0 if replay or state.real[0] < 0.0 else program.fade_s
    state.real[0] = towards(state.real[0], target, dt, whole)
    if state.real[0] < 1.0:
        state.count[2] |= FADING
    if state.real[0] <= 0.0:
        state.count[2] |= FADED
    run_profiles(program, state)
    synthesis(program, state)
    limit(program, state, dt, replay, enable)
    state.count[1] = (state.count[1] + 1) & 0xFFFFFFFF


@kernel
def replay(program, state, columns, fresh, t, run, deviation, correction, status):
    """Replay a recording: columns (rows, inputs), t in s, run: an integer per row; states start anew where it changes.

    Fills deviation and correction (rows, outputs) and status (rows,). Time that stands still or runs back
    within a run counts as no time.
    """
    for k in range(columns.shape[0]):
        dt = 0.0
        if k == 0 or run[k] != run[k - 1]:
            reset(program, state)
        elif t[k] > t[k - 1]:
            dt = t[k] - t[k - 1]
        cycle(program, state, columns[k], fresh, dt, True, True)
        deviation[k] = state.deviation
        correction[k] = state.correction
        status[k] = state.count[2]


@kernel
def stream(program, state, columns, fresh, enable, deviation, correction, status):
    """Many cycles at the controller's rate: columns and fresh (cycles, inputs), enable (cycles,)."""
    for k in range(columns.shape[0]):
        cycle(program, state, columns[k], fresh[k], program.cycle_s, False, enable[k] != 0)
        deviation[k] = state.deviation
        correction[k] = state.correction
        status[k] = state.count[2]
