"""Rewrite an NC program so that the uncorrected machine cuts the wanted part.

For each wanted tool point p the command c solves c + deviation(c) = p. Lines and arcs are split so that
the straight segments stay within a stated chord error of the wanted path and of the corrected curve.
Directions, units, planes, absolute and incremental, offsets, tool lengths, comments and line numbers stay.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from errpipe.errors import DataError
from errpipe.ncprogram.blocks import Block, parse, refuse
from errpipe.ncprogram.modal import LINEAR, MM_PER_INCH, PLANES, ROTARY, Motion, Setup, State, advance, offset_of

# deviation(points, tool_length): machine coordinates, shape (n, 3) mm -> deviation of the tool point, (n, 3) mm
Deviation = Callable[[np.ndarray, float], np.ndarray]

SETTLE = 4  # fixed-point steps; each gains a factor of the deviation's slope, about 1e4
PATH_WORDS = set("XYZABCIJKRP")


@dataclass(frozen=True)
class Summary:
    """What was done: largest correction in mm, blocks in and out, largest chord error in mm."""

    blocks_in: int
    blocks_out: int
    moves: int
    largest_correction: float
    largest_chord_error: float


@dataclass
class _Writer:
    """Emitted position per axis in program units, so that increments carry no rounding forward."""

    decimals: int
    emitted: list[float | None]


def correct(
    text: str,
    deviation: Deviation,
    setup: Setup,
    *,
    chord_error: float = 0.001,
    longest: float = 25.0,
    decimals: int = 4,
) -> tuple[str, Summary]:
    """Corrected program and what was done.

    chord_error: largest distance between a segment and the curve it stands for, mm. longest: no segment
    longer than this, mm (the correction is looked at that often). decimals: of a mm; two more of an inch.
    Raises DataError naming the first line that is not understood.
    """
    state = State(position=_start(setup))
    writer = _Writer(decimals, list(state.position))
    out: list[str] = []
    moves, largest, chord = 0, 0.0, 0.0
    lines = text.splitlines()
    for number, source in enumerate(lines, 1):
        block = parse(number, source)
        before = state
        state, motion = advance(block, state, setup)
        if block.delete and state != before:
            raise refuse(number, source, "a motion or mode that a block delete switch may skip")
        if motion is None:
            out.append(source)
            writer.emitted = _follow(writer.emitted, before, state, setup)
            continue
        points, segment_error = _path(block, motion, chord_error, longest)
        commands = _commands(block, points, deviation, state, setup)
        largest = max(largest, float(np.nanmax(np.abs(commands[:, :3] - points[:, :3]))))
        chord = max(chord, segment_error)
        out.extend(_emit(block, motion, commands, state, writer))
        moves += 1
    return "\n".join(out) + "\n", Summary(len(lines), len(out), moves, largest, chord)


def _start(setup: Setup) -> tuple[float | None, ...]:
    if setup.start is None:
        return (None,) * 6
    zero = setup.offsets.get("G54", (0.0, 0.0, 0.0))
    return (*(s - o for s, o in zip(setup.start, zero, strict=True)), None, None, None)


def _follow(emitted: list[float | None], before: State, after: State, setup: Setup) -> list[float | None]:
    """What was emitted, told in the coordinates now in force (offset, tool length, unit)."""
    if (before.offset, before.tool_length, before.inch) == (after.offset, after.tool_length, after.inch):
        return emitted
    old, new = setup.offsets.get(before.offset), setup.offsets.get(after.offset)
    out = list(emitted)
    for n in range(3):
        here = out[n]
        if here is None or old is None or new is None:
            out[n] = None
            continue
        mm = here * (MM_PER_INCH if before.inch else 1.0) + old[n] - new[n]
        mm += before.tool_length - after.tool_length if n == 2 else 0.0
        out[n] = mm / (MM_PER_INCH if after.inch else 1.0)
    return out


# ---------------------------------------------------------------- the wanted path


def _path(block: Block, motion: Motion, chord_error: float, longest: float) -> tuple[np.ndarray, float]:
    """Ends of the segments after the start, part coordinates, shape (n, 6), NaN where unknown; the chord error."""
    end = _row(motion.end)
    if motion.centre is not None:
        return _arc_path(motion, chord_error, longest)
    start = _row(motion.start)
    if motion.mode == "G0" or np.isnan(start[:3]).any() or np.isnan(end[:3]).any():
        return end[None, :], 0.0
    length = float(np.linalg.norm(end[:3] - start[:3]))
    pieces = max(1, math.ceil(length / longest))
    share = np.linspace(0.0, 1.0, pieces + 1)[1:, None]
    points = start + share * (end - start)
    points[-1] = end
    return points, 0.0


def _arc_path(motion: Motion, chord_error: float, longest: float) -> tuple[np.ndarray, float]:
    assert motion.centre is not None
    first, second, through = (LINEAR.index(letter) for letter in PLANES[motion.plane])
    start, end = _row(motion.start), _row(motion.end)
    a = math.atan2(start[second] - motion.centre[1], start[first] - motion.centre[0])
    b = math.atan2(end[second] - motion.centre[1], end[first] - motion.centre[0])
    sweep = (b - a) % (2 * math.pi) if motion.mode == "G3" else -((a - b) % (2 * math.pi))
    same = math.hypot(*(end[[first, second]] - start[[first, second]])) < 1e-9
    sweep = (2 * math.pi if motion.mode == "G3" else -2 * math.pi) if same else sweep
    sweep += math.copysign(2 * math.pi * (motion.turns - 1), sweep)
    r0 = math.hypot(start[first] - motion.centre[0], start[second] - motion.centre[1])
    r1 = math.hypot(end[first] - motion.centre[0], end[second] - motion.centre[1])
    widest = 2 * math.acos(max(1 - min(chord_error / max(r0, r1, 1e-9), 1.0), -1.0))
    pieces = max(4, math.ceil(abs(sweep) / widest), math.ceil(abs(sweep) * max(r0, r1) / longest))
    share = np.linspace(0.0, 1.0, pieces + 1)[1:]
    radius, angle = r0 + share * (r1 - r0), a + share * sweep
    points = start + share[:, None] * (end - start)
    points[:, first] = motion.centre[0] + radius * np.cos(angle)
    points[:, second] = motion.centre[1] + radius * np.sin(angle)
    points[:, through] = start[through] + share * (end[through] - start[through])
    points[-1] = end
    return points, max(r0, r1) * (1 - math.cos(abs(sweep) / pieces / 2))


def _row(values: Iterable[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], dtype=float)


# ---------------------------------------------------------------- the commands


def _commands(block: Block, points: np.ndarray, deviation: Deviation, state: State, setup: Setup) -> np.ndarray:
    """Commands in part coordinates whose tool points are `points`. Raises DataError outside the table."""
    zero = np.array(offset_of(block, setup, state.offset))
    carried = np.array([0.0, 0.0, state.tool_length])
    if np.isnan(points[:, :3]).any():
        missing = [LINEAR[n] for n in range(3) if np.isnan(points[:, n]).any()]
        raise refuse(
            block.line, block.source, f"where {' and '.join(missing)} stands is not known yet (say --start x,y,z)"
        )
    wanted = points[:, :3] + zero + carried
    command = wanted.copy()
    for _ in range(SETTLE):
        command = wanted - deviation(command, state.tool_length)
        if not np.isfinite(command).all():
            raise DataError(f"line {block.line}: the table has no value here: {block.source.strip()!r}")
    return np.column_stack([command - zero - carried, points[:, 3:]])


def _emit(block: Block, motion: Motion, commands: np.ndarray, state: State, writer: _Writer) -> Iterable[str]:
    """The block's first segment with everything else the line said, then the further segments."""
    scale = np.array([MM_PER_INCH if state.inch else 1.0] * 3 + [1.0] * 3)
    decimals = writer.decimals + (2 if state.inch else 0)
    kept = [w.text for w in block.words if w.letter not in PATH_WORDS and w.code not in ("G2", "G3")]
    straight = "G1" if motion.mode in ("G2", "G3") else ""
    for n, command in enumerate(commands / scale):
        words = _coordinates(block, command, state, writer, decimals)
        parts = [block.number, *kept, straight, words, *block.comments] if n == 0 else [words]
        text = " ".join(part for part in parts if part)
        if text:
            yield text


def _coordinates(block: Block, command: np.ndarray, state: State, writer: _Writer, decimals: int) -> str:
    words = []
    for n, letter in enumerate(LINEAR + ROTARY):
        if np.isnan(command[n]):
            continue
        last = writer.emitted[n]
        value = round(float(command[n]), decimals) + 0.0
        if letter in ROTARY and block.value(letter) is None:
            continue
        if last is not None and value == last and block.value(letter) is None:
            continue
        shown = value if state.absolute or last is None else round(value - last, decimals) + 0.0
        words.append(f"{letter}{shown:.{decimals}f}")
        writer.emitted[n] = value
    return " ".join(words)
