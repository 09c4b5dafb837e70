"""A measuring plan as an NC program (RS-274).

Socket and tool are placed with the tool retracted. The bar is attached where it is measured first (its length is
stated) and detached before the tool leaves: no move with a bar attached leaves the bar's reach (`clearance`). Without
a bar one axis moves at a time: rotary axes, the other linear ones, then the axis that retracts the tool.
"""

from __future__ import annotations

import re

import numpy as np

from errpipe.errors import DataError
from errpipe.kinematics.clearance import approach, retraction
from errpipe.kinematics.plan import Block, Plan, move_length

AXIS_WORDS = "XYZABCUVW"  # RS-274/NGC
SET_UP = (
    "G17 G21 G40 G49 G54 G80 G90 G94",
    "M5",
    "M9",
    "M0 (MSG, positions are machine coordinates: set G54 and all other offsets and rotations to zero)",
    "(only bar, ball, spindle nose and socket are checked for collisions, not table, fixture or guards)",
)


def program(plan: Plan) -> str:
    """The program of a plan: stops to place, attach and detach, moves, dwells to read the bar.

    Raises DataError if an axis has no word of its own: `X2` before `100` would be X2100.
    """
    unknown = sorted(a for a in plan.chain.axes if len(a) != 1 or a not in AXIS_WORDS)
    if unknown:
        allowed = ", ".join(AXIS_WORDS)
        raise DataError(
            f"{plan.chain.machine.name}: axis {unknown[0]} is no word of an NC program (allowed: {allowed})"
        )
    name = re.sub(r"[^ -'*-~]", "_", plan.chain.machine.name)
    lines = ["%", f"(measuring plan for {name}: {len(plan.blocks)} blocks, {plan.minutes:.0f} min)", *SET_UP]
    low, high = plan.equipment.reach
    lines.append(_zone_of_sockets(plan))
    lines += [f"M0 (MSG, for a bar of {low:g} to {high:g} mm: no other)", _retract(plan)]
    before: Block | None = None
    for number, b in enumerate(plan.blocks, start=1):
        lines += _stops_to_place(b, before)
        lines += _approach(plan, b, before)
        lines.append(f"M0 (MSG, attach the bar: {np.linalg.norm(b.clearance.bar(b.q[:1])):.3f} mm, block {number})")
        lines += _measured(plan, b)
        lines += [f"M0 (MSG, detach the bar, block {number})", _retract(plan)]
        before = b
    return "\n".join([*lines, "M2", "%"]) + "\n"


def _zone_of_sockets(plan: Plan) -> str:
    """Where the sockets lie: a table, whose shape is not known, may be above the lowest of them."""
    ends = [np.min([b.socket for b in plan.blocks], axis=0), np.max([b.socket for b in plan.blocks], axis=0)]
    zone = " ".join(f"{letter}{low:.3f} to {letter}{high:.3f}" for letter, low, high in zip("XYZ", *ends, strict=True))
    return f"M0 (MSG, sockets lie from {zone} of the workpiece: compare with the table, which no machine file states)"


def _stops_to_place(b: Block, before: Block | None) -> list[str]:
    lines = []
    if before is None or b.socket != before.socket:
        x, y, z = b.socket
        lines.append(f"M0 (MSG, place the socket at X{x:.3f} Y{y:.3f} Z{z:.3f} of the workpiece)")
    if before is None or (b.socket, b.length, b.offset) != (before.socket, before.length, before.offset):
        x, y, z = b.offset
        lines.append(f"M0 (MSG, ball at length {b.length:.3f}, offset {x:.3f} {y:.3f} {z:.3f})")
    return lines


def _retract(plan: Plan) -> str:
    axis, end = retraction(plan.chain)
    return f"G1 {_word(plan, axis, end)} F{plan.equipment.approach_feed:.0f}"


def _approach(plan: Plan, b: Block, before: Block | None) -> list[str]:
    """From the retracted position to the first of a block; from anywhere for the first block: every axis is named."""
    feed = f"F{plan.equipment.approach_feed:.0f}"
    if before is None:
        moves = approach(plan.chain, np.full(len(plan.chain.axes), np.nan), b.q[0])
        return [f"G1 {_word(plan, i, end)} {feed}" for i, end in moves]
    at = before.clearance.retracted(before.q[-1])
    moves, clear = approach(plan.chain, at, b.q[0]), True
    for i, end in moves:
        reached = at.copy()
        reached[i] = end
        clear = clear and bool(b.clearance.is_clear(b.clearance.move(at, reached)).all())
        at = reached
    warning = [] if clear else ["M0 (MSG, the way to the next block passes the socket: jog there, one axis at a time)"]
    return warning + [f"G1 {_word(plan, i, end)} {feed}" for i, end in moves]


def _measured(plan: Plan, b: Block) -> list[str]:
    """Positions of a block, with the bar attached.

    F counts the linear axes of a move, or the rotary ones if none moves (LinuxCNC, G94); it is lower than the plan's
    feed where a rotary axis takes longer, so that ball and rotary axes are never faster.
    """
    dwell = f"G4 P{plan.equipment.dwell:.1f}"
    kinds = np.array([plan.chain.machine.axes[a].kind == "linear" for a in plan.chain.axes])
    lines = [dwell]
    for i in range(1, len(b.q)):
        step = b.q[i] - b.q[i - 1]
        counted = float(np.linalg.norm(step[kinds]) or np.linalg.norm(step))
        feed = plan.equipment.feed * min(1.0, counted / move_length(b, i))
        words = " ".join(_word(plan, a, v) for a, v in enumerate(b.q[i]))
        lines += [f"G1 {words} F{max(feed, 1.0):.0f}", dwell]
    return lines


def _word(plan: Plan, axis: int, value: float) -> str:
    """The word of an axis; never beyond its travel by rounding."""
    low, high = plan.chain.travel[axis]
    text = f"{value:.4f}"
    if not low <= float(text) <= high:
        text = f"{value + (1e-4 if float(text) < low else -1e-4):.4f}"
    return plan.chain.axes[axis] + text
