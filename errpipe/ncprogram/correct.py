"""Rewrite an NC program so that the uncorrected machine cuts the wanted part.

For each wanted tool point p the command c solves c + deviation(c) = p. Lines and arcs are split so that
the straight segments stay within a stated chord error of the wanted path and of the corrected curve.
Directions, units, planes, absolute and incremental, offsets, tool lengths, comments and line numbers stay.

The program streams through: tool points are collected over many blocks, the deviation is asked for all of them at
once, and memory does not grow with the program. Most blocks of a long program are plain straight moves; these
are read by one expression, everything else word by word (`blocks`, `modal`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from errpipe.errors import DataError
from errpipe.ncprogram.blocks import MAX_LINE, Block, parse, refuse
from errpipe.ncprogram.modal import LARGEST_COORDINATE, LINEAR, MM_PER_INCH, ROTARY, Motion, Setup, State, advance
from errpipe.ncprogram.paths import segments
from errpipe.ncprogram.writer import Deviation, Writer

_NUMBER = r"([+-]?(?:\d+\.?\d*|\.\d+))"
# A straight move of X, Y and Z with at most a line number, G0 or G1, and a feed, each word behind at most one blank.
_PLAIN_MOVE = re.compile(
    rf"(N\d+ ?)?(G0?[01](?![\d.]) ?)?(?:X{_NUMBER} ?)?(?:Y{_NUMBER} ?)?(?:Z{_NUMBER} ?)?(F{_NUMBER})?", re.ASCII
)


@dataclass(frozen=True)
class Summary:
    """What was done: largest correction in mm, blocks in and out, largest chord error in mm."""

    blocks_in: int
    blocks_out: int
    moves: int
    largest_correction: float
    largest_chord_error: float


def correct(text: str, deviation: Deviation, setup: Setup, **how: Any) -> tuple[str, Summary]:
    """`rewrite` for a program in one text: the corrected program and what was done."""
    parts: list[str] = []
    lines = text.split("\n")
    done = rewrite(lines[:-1] if lines[-1] == "" else lines, parts.append, deviation, setup, **how)
    return "".join(parts), done


def rewrite(
    lines: Iterable[str],
    write: Callable[[str], object],
    deviation: Deviation,
    setup: Setup,
    *,
    chord_error: float = 0.001,
    longest: float = 25.0,
    decimals: int = 4,
) -> Summary:
    """Write the corrected program, piece by piece; returns what was done.

    lines: without their line feeds. chord_error: largest distance between a segment and the curve it stands for, mm.
    longest: no segment longer than this, mm (the correction is looked at that often). decimals: of a mm; two more of
    an inch. Raises DataError naming the first line that is not understood: what was written is then worth nothing.
    """
    reader = _Reader(setup, Writer(write, deviation, setup, decimals), chord_error, longest)
    number = 0
    for number, line in enumerate(lines, 1):
        source = line.removesuffix("\r")
        try:
            if not reader.plain_move(number, source):
                reader.block(number, source)
        except DataError:
            reader.writer.flush()  # a refusal further up comes first
            raise
    reader.writer.flush()
    done = reader.writer
    return Summary(number, done.blocks, reader.moves, done.largest, reader.chord_error)


class _Reader:
    """Reads lines, keeps the modal state, hands tool points and all other lines to the writer."""

    def __init__(self, setup: Setup, writer: Writer, chord_error: float, longest: float):
        self.setup, self.writer, self.limits = setup, writer, (chord_error, longest)
        self.longest_squared = longest * longest
        self.state = State(position=_start(setup))
        self.at: list[float | None] = list(self.state.position)  # of the state, kept apart because it changes often
        self.moves, self.chord_error = 0, 0.0
        self.writer.take_over(self.state)

    def plain_move(self, number: int, source: str) -> bool:
        """Read a plain straight move from a known place; False where the line is anything else."""
        match = _PLAIN_MOVE.fullmatch(source) if len(source) <= MAX_LINE else None
        if match is None or None in self.at[:3] or self.state.ended:
            return False
        label, code, x, y, z, feed, _ = match.groups()
        state, at = self.state, self.at
        motion = state.motion if code is None else "G1" if "1" in code else "G0"
        if (x is None and y is None and z is None) or motion not in ("G0", "G1"):
            return False
        scale = MM_PER_INCH if state.inch else 1.0
        x0, y0, z0 = end = at[:3]
        for n, word in ((0, x), (1, y), (2, z)):
            if word is not None:
                value = float(word)
                if not -LARGEST_COORDINATE <= value <= LARGEST_COORDINATE:
                    return False
                end[n] = value * scale if state.absolute else end[n] + value * scale  # type: ignore[operator]
        if motion == "G1":
            away = (end[0] - x0) ** 2 + (end[1] - y0) ** 2 + (end[2] - z0) ** 2  # type: ignore[operator]
            if away > self.longest_squared:
                return False
        if code is not None and motion != state.motion:
            self.state = replace(state, motion=motion)
        at[:3] = end
        prefix = (label or "") + (code or "") + (feed or "")
        if (label and (code or feed)) or (code and feed):
            prefix = " ".join(part.rstrip() for part in (label, code, feed) if part)
        self.writer.point(end, (x is not None, y is not None, z is not None), prefix.rstrip(), number, source)
        self.moves += 1
        return True

    def block(self, number: int, source: str) -> None:
        """Read any line word by word. Raises DataError for what is not understood."""
        block = parse(number, source)
        before = replace(self.state, position=tuple(self.at))
        self.state, motion = advance(block, before, self.setup)
        self.at = list(self.state.position)
        if block.delete and self.state != before:
            raise refuse(number, source, "a motion or mode that a block delete switch may skip")
        self.writer.take_over(self.state)
        if motion is None:
            self.writer.line(source)
            return
        points, error = segments(block, motion, *self.limits)
        self.chord_error = max(self.chord_error, error)
        self._refuse_unknown(block, points)
        self.writer.path(block, points, _prefix(block, motion))
        self.moves += 1

    @staticmethod
    def _refuse_unknown(block: Block, points: np.ndarray) -> None:
        missing = [LINEAR[n] for n in range(3) if np.isnan(points[:, n]).any()]
        if missing:
            where = f"where {' and '.join(missing)} stands is not known yet (say --start x,y,z)"
            raise refuse(block.line, block.source, where)


def _prefix(block: Block, motion: Motion) -> str:
    """The block's line number and all its words but those of the path."""
    kept = [w.text for w in block.words if w.letter not in "XYZABCIJKRP" and w.code not in ("G2", "G3")]
    straight = "G1" if motion.mode in ("G2", "G3") else ""
    return " ".join(part for part in (block.number, *kept, straight) if part)


def _start(setup: Setup) -> tuple[float | None, ...]:
    if setup.start is None:
        return (None,) * (len(LINEAR) + len(ROTARY))
    zero = setup.offsets.get("G54", (0.0, 0.0, 0.0))
    if not all(math.isfinite(v) for v in (*setup.start, *zero)):
        raise DataError("the start or an offset is not a number")
    return (*(s - o for s, o in zip(setup.start, zero, strict=True)), None, None, None)
