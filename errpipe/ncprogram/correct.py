"""Rewrite an NC program so that the uncorrected machine cuts the wanted part.

For each wanted tool point p the command c solves c + deviation(c) = p. Lines and arcs are split so that
the straight segments stay within a stated chord error of the wanted path and of the corrected curve.
Directions, units, planes, absolute and incremental, offsets, tool lengths, comments and line numbers stay. A rapid move
while an axis stands at an unknown place (at the start, behind a tool change) stays too: its end is unknown.

The program streams through: tool points are collected over many blocks, the deviation is evaluated for all of them at
once, and memory does not grow with the program. Most blocks of a long program are plain motions; these are read in
bulk (`kernels.nc_blocks`), everything else word by word (`blocks`, `modal`). Both ways give the same bytes.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from errpipe.errors import DataError
from errpipe.kernels import nc_blocks, nc_paths
from errpipe.ncprogram import modal
from errpipe.ncprogram.blocks import MAX_LINE, Block, parse, refuse
from errpipe.ncprogram.modal import LINEAR, PLANES, ROTARY, Motion
from errpipe.ncprogram.writer import Deviation, Writer

MAX_SEGMENTS = 200_000  # of one block; an arc of 1 m radius within 0.001 mm has 1,000 a turn

MAX_LINE_BYTES = 16_385  # looked at; a line of 4096 characters is refused, and a character has at most 4 bytes


@dataclass(frozen=True)
class Summary:
    """What was done: largest correction in mm, blocks in and out, largest chord error in mm."""

    blocks_in: int
    blocks_out: int
    moves: int
    largest_correction: float
    largest_chord_error: float


def rewrite(
    chunks: Iterable[bytes],
    write: Callable[[bytes], object],
    deviation: Deviation,
    setup: modal.Setup,
    *,
    chord_error: float = 0.001,
    longest: float = 25.0,
    decimals: int = 4,
    bulk: bool = True,
) -> Summary:
    """Write the corrected program, piece by piece; returns what was done.

    chunks: of whole lines in UTF-8. chord_error: largest distance between a segment and the curve it stands for, mm.
    longest: no segment longer than this, mm (the correction is looked at that often). decimals: of a mm; two more of
    an inch. bulk: False reads every block word by word. Raises DataError naming the first line that is not
    understood: what was written is then worth nothing.
    """
    reader = _Reader(setup, Writer(write, deviation, setup, decimals), chord_error, longest, bulk)
    for chunk in chunks:
        reader.chunk(chunk)
    reader.writer.flush()
    done, cursor = reader.writer, reader.cursor
    return Summary(
        int(cursor[nc_blocks.LINE]) - 1, done.blocks, int(cursor[nc_blocks.MOVES]), done.largest, reader.chord_error
    )


class _Reader:
    """Reads blocks, keeps the modal state, hands tool points and all other lines to the writer.

    here: (6,) where the axes stand, mm and deg, NaN where that is not known; the state's own position may be older.
    """

    def __init__(self, setup: modal.Setup, writer: Writer, chord_error: float, longest: float, bulk: bool):
        self.setup, self.writer, self.limits, self.bulk = setup, writer, (chord_error, longest), bulk
        self.state = modal.State(position=_start(setup))
        self.here = np.array(self.state.position, dtype=float)
        self.cursor = np.array([0, 1, 0, 0, -1, 0], dtype=np.int64)
        self.room = np.empty(len(nc_blocks.LETTERS)), np.empty(len(self.here))
        self.chord_error = 0.0
        self.mode = self._mode()
        self.writer.set_modal_state(self.state)

    def chunk(self, chunk: bytes) -> None:
        """Read whole lines. Raises DataError for the first that is not understood or where the table has no value."""
        first = int(self.cursor[nc_blocks.LINE])
        self.writer.begin(chunk, lambda number: _source(chunk.split(b"\n")[number - first]))
        data, self.cursor[nc_blocks.POSITION] = np.frombuffer(chunk, dtype=np.uint8), 0
        while (at := int(self.cursor[nc_blocks.POSITION])) < len(chunk):
            if self.bulk and not self.state.ended and self._plain_blocks(data):
                self.writer.flush()
            elif int(self.cursor[nc_blocks.POSITION]) == at:
                end = chunk.find(b"\n", at)
                end = len(chunk) if end < 0 else end
                try:
                    self._block(int(self.cursor[nc_blocks.LINE]), _source(chunk[at:end]))
                except DataError:
                    self.writer.flush()  # a refusal further up comes first
                    raise
                self.cursor[nc_blocks.POSITION] = end + 1
                self.cursor[nc_blocks.LINE] += 1
        self.writer.flush()

    def _plain_blocks(self, data: np.ndarray) -> bool:
        """Read plain blocks as far as they go; True where the writer must make room for more."""
        cursor, writer = self.cursor, self.writer
        cursor[nc_blocks.ROW], cursor[nc_blocks.TEXT] = before = writer.used, writer.texts
        full, error = nc_blocks.read(data, cursor, self.here, self.mode, writer.rows, *self.room)
        _, _, writer.used, writer.texts, motion, _ = cursor.tolist()
        self.chord_error = max(self.chord_error, error)
        if before[0] != writer.used and modal.MOTIONS[motion] != self.state.motion:
            self.state = replace(self.state, motion=modal.MOTIONS[motion])
        return full and writer.used > 0

    def _mode(self) -> nc_blocks.Mode:
        """The modal state as the bulk reader takes it."""
        state, (chord_error, longest) = self.state, self.limits
        self.cursor[nc_blocks.MOTION] = modal.MOTIONS.index(state.motion) if state.motion else -1
        first, second, through = (modal.LINEAR.index(letter) for letter in modal.PLANES[state.plane])
        return nc_blocks.Mode(
            scale=modal.MM_PER_INCH if state.inch else 1.0,
            absolute=state.absolute,
            first=first,
            second=second,
            through=through,
            named=state.plane_set,
            centres=not state.arc_absolute,
            longest=float(longest),
            chord_error=float(chord_error),
            segments=MAX_SEGMENTS,
            coordinate=modal.LARGEST_COORDINATE,
            radius=modal.LARGEST_RADIUS,
            line=MAX_LINE,
        )

    def _block(self, number: int, source: str) -> None:
        """Read any line word by word. Raises DataError for what is not understood."""
        block = parse(number, source)
        before = replace(self.state, position=tuple(None if v != v else v for v in self.here.tolist()))
        self.state, motion = modal.advance(block, before, self.setup)
        if block.delete and (motion is not None or self.state != before):
            raise refuse(number, source, "a motion or mode that a block delete switch may skip")
        self.here[:] = [math.nan if v is None else v for v in self.state.position]
        self.mode = self._mode()
        self.writer.set_modal_state(self.state)
        if motion is None:
            self.writer.line(source)
            return
        if motion.mode == "G0" and None in motion.end[:3]:
            self.writer.uncorrected(block)
            return
        points, error = segments(block, motion, *self.limits)
        self.chord_error = max(self.chord_error, error)
        self._refuse_unknown(block, points)
        self._refuse_stop_between(block, points)
        self.writer.path(block, points, _prefix(block, motion))
        if stops := [w.text for w in block.words if w.code in modal.STOPS_M]:
            self.writer.line(" ".join(stops))
        self.cursor[nc_blocks.MOVES] += 1

    @staticmethod
    def _refuse_unknown(block: Block, points: np.ndarray) -> None:
        missing = [modal.LINEAR[n] for n in range(3) if np.isnan(points[:, n]).any()]
        if missing:
            where = (
                f"the position of {' and '.join(missing)} is not known at the start or after a tool change or "
                "reference point (move it with G0 first, or give --start x,y,z)"
            )
            raise block.refused(where)

    @staticmethod
    def _refuse_stop_between(block: Block, points: np.ndarray) -> None:
        stops = modal.OFF_M & set(block.codes("M"))
        if stops and len(points) > 1:
            why = (
                f"{sorted(stops)[0]} with a motion of {len(points)} segments: controls differ in whether it acts "
                "before or after the motion (put it on a separate line)"
            )
            raise block.refused(why)


def _source(raw: bytes) -> str:
    """The text of a line. Raises DataError if it is not one."""
    try:
        return raw[:MAX_LINE_BYTES].decode().removesuffix("\r")
    except UnicodeDecodeError as err:
        raise DataError(f"not UTF-8 text (byte 0x{err.object[err.start]:02x})") from None


def _prefix(block: Block, motion: modal.Motion) -> str:
    """The block's line number and all its words but those of the path and what stops the program behind it."""
    left_out = {"G2", "G3"} | modal.STOPS_M
    kept = [w.text for w in block.words if w.letter not in "XYZABCIJKRP" and w.code not in left_out]
    straight = "G1" if motion.mode in ("G2", "G3") else ""
    return " ".join(part for part in (block.number, *kept, straight) if part)


def _start(setup: modal.Setup) -> tuple[float | None, ...]:
    if setup.start is None:
        return (None,) * (len(modal.LINEAR) + len(modal.ROTARY))
    zero = setup.offsets.get("G54", (0.0, 0.0, 0.0))
    if not all(math.isfinite(v) for v in (*setup.start, *zero)):
        raise DataError("the start or an offset is not a number")
    return (*(s - o for s, o in zip(setup.start, zero, strict=True)), None, None, None)


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
