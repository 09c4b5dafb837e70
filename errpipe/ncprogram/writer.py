"""From tool points to corrected blocks: the deviation is evaluated for thousands of points at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.errors import DataError
from errpipe.kernels import nc_blocks
from errpipe.ncprogram.blocks import Block, refuse
from errpipe.ncprogram.modal import LINEAR, MM_PER_INCH, ROTARY, Setup, State, offset_of

# deviation(points, tool_length): machine coordinates, shape (n, 3) mm -> deviation of the tool point, (n, 3) mm
Deviation = Callable[[np.ndarray, float], np.ndarray]

ITERATIONS = 4  # fixed-point steps; each gains a factor of the deviation's slope, about 1e4
MAX_POINTS = 8_000  # held at a time: their arrays stay in the cache; 20,000 cost a tenth more, 50,000 a quarter
FARTHEST = 1e9  # mm; more has no decimals left to write in double precision. Increments can add up to it.
_AXES = LINEAR + ROTARY
_BITS = 1 << np.arange(len(_AXES))


class Writer:
    """Collects tool points and lines in their order; writes them corrected.

    emitted: position per axis as last written, in program units, so that increments carry no rounding forward.
    rows: the tool points to come, of which `used` are taken, with `texts` bytes of text.
    """

    def __init__(self, write: Callable[[bytes], object], deviation: Deviation, setup: Setup, decimals: int):
        self.write, self.deviation, self.setup, self.decimals = write, deviation, setup, decimals
        self.emitted: list[float | None] | None = None
        self.state = State()
        self.blocks, self.largest = 0, 0.0
        self.lines: list[tuple[int, bytes]] = []  # (points before it, line that stays as it is)
        self.source_of: Callable[[int], str] = str
        self.rows = _allocated(MAX_POINTS, 0)
        self.used = self.texts = 0

    def begin(self, chunk: bytes, source_of: Callable[[int], str]) -> None:
        """The next lines come from here. source_of: the text of a line by its number, for refusals."""
        self.flush()
        self.source_of = source_of
        # Leading words gain a blank where they had none, and a G1 in place of an arc that is in force.
        if self.rows.bytes.size < 2 * len(chunk):
            self.rows = self.rows._replace(bytes=np.empty(2 * len(chunk) + 10_000, dtype=np.uint8))

    def set_modal_state(self, state: State) -> None:
        """The modal state in which the following points are meant."""
        if self.emitted is None:
            self.emitted = list(state.position)
        old = self.state
        forgotten = [n for n, place in enumerate(state.position) if place is None and self.emitted[n] is not None]
        if forgotten or _written_in(state) != _written_in(old):
            self.flush()
            self.emitted = _moved(self.emitted, old, state, self.setup)
            for n in forgotten:
                self.emitted[n] = None
        self.state = state

    def line(self, source: str) -> None:
        """A line that stays as it is."""
        self.lines.append((self.used, source.encode() + b"\n"))

    def uncorrected(self, block: Block) -> None:
        """A rapid move to a place of which only some coordinates are known: it stays as it is."""
        self.flush()
        self.line(block.source)
        assert self.emitted is not None
        for n, letter in enumerate(_AXES):
            given, before = block.value(letter), self.emitted[n]
            if given is not None:
                self.emitted[n] = given if self.state.absolute or before is None else before + given

    def path(self, block: Block, points: np.ndarray, prefix: str) -> None:
        """The tool points of a block, shape (n, 6), NaN for a rotary axis that is not known."""
        if self.used and self.used + len(points) > len(self.rows.points):
            self.flush()
        if len(points) > len(self.rows.points):
            self.rows = _allocated(len(points), self.rows.bytes.size)
        rows, own = self.rows, slice(self.used, self.used + len(points))
        leading, comment = prefix.encode(), " ".join(block.comments).strip().encode()
        middle, end = self.texts + len(leading), self.texts + len(leading) + len(comment)
        rows.bytes[self.texts : end] = np.frombuffer(leading + comment, dtype=np.uint8)
        rows.points[own], rows.number[own], rows.text[own] = points, block.line, 0
        rows.given[own] = sum(1 << n for n, letter in enumerate(_AXES) if block.has(letter))
        rows.text[self.used] = self.texts, middle, end
        self.used, self.texts = own.stop, end

    def flush(self) -> None:
        """Write all that was collected. Raises DataError if the table has no value."""
        text, ends = self._moves() if self.used else (b"", [])
        out, done = [], 0
        for before, line in self.lines:
            upto = ends[before - 1] if before else 0
            out += [text[done:upto], line]
            done = upto
        self.blocks += len(self.lines)
        if out or text:
            self.write(b"".join([*out, text[done:]]))
        self.lines, self.used, self.texts = [], 0, 0

    def _moves(self) -> tuple[bytes, list[int]]:
        """The lines of all points (none where nothing is left to write), and where the line of each ends."""
        assert self.emitted is not None
        points, given = self.rows.points[: self.used], self.rows.given[: self.used]
        scale, decimals = (MM_PER_INCH, self.decimals + 2) if self.state.inch else (1.0, self.decimals)
        last = np.array([np.nan if v is None else v for v in self.emitted[:3]])
        shown = np.empty(points.shape)
        commands, absolute = self._commands(points[:, :3]), self.state.absolute
        farthest, row = nc_blocks.words(commands, given, scale, decimals, absolute, last, shown)
        if np.isnan(farthest):
            raise self._refusal(0, "an increment from a place that is not known")
        if farthest > FARTHEST:
            raise self._refusal(row, "a place beyond any machine")
        self.emitted[:3] = last.tolist()
        self._angles(points[:, 3:], given, shown[:, 3:])
        out = np.empty(self.texts + len(shown) * len(_AXES) * (16 + decimals), dtype=np.uint8)
        ends = np.empty(len(shown), dtype=np.int64)
        places = np.array([decimals] * 3 + [self.decimals] * 3)
        self.blocks += nc_blocks.write(shown, places, self.rows.text, self.rows.bytes, out, ends)
        return out[: ends[-1]].tobytes(), ends.tolist() if self.lines else []

    def _refusal(self, row: int, why: str) -> DataError:
        number = int(self.rows.number[row])
        return refuse(number, self.source_of(number), why)

    def _commands(self, points: np.ndarray) -> np.ndarray:
        """Commands in part coordinates whose tool points are `points`, mm. Raises DataError outside the table."""
        length = self.state.tool_length
        if self.state.offset not in self.setup.offsets:
            number = int(self.rows.number[0])
            offset_of(Block(number, self.source_of(number)), self.setup, self.state.offset)
        x, y, z = self.setup.offsets[self.state.offset]
        zero = np.array([x, y, z + length])
        wanted = np.asfortranarray(points + zero)  # by axis: as the table takes them
        command, bad = wanted, np.zeros(len(points), dtype=bool)
        for _ in range(ITERATIONS):
            command = wanted - self.deviation(command, length)
            if not np.isfinite(command).all():
                bad |= ~np.isfinite(command).all(axis=1)
        if bad.any():
            number = int(self.rows.number[bad.argmax()])
            raise DataError(f"line {number}: the table has no value here: {self.source_of(number).strip()!r}")
        self.largest = max(self.largest, float(np.abs(command - wanted).max()))
        return command - zero

    def _angles(self, angles: np.ndarray, given: np.ndarray, shown: np.ndarray) -> None:
        """Words of the rotary axes, which are not corrected, into `shown`. Shapes (n, 3); given: as in `Rows`."""
        assert self.emitted is not None
        for n in np.flatnonzero(np.bitwise_or.reduce(given) & _BITS[3:]):
            rows, before = given & _BITS[3 + n] != 0, self.emitted[3 + n]
            values = rounded(angles[rows, n], self.decimals)
            self.emitted[3 + n] = float(values[-1])
            if not self.state.absolute:
                first = 0.0 if before is None else before
                values = rounded(np.diff(values, prepend=first), self.decimals)
            shown[rows, n] = values


def rounded(values: np.ndarray, decimals: int) -> np.ndarray:
    """Values to the nearest decimal as it is written, which `np.round` misses beside a tie; no negative zero."""
    scaled = values * 10.0**decimals
    out = np.rint(scaled) / 10.0**decimals
    ties = np.abs(np.abs(scaled - np.floor(scaled)) - 0.5) < 1e-5 + 1e-14 * np.abs(scaled)
    out[ties] = [round(v, decimals) for v in values[ties].tolist()]
    return out + 0.0


def _written_in(state: State) -> tuple[str, float, bool, bool]:
    """The modes in which the points of a state are written."""
    return state.offset, state.tool_length, state.inch, state.absolute


def _allocated(points: int, text: int) -> nc_blocks.Rows:
    return nc_blocks.Rows(
        np.empty((points, len(_AXES))),
        np.empty(points, dtype=np.int64),
        np.empty(points, dtype=np.int64),
        np.empty((points, 3), dtype=np.int64),
        np.empty(text, dtype=np.uint8),
    )


def _moved(emitted: list[float | None], before: State, after: State, setup: Setup) -> list[float | None]:
    """What was emitted, in the coordinates now in force (offset, tool length, unit)."""
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
