"""Drivers of a table: its numbered operations in order, to the bit as in the reference evaluator."""

from __future__ import annotations

import numpy as np

from errpipe.kernels import bare_kernel
from errpipe.kernels import table_codes as codes
from errpipe.kernels.elementary import exp, moved_side, on_lines, power


@bare_kernel
def undo_outlier(own, x, way, threshold, started):
    """Undo the effect of the last reading if it is a single outlier between two that agree, or a single direction."""
    if not started:
        own.last = own.before = x
    moved, away = x - own.last, x - own.before
    far = moved > threshold or -moved > threshold
    agrees = not (away > threshold or -away > threshold)
    if started and agrees and (own.changed != 0 or (own.departed != 0 and far)):
        own.value, own.memory = own.kept_value, own.kept_memory
        far = False
    own.kept_value, own.kept_memory = own.value, own.memory
    own.departed = 1 if own.steady != 0 and far else 0
    own.steady = 0 if far else 1
    own.changed = 1 if way != 0 and way != own.stated else 0
    own.stated = way
    own.before, own.last = own.last, x


@bare_kernel
def is_ready(node, operands, state, inputs):
    """Whether everything below a node has had an accepted reading."""
    if node.op == codes.INPUT:
        return inputs[node.other].usable != 0
    below = True
    begin = np.int64(node.first)
    for k in range(begin, begin + node.count):
        below = below and state[operands[k].number].ready != 0
    return below


@bare_kernel
def lag(own, node, u, dt, replay, started):
    """First-order lag of an operand that is held over the cycle; replaying, dt is the time since the row before."""
    before, y = own.memory, own.value
    own.memory = u
    if not started:
        return 0.0 if node.flags & codes.START_ZERO else u
    if replay:
        alpha = exp(-(dt / (node.a if before >= y else node.b)))
    else:
        alpha = node.c if before >= y else node.d
    return before + (y - before) * alpha


@bare_kernel
def approach(own, node, x, side, started):
    """What comes near the side, +1 or -1, exponentially over the way an axis has moved to x."""
    way = x - own.memory
    own.memory = x
    if way < 0.0:
        way = -way
    if not started:
        return side
    return side - (side - own.value) * exp(-(way / node.a)) if way > 0.0 else own.value


@bare_kernel
def run_nodes(which, nodes, operands, lookups, state, inputs, common, dt, replay, recalls):
    """Run nodes in order; what is not finite counts as 0. recalls: single readings are undone. Returns status bits."""
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
        if op == codes.INPUT:
            u = inputs[node.other].value
        elif op == codes.AFFINE:
            u = node.a
            for k in range(begin, begin + node.count):
                u = u + operands[k].weight * state[operands[k].number].value
        elif op == codes.PRODUCT:
            for k in range(begin + 1, begin + node.count):
                u = u * state[operands[k].number].value
        elif op == codes.LAG:
            u = lag(own, node, u, dt, replay, started)
        elif op == codes.FIRST:
            u = own.value if started else u
        elif op == codes.CONSTANT:
            u = node.a
        elif op == codes.POWER:
            u = power(u, node.a)
        elif op == codes.CLIP:
            u = node.a if u < node.a else node.b if u > node.b else u
        elif op == codes.SWITCH:
            u = 1.0 if u >= node.a else 0.0 if u <= node.b else own.value
        elif op == codes.DIRECTION:
            known = 0.0
            if node.count > 1:
                known = state[operands[begin + 1].number].value
            if not started:
                own.value, own.memory = node.b, u
            if recalls:
                undo_outlier(own, u, 1 if known > 0.0 else -1 if known < 0.0 else 0, node.a, started)
            u, own.memory = moved_side(u, known, own.value, own.memory, node.a)
        elif op == codes.APPROACH:
            if recalls:
                undo_outlier(own, u, 0, node.b, started)
            u = approach(own, node, u, state[operands[begin + 1].number].value, started)
        else:
            u = on_lines(lookups, node.other, np.int64(node.others) - 1, (u - node.a) * node.c)
        if not (u >= -codes.LARGEST and u <= codes.LARGEST):
            u = 0.0
            status |= codes.NOT_FINITE
        own.value = u
    return status
