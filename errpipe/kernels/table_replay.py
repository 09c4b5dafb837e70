"""Replay of a recording, in blocks of rows: one operation at a time over a block, to the bit as cycle after cycle.

A block stands where every reading that matters is accepted, every driver has started and every result is a number.
Other rows are evaluated by the cycle, which alone handles bad readings.
Shapes: block buffers are (rows, BLOCK) as in `table_position`; `program` and `state` are those of `table_cycle`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import bare_kernel
from errpipe.kernels import table_codes as codes
from errpipe.kernels.arithmetic import EXP, LOG2_E
from errpipe.kernels.elementary import exp, moved_side
from errpipe.kernels.table_position import BLOCK, Buffers, fade_block, node_block, profile_blocks, sum_pairs, sum_terms
from errpipe.kernels.table_readings import follows


class Workspace(NamedTuple):
    """Workspace that a replay works in. kept_*: the state before a block, for a block that does not stand."""

    buffers: Buffers
    node_fixed: np.ndarray  # (nodes,) values of the constants
    node_moves: np.ndarray  # (nodes,) 0 for constants
    decay: np.ndarray  # (2, BLOCK)
    dt: np.ndarray  # (BLOCK,) s
    kept_inputs: np.ndarray
    kept_nodes: np.ndarray


@bare_kernel
def all_in_range(values):
    """Whether every value is a number that a table may hold."""
    sane = 0
    for k in range(values.size):
        sane += values[k] >= -codes.LARGEST and values[k] <= codes.LARGEST
    return sane == values.size


@bare_kernel
def steps(t, before, dt):
    """Time since the row before, s; 0 where it does not advance, runs back or is missing."""
    dt[0] = t[0] - before if t[0] > before else 0.0
    for k in range(1, t.size):
        dt[k] = t[k] - t[k - 1] if t[k] > t[k - 1] else 0.0


@bare_kernel
def decay_block(way, whole, out):
    """exp(-(way / whole)); where none is below 1 / sqrt 2, in a loop without branches."""
    alike, near = 0, 0
    for k in range(way.size):
        y = -(way[k] / whole)
        alike += way[k] == way[0]
        near += y * LOG2_E - 0.5 > -1.0  # `exp` then divides by no power of two
        out[k] = y
    if alike == way.size:
        out[:] = exp(out[0])
    elif near == way.size:
        for k in range(way.size):
            p = EXP[0]
            for i in range(1, 14):
                p = p * out[k] + EXP[i]
            out[k] = p
    else:
        for k in range(way.size):
            out[k] = exp(out[k])


@bare_kernel
def accept_block(channel, own, v, dt, thermal_s, out):
    """Readings as `condition` judges them, substitutes for missing optional ones; False if one is not accepted."""
    inside = 0
    for k in range(v.size):
        inside += v[k] >= channel.low and v[k] <= channel.high
    whole, watched = inside == v.size, channel.flags & codes.HAS_MAX_RATE
    if not whole and not channel.flags & codes.OPTIONAL:
        return False
    last = v[v.size - 1]
    if whole and not watched:
        for k in range(v.size):
            out[k] = v[k]
        own.age = 0.0
    else:
        for k in range(v.size):
            own.age = own.age + dt[k]
            if v[k] >= channel.low and v[k] <= channel.high:
                if watched and not follows(channel, own, v[k], True, True, thermal_s):
                    return False
                own.age, own.good, own.seen = 0.0, v[k], 1
                out[k] = v[k]
            else:
                out[k] = channel.default
    own.raw, own.wait, own.now = last, 0.0, out[v.size - 1]
    own.fault = own.source = 0
    if last >= channel.low and last <= channel.high:
        own.good, own.seen, own.usable = last, 1, 1
    else:
        own.fault = 3 if last >= -codes.LARGEST and last <= codes.LARGEST else 1
        own.source = 3
    return True


@bare_kernel
def show_block(channel, own, v, inside, clamped):
    """Accepted readings `v` clipped to validity, and the share of the table that applies."""
    last = v.size - 1
    own.left = 1.0
    if channel.flags & codes.HAS_VALID:
        low, high = channel.valid_low, channel.valid_high
        outside = low - v[last] if v[last] < low else v[last] - high
        if outside > 0.0:
            own.left = 1.0 - outside / channel.margin
        fade_block(channel, v, inside)
        if clamped:
            for k in range(v.size):
                v[k] = low if v[k] < low else high if v[k] > high else v[k]
    own.value = v[last]


@bare_kernel
def lag_block(own, u, up, down, out):
    """A first-order lag with its factors per row."""
    before, y = own.memory, own.value
    for k in range(u.size):
        rising, falling = up[k], down[k]
        y = before + (y - before) * (rising if before >= y else falling)
        before = u[k]
        out[k] = y
    own.memory = before


@bare_kernel
def state_block(node, own, u, v, dt, decay, out):
    """A node that has a state, over a block, `v` being its second operand; False where it has none."""
    op = node.op
    if op == codes.LAG:
        up, down = decay[0, : u.size], decay[1, : u.size]
        decay_block(dt, node.a, up)
        if node.b == node.a:
            down = up
        else:
            decay_block(dt, node.b, down)
        lag_block(own, u, up, down, out)
    elif op == codes.FIRST:
        out[:] = own.value
    elif op == codes.SWITCH:
        y = own.value
        for k in range(u.size):
            y = 1.0 if u[k] >= node.a else 0.0 if u[k] <= node.b else y
            out[k] = y
    elif op == codes.DIRECTION:
        side, memory = own.value, own.memory
        for k in range(u.size):
            side, memory = moved_side(u[k], v[k] if node.count > 1 else 0.0, side, memory, node.a)
            out[k] = side
        own.memory = memory
    elif op == codes.APPROACH:
        way, left, y = decay[0, : u.size], decay[1, : u.size], own.value
        for k in range(u.size):
            way[k] = abs(u[k] - (own.memory if k == 0 else u[k - 1]))
        decay_block(way, node.a, left)
        for k in range(u.size):
            y = v[k] - (v[k] - y) * left[k] if way[k] > 0.0 else y
            out[k] = y
        own.memory = u[u.size - 1]
    else:
        return False
    return True


@bare_kernel
def beyond_block(profile, x, status):
    """Mark the rows whose position lies beyond the ends of a profile."""
    last = float(profile.count) - 1.0
    for k in range(x.size):
        s = (x[k] - profile.start) * profile.inverse_step
        status[k] |= codes.BEYOND_PROFILE if s < 0.0 or s > last else 0


@bare_kernel
def limit_block(output, own, deviation, correction, status):
    """Corrections from deviations, as `limit` has them in a replay."""
    last = deviation.size - 1
    for k in range(deviation.size):
        correction[k] = -deviation[k]
    if output.flags & codes.HAS_MAGNITUDE:
        most = output.magnitude
        for k in range(deviation.size):
            target = correction[k]
            status[k] |= codes.AT_MAGNITUDE if target > most or target < -most else 0
            target = most if target > most else target
            correction[k] = -most if target < -most else target
    own.deviation, own.limited = deviation[last], correction[last]
    for k in range(deviation.size):
        correction[k] = correction[k] * output.factor
    own.correction = correction[last]


@bare_kernel
def block_of_readings(program, workspace, state, columns, begin, end):
    """Inputs of a block; False where a reading is doubtful."""
    inside, size = workspace.buffers.spare[1], end - begin
    inside[:] = 1.0
    for i in range(program.inputs.size):
        channel, own, v = program.inputs[i], state.inputs[i], workspace.buffers.inputs[i, :size]
        if not accept_block(channel, own, columns[i, begin:end], workspace.dt[:size], program.thermal_s, v):
            return False
        show_block(channel, own, v, inside[:size], program.rules > 1)
    return True


@bare_kernel
def block_of_nodes(program, workspace, state, size):
    """Drivers of a block; False if a value is not a number."""
    nodes, inputs = workspace.buffers.nodes, workspace.buffers.inputs
    for n in range(program.nodes.size):
        if workspace.node_moves[n]:
            node, own, out = program.nodes[n], state.nodes[n], nodes[n, :size]
            begin = np.int64(node.first)
            u = nodes[program.operands[begin].number, :size] if node.count > 0 else out
            v = nodes[program.operands[begin + 1].number, :size] if node.count > 1 else out
            if not state_block(node, own, u, v, workspace.dt[:size], workspace.decay, out):
                node_block(node, begin, program.operands, program.lookups, nodes, inputs, nodes[n])
            if not all_in_range(out):
                return False
            own.value = out[size - 1]
    return True


@bare_kernel
def block(program, plan, workspace, state, columns, begin, end, deviation, correction, status):
    """Rows that continue one run; False, with only the results changed, if they must be evaluated one by one."""
    buffers, size = workspace.buffers, end - begin
    inside, marks = buffers.spare[1], status[begin:end]
    if not block_of_readings(program, workspace, state, columns, begin, end) or not block_of_nodes(
        program, workspace, state, size
    ):
        return False
    for k in range(size):
        marks[k] = (
            codes.RUNNING
            | codes.ACTIVE
            | (codes.FADING if inside[k] < 1.0 else 0)
            | (codes.FADED if inside[k] <= 0.0 else 0)
        )
    for p in range(program.profiles.size):
        own = program.profiles[p]
        if own.input >= 0 and not program.same_grid[p] and not own.flags & codes.PERIODIC:
            beyond_block(own, buffers.inputs[own.input, :size], marks)
    profile_blocks(program, plan, buffers.inputs, buffers.sums, buffers.intervals, buffers.spare[2])
    sum_pairs(program.pairs, plan.opens, plan.alone, buffers.profiles, buffers.nodes, workspace.node_fixed,
              workspace.node_moves, inside, buffers.sums)  # fmt: skip
    for o in range(program.outputs.size):
        own = program.outputs[o]
        total = deviation[o, begin:end]
        sum_terms(program.terms, np.int64(own.first), np.int64(own.count), buffers.sums, buffers.nodes,
                  buffers.spare[0], total)  # fmt: skip
        if not all_in_range(total):
            return False
        limit_block(own, state.outputs[o], total, correction[o, begin:end], marks)
    common = state.common[0]
    common.fade, common.status = inside[size - 1], marks[size - 1]
    common.heartbeat = (common.heartbeat + size) & 0xFFFFFFFF
    return True


@bare_kernel
def keep(there, here):
    """Records from here to there."""
    for k in range(here.size):
        there[k] = here[k]


@bare_kernel
def replay(program, plan, workspace, state, columns, t, run, before, begin, deviation, correction, status):
    """Replay rows from `begin` on, block after block, as `table_cycle.replay` does; returns the first that is left:
    where the run ends, or a block begins that does not stand.
    """
    k, rows = begin, columns.shape[1]
    while k < rows and state.common[0].unready == 0 and (k == 0 or run[k] == run[k - 1]):
        end = k + 1
        while end < rows and end < k + BLOCK and run[end] == run[k]:
            end += 1
        steps(t[k:end], before, workspace.dt[: end - k])
        keep(workspace.kept_inputs, state.inputs)
        keep(workspace.kept_nodes, state.nodes)
        if not block(program, plan, workspace, state, columns, k, end, deviation, correction, status):
            keep(state.inputs, workspace.kept_inputs)
            keep(state.nodes, workspace.kept_nodes)
            break
        k, before = end, t[end - 1]
    return k
