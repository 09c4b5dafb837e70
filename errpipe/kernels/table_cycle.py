"""One cycle of a compensation table, and the replay of a recording, on plain arrays.

The operations and their order are those of the reference evaluator (`errpipe/tables/reference.py`), to the bit.
Nothing is allocated in a cycle. `program` is the sections of an `.ect` file as record arrays, as they lie in the
file, `state` what lasts from cycle to cycle: `errpipe/tables/pack.py` declares their records and makes both. Loops
stand in few functions with few arguments: what is called per node takes numbers, not arrays, else the calls cost more
than the arithmetic. One file because a kernel may call only kernels of its own file: this is all of one cycle.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import kernel

CONSTANT, INPUT, AFFINE, FIRST, LAG, PRODUCT, POWER, CLIP, SWITCH, DIRECTION, APPROACH, LOOKUP = range(1, 13)
OPTIONAL, FADE_ON_DEFAULT, HAS_VALID, HAS_MAX_RATE, HAS_STALE, HAS_HOLD = 1, 2, 4, 8, 16, 32
SLOW, START_ZERO = 1, 2
HAS_MAGNITUDE, HAS_SLEW, HAS_ACCELERATION = 1, 2, 4
RUNNING, ACTIVE, RAMPING, SUBSTITUTED, HELD, DEFAULTED, FADING, FADED = 1, 2, 4, 8, 16, 32, 64, 128
AT_MAGNITUDE, AT_RATE, BEYOND_PROFILE, WAITING, NOT_FINITE, HOLDING = 256, 512, 1024, 2048, 4096, 8192
LOST = 1 << 31  # internal: an input that matters is down to its default
PERIODIC = KEEP = 1
SLOW_KINDS = 4  # kinds of inputs from here on are shown in thermal cycles
OFF, ON, HOLD = 0, 1, 2  # modes of a cycle
LARGEST = 1e30
NOWHERE = 1e31  # where an anchor stands before the first reading

LOG2_E = 1.4426950408889634
LN2_HIGH = 0.6931471803691238
LN2_LOW = 1.9082149292705877e-10
SQRT2 = 1.4142135623730951
EXP = np.array(
    [
        1.6059043836821613e-10,
        2.08767569878681e-09,
        2.505210838544172e-08,
        2.755731922398589e-07,
        2.7557319223985893e-06,
        2.48015873015873e-05,
        0.0001984126984126984,
        0.001388888888888889,
        0.008333333333333333,
        0.041666666666666664,
        0.16666666666666666,
        0.5,
        1.0,
        1.0,
    ]
)
LN = np.array(
    [
        0.047619047619047616,
        0.05263157894736842,
        0.058823529411764705,
        0.06666666666666667,
        0.07692307692307693,
        0.09090909090909091,
        0.1111111111111111,
        0.14285714285714285,
        0.2,
        0.3333333333333333,
        1.0,
    ]
)


# Both stay in this file under these names: caches that Numba wrote on users' disks name them.


class Program(NamedTuple):
    """A table: cycles and times, and its sections as record arrays."""

    rules: int  # format version by whose rules it runs
    slow_every: int
    cycle_s: float
    thermal_s: float
    ramp_s: float
    fade_s: float
    inputs: np.ndarray
    substitutes: np.ndarray
    nodes: np.ndarray
    operands: np.ndarray
    lookups: np.ndarray
    profiles: np.ndarray
    values: np.ndarray
    pairs: np.ndarray
    outputs: np.ndarray
    terms: np.ndarray
    every: np.ndarray  # numbers of all nodes
    fast: np.ndarray  # numbers of the nodes that are not slow
    same_grid: np.ndarray  # 1 where a profile lies on the grid of the one before it


class State(NamedTuple):
    """Everything that lasts from one cycle to the next, and the results of the last one."""

    inputs: np.ndarray
    nodes: np.ndarray
    profiles: np.ndarray
    components: np.ndarray
    outputs: np.ndarray
    common: np.ndarray  # one record


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
    """The next cycle is the first of a run; corrections stay where they are, and go on from there."""
    for i in range(state.inputs.size):
        own = state.inputs[i]
        own.raw = np.nan
        own.anchor = NOWHERE
        own.left = 1.0
        own.wait = own.good = own.age = own.now = own.value = 0.0
        own.seen = own.fault = own.source = own.rejected = 0
        own.usable = 1 if program.inputs[i].flags & OPTIONAL else 0
    for n in range(state.nodes.size):
        own = state.nodes[n]
        own.value = own.memory = 0.0
        own.ready = 0
    for o in range(state.outputs.size):
        own = state.outputs[o]
        if program.rules == 1:
            own.limited = 0.0
        own.deviation = own.rate = 0.0
        own.target = own.limited
        own.correction = own.limited * program.outputs[o].factor
    own = state.common[0]
    own.fade = -1.0
    if program.rules == 1:
        own.ramp = 0.0
    own.until_slow = own.heartbeat = own.status = 0
    own.unready = state.nodes.size


@kernel
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


@kernel
def condition(inputs, substitutes, state, readings, fresh, dt, unwatched, thermal_s):
    """Judge all readings, then let something stand in for those not believed.

    unwatched: the first reading of a run is believed at once. Returns the status bits, bit 31 set where an input that
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
        if not (v >= -LARGEST and v <= LARGEST):
            fault = 1
        elif channel.flags & HAS_STALE and own.wait > channel.stale:
            fault = 2
        elif v < channel.low or v > channel.high:
            fault = 3
        elif channel.flags & HAS_MAX_RATE and not follows(channel, own, v, fresh[i], unwatched, thermal_s):
            fault = 4
        own.fault = fault
        own.source = 0
        if fault == 0:
            own.good = own.now = v
            own.age = 0.0
            own.seen = own.usable = 1
        else:
            doubtful += 1
    return stand_in(inputs, substitutes, state) if doubtful else 0


@kernel
def show(inputs, state, every, clamped):
    """What the table sees of the inputs (without `every`, only of the fast ones), and what validity leaves of it."""
    for i in range(inputs.size):
        channel = inputs[i]
        own = state[i]
        if channel.kind >= SLOW_KINDS and not every:
            continue
        v = own.now
        own.left = 1.0
        if channel.flags & HAS_VALID:
            outside = channel.valid_low - v if v < channel.valid_low else v - channel.valid_high
            if outside > 0.0:
                own.left = 1.0 - outside / channel.margin
                if clamped:
                    v = channel.valid_low if v < channel.valid_low else channel.valid_high
        own.value = v


@kernel
def stand_in(inputs, substitutes, state):
    """What replaces the readings that are not believed; status bits as in `condition`."""
    status = 0
    for i in range(inputs.size):
        channel = inputs[i]
        own = state[i]
        if own.fault == 0:
            continue
        own.source = 3
        if channel.flags & OPTIONAL:
            own.now = channel.default
            continue
        begin = np.int64(channel.first)
        whole = channel.count > 0
        for s in range(begin, begin + channel.count):
            if state[substitutes[s].number].fault != 0:
                whole = False
        if whole:
            v = channel.offset
            for s in range(begin, begin + channel.count):
                v = v + substitutes[s].weight * state[substitutes[s].number].good
            if v < channel.low:
                v = channel.low
            if v > channel.high:
                v = channel.high
            own.now = v
            own.usable = 1
            own.source = 1
            status |= SUBSTITUTED
        elif own.seen and (not channel.flags & HAS_HOLD or own.age < channel.hold):
            own.now = own.good
            own.source = 2
            status |= HELD
        else:
            own.now = channel.default
            status |= DEFAULTED
            if channel.flags & FADE_ON_DEFAULT:
                status |= LOST
    return status


@kernel
def moved_side(x, known, side, memory, threshold):
    """(side, turning point) of an axis that moved to x."""
    if known > 0.0:
        return 1.0, x
    if known < 0.0:
        return -1.0, x
    if side > 0.0:
        if x >= memory:
            return side, x
        if memory - x > threshold:
            return -1.0, x
    else:
        if x <= memory:
            return side, x
        if x - memory > threshold:
            return 1.0, x
    return side, memory


@kernel
def lookup(lookups, first, last, s):
    """Straight lines between uniform values, held at the ends; s counts steps."""
    if s < 0.0:
        s = 0.0
    if s > last:
        s = float(last)
    j = int(s)
    if j > last - 1:
        j = last - 1
    left = lookups[first + j]
    return left + (s - j) * (lookups[first + j + 1] - left)


@kernel
def is_ready(node, operands, state, inputs):
    """Whether everything below a node has had a believed reading."""
    if node.op == INPUT:
        return inputs[node.other].usable != 0
    below = True
    begin = np.int64(node.first)
    for k in range(begin, begin + node.count):
        below = below and state[operands[k].number].ready != 0
    return below


@kernel
def run_nodes(which, nodes, operands, lookups, state, inputs, common, dt, replay):
    """Run nodes in order; what is not finite counts as 0. Returns status bits."""
    status = 0
    for w in range(which.size):
        n = which[w]
        node = nodes[n]
        own = state[n]
        op = node.op
        begin = np.int64(node.first)
        started = own.ready != 0
        if not started and is_ready(node, operands, state, inputs):
            own.ready = 1
            common[0].unready -= 1
        u = 0.0
        if node.count > 0:
            u = state[operands[begin].number].value
        if op == INPUT:
            u = inputs[node.other].value
        elif op == AFFINE:
            u = node.a
            for k in range(begin, begin + node.count):
                u = u + operands[k].weight * state[operands[k].number].value
        elif op == PRODUCT:
            for k in range(begin + 1, begin + node.count):
                u = u * state[operands[k].number].value
        elif op == LAG:
            before, y = own.memory, own.value
            own.memory = u
            if not started:
                u = 0.0 if node.flags & START_ZERO else u
            else:
                if replay:
                    alpha = exp(-(dt / (node.a if before >= y else node.b)))
                else:
                    alpha = node.c if before >= y else node.d
                u = before + (y - before) * alpha
        elif op == FIRST:
            u = own.value if started else u
        elif op == CONSTANT:
            u = node.a
        elif op == POWER:
            u = power(u, node.a)
        elif op == CLIP:
            u = node.a if u < node.a else node.b if u > node.b else u
        elif op == SWITCH:
            u = 1.0 if u >= node.a else 0.0 if u <= node.b else own.value
        elif op == DIRECTION:
            known = 0.0
            if node.count > 1:
                known = state[operands[begin + 1].number].value
            side, memory = (own.value, own.memory) if started else (node.b, u)
            u, own.memory = moved_side(u, known, side, memory, node.a)
        elif op == APPROACH:
            side = state[operands[begin + 1].number].value
            way = u - own.memory
            own.memory = u
            if way < 0.0:
                way = -way
            if not started:
                u = side
            else:
                u = side - (side - own.value) * exp(-(way / node.a)) if way > 0.0 else own.value
        else:
            u = lookup(lookups, node.other, np.int64(node.others) - 1, (u - node.a) * node.c)
        if not (u >= -LARGEST and u <= LARGEST):
            u = 0.0
            status |= NOT_FINITE
        own.value = u
    return status


@kernel
def fade_target(state, lost):
    """1 inside the validity box, falling to 0 over the margin outside it."""
    if lost:
        return 0.0
    target = 1.0
    for i in range(state.size):
        if state[i].left < target:
            target = state[i].left
    return target if target > 0.0 else 0.0


@kernel
def run_profiles(profiles, values, same_grid, inputs, out):
    """Values of all profiles; returns status bits. Neighbours on one grid share their place on it."""
    status = 0
    j, f = 0, 0.0
    for p in range(profiles.size):
        profile = profiles[p]
        first = np.int64(profile.first)
        if profile.input < 0:
            out[p] = values[first] * profile.scale
            continue
        if not same_grid[p]:
            last = np.int64(profile.count) - 1
            s = (inputs[profile.input].value - profile.start) * profile.inverse_step
            if profile.flags & PERIODIC:
                turns = s * profile.inverse_turn
                whole = int(turns)
                if turns < whole:
                    whole -= 1
                s = s - float(whole) * last
            elif s < 0.0 or s > last:
                status |= BEYOND_PROFILE
            if s < 0.0:
                s = 0.0
            if s > last:
                s = float(last)
            j = int(s)
            if j > last - 1:
                j = last - 1  # type: ignore[assignment]
            f = s - j
        left, right = values[first + j], values[first + j + 1]
        out[p] = (left + f * (right - left)) * profile.scale
    return status


@kernel
def sum_components(pairs, profiles, nodes, fade, out):
    """Components from pairs."""
    out[:] = 0.0
    for k in range(pairs.size):
        pair = pairs[k]
        part = profiles[pair.profile] * nodes[pair.node].value
        if not pair.flags & KEEP:
            part = part * fade
        out[pair.component] += part


@kernel
def sum_outputs(outputs, terms, components, nodes, state):
    """Deviations of the outputs from components; returns status bits."""
    status = 0
    for o in range(outputs.size):
        total = 0.0
        begin = np.int64(outputs[o].first)
        for k in range(begin, begin + outputs[o].count):
            term = terms[k]
            part = term.weight * components[term.component]
            if term.count > 0:
                part = part * nodes[term.n0].value
            if term.count > 1:
                part = part * nodes[term.n1].value
            if term.count > 2:
                part = part * nodes[term.n2].value
            if term.count > 3:
                part = part * nodes[term.n3].value
            total = total + part
        if not (total >= -LARGEST and total <= LARGEST):
            total = 0.0
            status |= NOT_FINITE
        state[o].deviation = total
    return status


@kernel
def can_stop(closing, left, brake):
    """Whether a closing speed can be braked within what is left of the way (per cycle)."""
    if closing <= 0.0:
        return True
    return closing * (closing - brake) <= 2.0 * brake * left


@kernel
def closing_rate(keep, way, drift, slowest, fastest, brake):
    """Full towards, keep, full away: the first that can be braked; where braking would end the closing, half way."""
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
    if sign * (keep - drift) > 0.0 and can_stop(sign * (keep - drift), sign * (way - keep), brake):
        return keep
    if sign * (away - drift) > 0.0:
        return away
    half = drift + 0.5 * (way - drift)
    return slowest if half < slowest else fastest if half > fastest else half


@kernel
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


@kernel
def bound(magnitude, own, before):
    """Keep a correction within its magnitude; True where it would have left it."""
    if own.limited > magnitude:
        own.limited = magnitude
    elif own.limited < -magnitude:
        own.limited = -magnitude
    else:
        return False
    own.rate = own.limited - before
    return True


@kernel
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


@kernel
def cycle(program, state, readings, fresh, dt, replay, mode):
    """One cycle. fresh: non-zero where readings holds a new one; dt in s (since the row before, when replaying).

    mode: OFF (corrections go to 0), ON, or HOLD (they stay as they are).
    """
    common = state.common[0]
    slow = replay or common.until_slow == 0
    common.until_slow = (program.slow_every if slow else common.until_slow) - 1
    old = program.rules == 1
    status = RUNNING | condition(
        program.inputs, program.substitutes, state.inputs, readings, fresh, dt, replay or old, program.thermal_s
    )
    show(program.inputs, state.inputs, slow or old, not old)
    status |= run_nodes(
        program.every if slow else program.fast,
        program.nodes,
        program.operands,
        program.lookups,
        state.nodes,
        state.inputs,
        state.common,
        dt,
        replay,
    )
    if common.unready > 0:
        status |= WAITING
    target = fade_target(state.inputs, status & LOST)
    common.fade = towards(common.fade, target, dt, 0.0 if replay or common.fade < 0.0 else program.fade_s)
    if common.fade < 1.0:
        status |= FADING
    if common.fade <= 0.0:
        status |= FADED
    status |= run_profiles(program.profiles, program.values, program.same_grid, state.inputs, state.profiles)
    sum_components(program.pairs, state.profiles, state.nodes, common.fade, state.components)
    status |= sum_outputs(program.outputs, program.terms, state.components, state.nodes, state.outputs)
    if mode == HOLD:
        status |= HOLDING
    else:
        common.ramp = towards(common.ramp, 1.0 if mode == ON else 0.0, dt, 0.0 if replay else program.ramp_s)
    if common.ramp >= 1.0:
        status |= ACTIVE
    elif common.ramp > 0.0:
        status |= RAMPING
    status |= limit(program.outputs, state.outputs, common.ramp, dt, replay, mode == HOLD, not old)
    common.status = status & ~LOST
    common.heartbeat = (common.heartbeat + 1) & 0xFFFFFFFF


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
        cycle(program, state, columns[k], fresh, dt, True, ON)
        for o in range(state.outputs.size):
            deviation[k, o] = state.outputs[o].deviation
            correction[k, o] = state.outputs[o].correction
        status[k] = state.common[0].status


@kernel
def stream(program, state, columns, fresh, mode, deviation, correction, status):
    """Many cycles at the controller's rate: columns and fresh (cycles, inputs), mode (cycles,)."""
    for k in range(columns.shape[0]):
        cycle(program, state, columns[k], fresh[k], program.cycle_s, False, mode[k])
        for o in range(state.outputs.size):
            deviation[k, o] = state.outputs[o].deviation
            correction[k, o] = state.outputs[o].correction
        status[k] = state.common[0].status
