"""A compensation table over many points at once, without states: every point is the first cycle of a run.

Blocks of points run through one operation at a time, so inner loops are straight lines over arrays. The
operations on one point, and their order, are those of a cycle, so the numbers agree to the bit.
Shapes: block buffers are (rows, BLOCK). `program` is as in `table_cycle`.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel

BLOCK = 512  # by trial: 64 to 1024 lie within 30 % of each other
DIRECTION, APPROACH, LOOKUP, AFFINE, LAG, PRODUCT, SWITCH, CLIP, INPUT = 10, 11, 12, 3, 5, 6, 9, 8, 2
HAS_VALID, START_ZERO, PERIODIC, KEEP = 4, 2, 1, 1
POWER = 7
LARGEST = 1e30

# exp, ln and power stand here again, word for word as in table_cycle.py (a test compares them): a kernel may
# only call kernels of its own file.
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
def place_block(x, start, inverse_step, inverse_turn, top, periodic, j, f):
    """Where a block of positions lies on a grid: interval j (as twice its number) and fraction f."""
    highest = np.int64(top) - 1
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
            k = min(np.int64(s), highest)
            f[i] = s - k
            j[i] = 2 * k
    else:
        for i in range(x.size):
            s = (x[i] - start) * inverse_step
            s = s if s > 0.0 else 0.0
            s = s if s < top else top
            k = min(np.int64(s), highest)
            f[i] = s - k
            j[i] = 2 * k


@kernel
def profile_block(knots, j, f, scale, out):
    """One profile at places on its grid; knots: value and rise to the next, alternating."""
    for i in range(out.size):
        k = np.uint64(j[i])
        out[i] = (knots[k] + f[i] * knots[k + np.uint64(1)]) * scale


@kernel
def node_block(node, first, operands, lookups, nodes, inputs, out):
    """One node over a block; one that has a state as in the first cycle of a run."""
    op = node.op
    end = first + node.count
    if op == INPUT:
        out[:] = inputs[node.other]
        return
    if op == AFFINE:
        out[:] = node.a
        for k in range(first, end):
            weight = operands[k].weight
            u = nodes[operands[k].number]
            for i in range(out.size):
                out[i] = out[i] + weight * u[i]
        return
    u = nodes[operands[first].number]
    if op == PRODUCT:
        out[:] = u
        for k in range(first + 1, end):
            v = nodes[operands[k].number]
            for i in range(out.size):
                out[i] = out[i] * v[i]
    elif op == POWER:
        for i in range(out.size):
            out[i] = power(u[i], node.a)
    elif op == CLIP:
        for i in range(out.size):
            out[i] = node.a if u[i] < node.a else node.b if u[i] > node.b else u[i]
    elif op == SWITCH:
        for i in range(out.size):
            out[i] = 1.0 if u[i] >= node.a else 0.0
    elif op == DIRECTION:
        out[:] = node.b
        if node.count > 1:
            v = nodes[operands[first + 1].number]
            for i in range(out.size):
                out[i] = 1.0 if v[i] > 0.0 else -1.0 if v[i] < 0.0 else node.b
    elif op == APPROACH:
        out[:] = nodes[operands[first + 1].number]
    elif op == LAG and node.flags & START_ZERO:
        out[:] = 0.0
    elif op == LOOKUP:
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
        out[:] = u


@kernel
def fade_block(channel, x, fade):
    """How far each point is inside one validity box: 1 to 0, the least of all boxes so far."""
    for k in range(x.size):
        outside = channel.valid_low - x[k] if x[k] < channel.valid_low else x[k] - channel.valid_high
        left = 1.0 - outside / channel.margin
        left = left if left > 0.0 else 0.0
        if outside > 0.0 and left < fade[k]:
            fade[k] = left


@kernel
def sum_pairs(pairs, opens, profiles, nodes, fixed, moves, inside, sums):
    """Components from pairs over a block. opens: 1 where a pair is the first of its component."""
    for k in range(pairs.size):
        total, profile, n = sums[pairs[k].component], profiles[pairs[k].profile], pairs[k].node
        node, factor = nodes[n], fixed[n]
        if not pairs[k].flags & KEEP:
            if opens[k]:
                total[:] = 0.0
            if moves[n]:
                for i in range(total.size):
                    total[i] = total[i] + profile[i] * node[i] * inside[i]
            else:
                for i in range(total.size):
                    total[i] = total[i] + profile[i] * factor * inside[i]
        elif moves[n]:
            if opens[k]:
                total[:] = 0.0
            for i in range(total.size):
                total[i] = total[i] + profile[i] * node[i]
        elif opens[k]:
            for i in range(total.size):
                total[i] = profile[i] * factor
        else:
            for i in range(total.size):
                total[i] = total[i] + profile[i] * factor


@kernel
def sum_terms(terms, first, count, sums, nodes, part, total):
    """One output from components over a block."""
    for k in range(first, first + count):
        term = terms[k]
        weight, component = term.weight, sums[term.component]
        if k == first and term.count != 0:
            total[:] = 0.0
        if term.count == 0 and k == first:
            for i in range(total.size):
                total[i] = weight * component[i]
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
    for i in range(total.size):  # + 0.0: a sum that begins with 0 is never -0
        total[i] = total[i] + 0.0 if total[i] >= -LARGEST and total[i] <= LARGEST else 0.0


@kernel
def evaluate(
    program, knots, knots_first, points, moving, node_fixed, node_moves, profile_fixed, profile_moves, fade, out
):
    """Deviations at many points. points (inputs that move, n) by row; out (outputs, n).

    knots: for every profile value, the value and the rise to the next; knots_first: where each profile begins.
    moving: numbers of the inputs in `points`; *_fixed: values where nothing below moves; fade: what the fixed
    inputs leave.
    """
    rows = points.shape[1]
    components = 0
    for k in range(program.pairs.size):
        components = max(components, np.int64(program.pairs[k].component) + 1)  # type: ignore[assignment]
    for k in range(program.terms.size):
        components = max(components, np.int64(program.terms[k].component) + 1)  # type: ignore[assignment]
    inputs = np.zeros((program.inputs.size, BLOCK))
    nodes = np.empty((program.nodes.size, BLOCK))
    for n in range(program.nodes.size):
        nodes[n, :] = node_fixed[n]
    profiles = np.empty((program.profiles.size, BLOCK))
    for p in range(program.profiles.size):
        profiles[p, :] = profile_fixed[p]
    sums = np.zeros((components, BLOCK))
    opens = np.zeros(program.pairs.size, dtype=np.uint8)
    for k in range(program.pairs.size):
        opens[k] = 1
        for earlier in range(k):
            if program.pairs[earlier].component == program.pairs[k].component:
                opens[k] = 0
    part, inside, f = np.empty(BLOCK), np.ones(BLOCK), np.empty(BLOCK)
    j = np.empty(BLOCK, dtype=np.int64)
    for begin in range(0, rows, BLOCK):
        count = min(BLOCK, rows - begin)
        inside[:] = fade
        for i in range(moving.size):
            channel = program.inputs[moving[i]]
            low, high = channel.low, channel.high
            row = inputs[moving[i]]
            for k in range(count):
                x = points[i, begin + k]
                x = x if x > low else low
                row[k] = x if x < high else high
            if channel.flags & HAS_VALID:
                fade_block(channel, row, inside)
                if program.rules > 1:
                    for k in range(count):
                        x = row[k] if row[k] > channel.valid_low else channel.valid_low
                        row[k] = x if x < channel.valid_high else channel.valid_high
        for n in range(program.nodes.size):
            if node_moves[n]:
                node = program.nodes[n]
                node_block(node, np.int64(node.first), program.operands, program.lookups, nodes, inputs, nodes[n])
        for p in range(program.profiles.size):
            if profile_moves[p]:
                own = program.profiles[p]
                if not program.same_grid[p]:
                    top, periodic = float(own.count) - 1.0, own.flags & PERIODIC
                    place_block(inputs[own.input], own.start, own.inverse_step, own.inverse_turn, top, periodic, j, f)
                own_knots = knots[knots_first[p] : knots_first[p + 1]]
                profile_block(own_knots, j, f, own.scale, profiles[p])
        sum_pairs(program.pairs, opens, profiles, nodes, node_fixed, node_moves, inside, sums)
        for o in range(out.shape[0]):
            own = program.outputs[o]
            sum_terms(program.terms, np.int64(own.first), np.int64(own.count), sums, nodes, part, f)
            out[o, begin : begin + count] = f[:count]
