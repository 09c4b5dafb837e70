"""A compensation table over many points at once, without states: every point is the first cycle of a run.

Blocks of points run through one operation at a time, so inner loops are straight lines over arrays. The
operations on one point, and their order, are those of a cycle, so the numbers agree to the bit.
Shapes: block buffers are (rows, BLOCK). `program` is as in `table_cycle`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.kernels import bare_kernel, kernel
from errpipe.kernels import table_codes as codes
from errpipe.kernels.elementary import power

BLOCK = 128  # points; the rows of a block of 21 curves lie in 40 kB (64 costs a fifth more, 256 as much)


class Buffers(NamedTuple):
    """Rows of one block; spare: three rows, intervals: (BLOCK,) where points lie on a grid."""

    inputs: np.ndarray
    nodes: np.ndarray
    sums: np.ndarray
    profiles: np.ndarray
    spare: np.ndarray
    intervals: np.ndarray


class Plan(NamedTuple):
    """How the blocks of a table are worked off; see `tables/batch.py`, which makes it."""

    components: int
    opens: np.ndarray  # (pairs,) 1: the first of its component
    alone: np.ndarray  # (pairs,) 1: its profile is written to its component at once, 2: that never changes
    knots: np.ndarray  # of the profiles that move: values and rises to the next, one profile or two by turns
    first: np.ndarray  # (profiles + 1,) where the knots of a profile begin
    width: np.ndarray  # (profiles,) numbers per knot: 2, 4 where the next profile is worked off with it, else 0
    row: np.ndarray  # (profiles,) where it is written: its component, else its own row behind the components
    factor: np.ndarray  # (profiles,) what it is multiplied by: the driver of its pair, else 1


@bare_kernel
def clip_block(x, low, high, out):
    """Points within a range (not a number: at its lower end); returns how many are not a number."""
    missing = 0
    for k in range(x.size):
        missing += x[k] != x[k]
        inside = x[k] if x[k] > low else low
        out[k] = inside if inside < high else high
    return missing


@bare_kernel
def place_block(x, start, inverse_step, inverse_turn, top, periodic, j, f):
    """Where a block of positions lies on a grid: interval j and fraction f."""
    highest = np.int32(top) - np.int32(1)
    if periodic:
        for i in range(x.size):
            s = (x[i] - start) * inverse_step
            turns = s * inverse_turn
            whole = float(np.int64(turns))
            if turns < whole:
                whole = whole - 1.0
            s = s - whole * top
            s = s if s > 0.0 else 0.0
            s = s if s < top else top
            k = min(np.int32(s), highest)  # 32 bits: processors turn several at once
            f[i] = s - np.float64(k)
            j[i] = k
    else:
        for i in range(x.size):
            s = (x[i] - start) * inverse_step
            s = s if s > 0.0 else 0.0
            s = s if s < top else top
            k = min(np.int32(s), highest)  # 32 bits: processors turn several at once
            f[i] = s - np.float64(k)
            j[i] = k


@bare_kernel
def profile_block(knots, j, f, scale, factor, out):
    """One profile at places on its grid, times a factor. knots: value and rise to the next by turns."""
    for i in range(out.size):
        k = np.uint64(j[i]) * np.uint64(2)
        out[i] = (knots[k] + f[i] * knots[k + np.uint64(1)]) * scale * factor


@bare_kernel
def two_profiles_block(knots, j, f, scale, factor, out, scale2, factor2, out2):
    """Two profiles on one grid: what a point needs of both lies together. knots: two values, two rises by turns."""
    for i in range(out.size):
        k = np.uint64(j[i]) * np.uint64(4)
        out[i] = (knots[k] + f[i] * knots[k + np.uint64(2)]) * scale * factor
        out2[i] = (knots[k + np.uint64(1)] + f[i] * knots[k + np.uint64(3)]) * scale2 * factor2


@bare_kernel
def copy_block(u, out):
    """u into out; a loop, for a slice assigned to a slice goes by way of the heap."""
    for i in range(out.size):
        out[i] = u[i]


@bare_kernel
def node_block(node, first, operands, lookups, nodes, inputs, out):
    """One node over a block; one that has a state as in the first cycle of a run."""
    op = node.op
    end = first + node.count
    if op == codes.INPUT:
        copy_block(inputs[node.other], out)
        return
    if op == codes.AFFINE:
        out[:] = node.a
        for k in range(first, end):
            weight = operands[k].weight
            u = nodes[operands[k].number]
            for i in range(out.size):
                out[i] = out[i] + weight * u[i]
        return
    u = nodes[operands[first].number]
    if op == codes.PRODUCT:
        copy_block(u, out)
        for k in range(first + 1, end):
            v = nodes[operands[k].number]
            for i in range(out.size):
                out[i] = out[i] * v[i]
    elif op == codes.POWER:
        for i in range(out.size):
            out[i] = power(u[i], node.a)
    elif op == codes.CLIP:
        for i in range(out.size):
            out[i] = node.a if u[i] < node.a else node.b if u[i] > node.b else u[i]
    elif op == codes.SWITCH:
        for i in range(out.size):
            out[i] = 1.0 if u[i] >= node.a else 0.0
    elif op == codes.DIRECTION:
        out[:] = node.b
        if node.count > 1:
            v = nodes[operands[first + 1].number]
            for i in range(out.size):
                out[i] = 1.0 if v[i] > 0.0 else -1.0 if v[i] < 0.0 else node.b
    elif op == codes.APPROACH:
        copy_block(nodes[operands[first + 1].number], out)
    elif op == codes.LAG and node.flags & codes.START_ZERO:
        out[:] = 0.0
    elif op == codes.LOOKUP:
        last = np.int64(node.others) - 1
        table = lookups[np.int64(node.other) : np.int64(node.other) + last + 1]
        top = float(last)
        for i in range(out.size):
            s = (u[i] - node.a) * node.c
            s = s if s > 0.0 else 0.0
            s = s if s < top else top
            j = min(np.int64(s), last - 1)
            left = table[j]
            out[i] = left + (s - j) * (table[j + 1] - left)
    else:  # first, and a lag that starts at its input
        copy_block(u, out)


@bare_kernel
def fade_block(channel, x, fade):
    """How far each point is inside one validity box: 1 to 0, the least of all boxes so far."""
    for k in range(x.size):
        outside = channel.valid_low - x[k] if x[k] < channel.valid_low else x[k] - channel.valid_high
        left = 1.0 - outside / channel.margin
        left = left if left > 0.0 else 0.0
        if outside > 0.0 and left < fade[k]:
            fade[k] = left


@bare_kernel
def sum_pairs(pairs, opens, alone, profiles, nodes, fixed, moves, inside, sums):
    """Components from pairs over a block. opens: 1 where a pair is the first of its component; alone: not 0 where its
    component holds it already."""
    for k in range(pairs.size):
        if alone[k]:
            continue
        total, profile, n = sums[pairs[k].component], profiles[pairs[k].profile], pairs[k].node
        node, factor = nodes[n], fixed[n]
        if opens[k]:
            total[:] = 0.0
        if not pairs[k].flags & codes.KEEP:
            if moves[n]:
                for i in range(total.size):
                    total[i] = total[i] + profile[i] * node[i] * inside[i]
            else:
                for i in range(total.size):
                    total[i] = total[i] + profile[i] * factor * inside[i]
        elif moves[n]:
            for i in range(total.size):
                total[i] = total[i] + profile[i] * node[i]
        else:
            for i in range(total.size):
                total[i] = total[i] + profile[i] * factor


@bare_kernel
def sum_terms(terms, first, count, sums, nodes, part, total):
    """One output from components over a block; neighbours share a pass: two with one factor each (an
    angle and its arm), also behind one without (a translation and two angles)."""
    for i in range(total.size):
        total[i] = 0.0
    k, end = first, first + count
    while k < end:
        term = terms[k]
        weight, component = term.weight, sums[term.component]
        if term.count == 1 and k + 1 < end and terms[k + 1].count == 1:
            node, after = nodes[term.n0], terms[k + 1]
            weight2, component2, node2 = after.weight, sums[after.component], nodes[after.n0]
            for i in range(total.size):
                total[i] = total[i] + weight * component[i] * node[i] + weight2 * component2[i] * node2[i]
            k = k + 1
        elif term.count == 0 and k + 2 < end and terms[k + 1].count == 1 and terms[k + 2].count == 1:
            second, third = terms[k + 1], terms[k + 2]
            weight2, component2, node2 = second.weight, sums[second.component], nodes[second.n0]
            weight3, component3, node3 = third.weight, sums[third.component], nodes[third.n0]
            for i in range(total.size):
                angles = weight2 * component2[i] * node2[i], weight3 * component3[i] * node3[i]
                total[i] = total[i] + weight * component[i] + angles[0] + angles[1]
            k = k + 2
        elif term.count == 0:
            for i in range(total.size):
                total[i] = total[i] + weight * component[i]
        elif term.count == 1:
            node = nodes[term.n0]
            for i in range(total.size):
                total[i] = total[i] + weight * component[i] * node[i]
        else:
            n0, n1 = nodes[term.n0], nodes[term.n1]
            for i in range(total.size):
                part[i] = weight * component[i] * n0[i] * n1[i]
            for f in range(2, term.count):
                node = nodes[term.n2 if f == 2 else term.n3]
                for i in range(total.size):
                    part[i] = part[i] * node[i]
            for i in range(total.size):
                total[i] = total[i] + part[i]
        k = k + 1


@bare_kernel
def bound_block(total):
    """What is no number that a table may hold counts as 0."""
    for i in range(total.size):
        total[i] = total[i] if total[i] >= -codes.LARGEST and total[i] <= codes.LARGEST else 0.0


@bare_kernel
def profile_blocks(program, plan, inputs, sums, j, f):
    """All profiles that move, over a block."""
    for p in range(program.profiles.size):
        if plan.width[p] > 0:
            own = program.profiles[p]
            if not program.same_grid[p]:
                top, periodic = float(own.count) - 1.0, own.flags & codes.PERIODIC
                place_block(inputs[own.input], own.start, own.inverse_step, own.inverse_turn, top, periodic, j, f)
            knots = plan.knots[plan.first[p] : plan.first[p + 1]]
            row = sums[plan.row[p]]
            if plan.width[p] == 2:
                profile_block(knots, j, f, own.scale, plan.factor[p], row)
            else:
                other, factor, row2 = program.profiles[p + 1], plan.factor[p + 1], sums[plan.row[p + 1]]
                two_profiles_block(knots, j, f, own.scale, plan.factor[p], row, other.scale, factor, row2)


@bare_kernel
def fill(program, plan, node_fixed, profile_fixed, buffers):
    """Values that are constant over all blocks."""
    for n in range(program.nodes.size):
        buffers.nodes[n, :] = node_fixed[n]
    for p in range(program.profiles.size):
        buffers.profiles[p, :] = profile_fixed[p]
    for k in range(program.pairs.size):
        pair = program.pairs[k]
        if plan.alone[k] == 2:
            buffers.sums[pair["component"], :] = 0.0 + profile_fixed[pair["profile"]] * node_fixed[pair["node"]]


@kernel
def workspace(program, plan):
    sums = np.zeros((plan.components + program.profiles.size, BLOCK))
    inputs, nodes = np.zeros((program.inputs.size, BLOCK)), np.zeros((program.nodes.size, BLOCK))
    profiles, intervals = sums[plan.components :], np.empty(BLOCK, dtype=np.int32)
    return Buffers(inputs, nodes, sums, profiles, np.zeros((3, BLOCK)), intervals)


@kernel
def evaluate(program, plan, points, moving, node_fixed, node_moves, profile_fixed, fade, out):
    """Deviations at many points; returns how many readings are not a number. points (inputs that move, n) by row; out
    (outputs, n).

    moving: numbers of the inputs in `points`; *_fixed: values where nothing below moves; fade: what the fixed
    inputs leave.
    """
    buffers = workspace(program, plan)
    fill(program, plan, node_fixed, profile_fixed, buffers)
    return run_blocks(program, plan, points, moving, node_fixed, node_moves, fade, buffers, out)


@bare_kernel
def run_blocks(program, plan, points, moving, node_fixed, node_moves, fade, buffers, out):
    """Block after block of `evaluate`."""
    rows, missing = points.shape[1], 0
    inputs, nodes, sums, profiles = buffers.inputs, buffers.nodes, buffers.sums, buffers.profiles
    part, inside, f = buffers.spare[0], buffers.spare[1], buffers.spare[2]
    for begin in range(0, rows, BLOCK):
        end = min(begin + BLOCK, rows)
        for i in range(BLOCK):
            inside[i] = fade
        for i in range(moving.size):
            channel = program.inputs[moving[i]]
            row = inputs[moving[i]]
            missing += clip_block(points[i, begin:end], channel.low, channel.high, row)
            if channel.flags & codes.HAS_VALID:
                fade_block(channel, row, inside)
                if program.rules > 1:
                    clip_block(row, channel.valid_low, channel.valid_high, row)
        for n in range(program.nodes.size):
            if node_moves[n]:
                node = program.nodes[n]
                node_block(node, np.int64(node.first), program.operands, program.lookups, nodes, inputs, nodes[n])
        profile_blocks(program, plan, inputs, sums, buffers.intervals, f)
        sum_pairs(program.pairs, plan.opens, plan.alone, profiles, nodes, node_fixed, node_moves, inside, sums)
        for o in range(out.shape[0]):
            own = program.outputs[o]
            total = out[o, begin:end]
            sum_terms(program.terms, np.int64(own.first), np.int64(own.count), sums, nodes, part, total)
            bound_block(total)
    return missing
