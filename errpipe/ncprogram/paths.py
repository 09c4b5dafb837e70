"""The wanted path of one motion as the ends of straight segments, in part coordinates."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from errpipe.ncprogram.blocks import Block, refuse
from errpipe.ncprogram.modal import LINEAR, PLANES, ROTARY, Motion

MAX_SEGMENTS = 200_000  # of one block; an arc of 1 m radius within 0.001 mm has 1,000 a turn


def segments(block: Block, motion: Motion, chord_error: float, longest: float) -> tuple[np.ndarray, float]:
    """Ends of the segments after the start, shape (n, 6), mm and deg, NaN where unknown; the chord error, mm.

    Raises DataError for a path of too many segments, and for a rotary axis that would turn in the last one only.
    """
    start, end = _row(motion.start), _row(motion.end)
    if motion.centre is not None:
        points, error = _arc(block, motion, start, end, chord_error, longest)
    elif motion.mode == "G0" or np.isnan(start[:3]).any() or np.isnan(end[:3]).any():
        return end[None, :], 0.0
    else:
        length = float(np.linalg.norm(end[:3] - start[:3]))
        pieces = _allowed(block, max(1, math.ceil(length / longest)))
        share = np.linspace(0.0, 1.0, pieces + 1)[1:, None]
        points, error = start + share * (end - start), 0.0
        points[-1] = end
    for n, letter in enumerate(ROTARY, len(LINEAR)):
        if len(points) > 1 and np.isnan(start[n]) and block.value(letter) is not None:
            raise refuse(block.line, block.source, f"where {letter} stands is not known yet (move it with G0 first)")
    return points, error


def _arc(
    block: Block, motion: Motion, start: np.ndarray, end: np.ndarray, chord_error: float, longest: float
) -> tuple[np.ndarray, float]:
    assert motion.centre is not None
    first, second, through = (LINEAR.index(letter) for letter in PLANES[motion.plane])
    a = math.atan2(start[second] - motion.centre[1], start[first] - motion.centre[0])
    b = math.atan2(end[second] - motion.centre[1], end[first] - motion.centre[0])
    sweep = (b - a) % (2 * math.pi) if motion.mode == "G3" else -((a - b) % (2 * math.pi))
    same = math.hypot(*(end[[first, second]] - start[[first, second]])) < 1e-9
    sweep = (2 * math.pi if motion.mode == "G3" else -2 * math.pi) if same else sweep
    sweep += math.copysign(2 * math.pi * (motion.turns - 1), sweep)
    r0 = math.hypot(start[first] - motion.centre[0], start[second] - motion.centre[1])
    r1 = math.hypot(end[first] - motion.centre[0], end[second] - motion.centre[1])
    widest = 2 * math.acos(max(1 - min(chord_error / max(r0, r1, 1e-9), 1.0), -1.0))
    widest = max(widest, 1e-9)  # rad: the cosine of less is 1 in double precision
    pieces = max(4, math.ceil(abs(sweep) / widest), math.ceil(abs(sweep) * max(r0, r1) / longest))
    share = np.linspace(0.0, 1.0, _allowed(block, pieces) + 1)[1:]
    radius, angle = r0 + share * (r1 - r0), a + share * sweep
    points = start + share[:, None] * (end - start)
    points[:, first] = motion.centre[0] + radius * np.cos(angle)
    points[:, second] = motion.centre[1] + radius * np.sin(angle)
    points[:, through] = start[through] + share * (end[through] - start[through])
    points[-1] = end
    return points, max(r0, r1) * (1 - math.cos(abs(sweep) / pieces / 2))


def _allowed(block: Block, pieces: int) -> int:
    if pieces > MAX_SEGMENTS:
        raise refuse(block.line, block.source, f"the path would need {pieces} segments (at most {MAX_SEGMENTS})")
    return pieces


def _row(values: Iterable[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], dtype=float)
