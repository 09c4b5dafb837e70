"""One cycle of a compensation table, and the replay of a recording, on plain arrays.

The operations and their order are those of the reference evaluator (`errpipe/tables/reference.py`), to the bit.
Nothing is allocated in a cycle. `program` is the sections of an `.ect` file as record arrays, as they lie in the
file, `state` what lasts from cycle to cycle: `errpipe/tables/pack.py` declares their records and makes both. Loops
stand in few functions with few arguments: what is called per node takes numbers, not arrays, else the calls cost more
than the arithmetic.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import bare_kernel
from errpipe.kernels import table_codes as codes
from errpipe.kernels.elementary import closing_rate, on_grid, towards
from errpipe.kernels.table_codes import AT_MAGNITUDE, AT_RATE, HAS_ACCELERATION, HAS_MAGNITUDE, HAS_SLEW, LARGEST
from errpipe.kernels.table_nodes import run_nodes
from errpipe.kernels.table_readings import condition, show


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
def limit_magnitude(magnitude, own, before):
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
                if bounds_last and output.flags & HAS_MAGNITUDE and limit_magnitude(output.magnitude, own, before):
                    status |= AT_MAGNITUDE
        own.correction = own.limited * output.factor
    return status


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


@bare_kernel
def reset(program, state):
    """The next cycle is the first of a run; corrections stay where they are, and continue from there."""
    for i in range(state.inputs.size):
        own = state.inputs[i]
        own.raw = np.nan
        own.anchor = codes.NOWHERE
        own.left = 1.0
        own.wait = own.good = own.age = own.now = own.value = 0.0
        own.seen = own.fault = own.source = own.rejected = 0
        own.usable = 1 if program.inputs[i].flags & codes.OPTIONAL else 0
    for n in range(state.nodes.size):
        own = state.nodes[n]
        own.value = own.memory = 0.0
        own.ready = own.stated = 0
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


@bare_kernel
def fade_target(state, lost):
    """1 inside the validity box, falling to 0 over the margin outside it."""
    if lost:
        return 0.0
    target = 1.0
    for i in range(state.size):
        if state[i].left < target:
            target = state[i].left
    return target if target > 0.0 else 0.0


@bare_kernel
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
            if profile.flags & codes.PERIODIC:
                turns = s * profile.inverse_turn
                whole = int(turns)
                if turns < whole:
                    whole -= 1
                s = s - float(whole) * last
            elif s < 0.0 or s > last:
                status |= codes.BEYOND_PROFILE
            j, f = on_grid(s, last)
        left, right = values[first + j], values[first + j + 1]
        out[p] = (left + f * (right - left)) * profile.scale
    return status


@bare_kernel
def sum_components(pairs, profiles, nodes, fade, out):
    out[:] = 0.0
    for k in range(pairs.size):
        pair = pairs[k]
        part = profiles[pair.profile] * nodes[pair.node].value
        if not pair.flags & codes.KEEP:
            part = part * fade
        out[pair.component] += part


@bare_kernel
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
        if not (total >= -codes.LARGEST and total <= codes.LARGEST):
            total = 0.0
            status |= codes.NOT_FINITE
        state[o].deviation = total
    return status


@bare_kernel
def cycle(program, state, readings, fresh, dt, replay, mode):
    """One cycle. fresh: non-zero where readings holds a new one; dt: s since the row before, when replaying.

    mode: OFF (corrections go to 0), ON, or HOLD (they stay as they are). Where nothing is replayed a call is a cycle of
    the table, whatever a clock says: a clock that steps would carry a correction past its slew.
    """
    dt = dt if replay else program.cycle_s
    common = state.common[0]
    slow = replay or common.until_slow == 0
    common.until_slow = (program.slow_every if slow else common.until_slow) - 1
    old = program.rules == 1
    status = codes.RUNNING | condition(
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
        not (replay or old),
    )
    if common.unready > 0:
        status |= codes.WAITING
    target = fade_target(state.inputs, status & codes.LOST)
    common.fade = towards(common.fade, target, dt, 0.0 if replay or common.fade < 0.0 else program.fade_s)
    if common.fade < 1.0:
        status |= codes.FADING
    if common.fade <= 0.0:
        status |= codes.FADED
    status |= run_profiles(program.profiles, program.values, program.same_grid, state.inputs, state.profiles)
    sum_components(program.pairs, state.profiles, state.nodes, common.fade, state.components)
    status |= sum_outputs(program.outputs, program.terms, state.components, state.nodes, state.outputs)
    if mode == codes.HOLD:
        status |= codes.HOLDING
    else:
        common.ramp = towards(common.ramp, 1.0 if mode == codes.ON else 0.0, dt, 0.0 if replay else program.ramp_s)
    if common.ramp >= 1.0:
        status |= codes.ACTIVE
    elif common.ramp > 0.0:
        status |= codes.RAMPING
    status |= limit(program.outputs, state.outputs, common.ramp, dt, replay, mode == codes.HOLD, not old)
    common.status = status & ~codes.LOST
    common.heartbeat = (common.heartbeat + 1) & 0xFFFFFFFF


@bare_kernel
def replay(program, state, fresh, row, columns, t, run, goes_on, before, begin, end, deviation, correction, status):
    """Replay rows of a recording: columns (inputs, rows), t in s, run: an integer per row; states restart where it
    changes.

    goes_on: the first of these rows continues from the state, `before` being the time of the row before it; else it
    restarts. row: room for the readings of one. Fills deviation and correction (outputs, rows) and status (rows,).
    Time that does not advance, runs back or is missing within a run counts as no time.
    """
    for k in range(begin, end):
        dt = 0.0
        if not goes_on or (k > 0 and run[k] != run[k - 1]):
            reset(program, state)
        elif t[k] > before:
            dt = t[k] - before
        goes_on, before = True, t[k]
        for i in range(row.size):
            row[i] = columns[i, k]
        cycle(program, state, row, fresh, dt, True, codes.ON)
        for o in range(state.outputs.size):
            deviation[o, k] = state.outputs[o].deviation
            correction[o, k] = state.outputs[o].correction
        status[k] = state.common[0].status


@bare_kernel
def stream(program, state, columns, fresh, mode, deviation, correction, status):
    """Many cycles at the controller's rate: columns and fresh (cycles, inputs), mode (cycles,)."""
    for k in range(columns.shape[0]):
        cycle(program, state, columns[k], fresh[k], program.cycle_s, False, mode[k])
        for o in range(state.outputs.size):
            deviation[k, o] = state.outputs[o].deviation
            correction[k, o] = state.outputs[o].correction
        status[k] = state.common[0].status
