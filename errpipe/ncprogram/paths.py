"""The wanted path of one motion as the ends of straight segments, in part coordinates."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from errpipe.kernels import nc_paths
from errpipe.ncprogram.blocks import Block
from errpipe.ncprogram.modal import LINEAR, PLANES, ROTARY, Motion

MAX_SEGMENTS = 200_000  # of one block; an arc of 1 m radius within 0.001 mm has 1,000 a turn


def segments(block: Block, motion: Motion, chord_error: float, longest: float) -> tuple[np.ndarray, float]:
    """Ends of the segments after the start, shape (n, 6), mm and deg, NaN where unknown; the chord error, mm.

    Raises DataError for a path of too many segments, for a rotary axis that would turn in the last one only, and for
    one of which it is not known which way round it goes.
    """
    start, end = _row(motion.start), _row(motion.end)
    if motion.centre is not None:
        points, error = _arc(block, motion, start, end, chord_error, longest)
    elif motion.mode == "G0" or np.isnan(start[:3]).any() or np.isnan(end[:3]).any():
        return end[None, :], 0.0
    else:
        points = np.empty((_allowed(block, nc_paths.straight_pieces(start, end, longest)), len(end)))
        nc_paths.straight_points(start, end, len(points), points)
        error = 0.0
    for n, letter in enumerate(ROTARY, len(LINEAR)):
        if len(points) > 1 and np.isnan(start[n]) and block.value(letter) is not None:
            raise block.refused(f"the position of {letter} is not known yet (move it with G0 first)")
        if len(points) > 1 and nc_paths.is_long_way_round(start[n], end[n]):
            why = (
                f"{letter} from {start[n]:g} to {end[n]:g} is the long way round: an axis that counts on takes it, one "
                "that takes the shorter way would only do so in parts (use two blocks of at most 180 deg)"
            )
            raise block.refused(why)
    return points, error


def _arc(
    block: Block, motion: Motion, start: np.ndarray, end: np.ndarray, chord_error: float, longest: float
) -> tuple[np.ndarray, float]:
    assert motion.centre is not None
    first, second, _ = (LINEAR.index(letter) for letter in PLANES[motion.plane])
    where = start, end, *motion.centre, first, second
    shape = nc_paths.arc_shape(*where, motion.mode == "G3", motion.turns, chord_error, longest)
    points = np.empty((_allowed(block, shape[-1]), len(end)))
    nc_paths.arc_points(*where, shape, points)
    return points, nc_paths.chord_error_of(shape)


def _allowed(block: Block, pieces: int) -> int:
    if pieces > MAX_SEGMENTS:
        raise block.refused(f"the path would need {pieces} segments (at most {MAX_SEGMENTS})")
    return pieces


def _row(values: Iterable[float | None]) -> np.ndarray:
    return np.array([np.nan if v is None else v for v in values], dtype=float)
