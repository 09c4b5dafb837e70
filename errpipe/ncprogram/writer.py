"""From tool points to corrected blocks: the deviation is evaluated for thousands of points at once."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from errpipe.errors import DataError
from errpipe.ncprogram.blocks import Block, refuse
from errpipe.ncprogram.modal import LINEAR, MM_PER_INCH, ROTARY, Setup, State, offset_of

# deviation(points, tool_length): machine coordinates, shape (n, 3) mm -> deviation of the tool point, (n, 3) mm
Deviation = Callable[[np.ndarray, float], np.ndarray]

ITERATIONS = 4  # fixed-point steps; each gains a factor of the deviation's slope, about 1e4
MAX_POINTS = 50_000  # held at a time: about 20 MB
_AXES = LINEAR + ROTARY


class Writer:
    """Collects tool points and lines in their order; writes them corrected.

    emitted: position per axis as last written, in program units, so that increments carry no rounding forward.
    """

    def __init__(self, write: Callable[[str], object], deviation: Deviation, setup: Setup, decimals: int):
        self.write, self.deviation, self.setup, self.decimals = write, deviation, setup, decimals
        self.emitted: list[float | None] | None = None
        self.state = State()
        self.blocks, self.largest = 0, 0.0
        self._clear()

    def _clear(self) -> None:
        self.points: list[Sequence[float | None]] = []
        self.rotary: dict[int, list[float]] = {}  # number of a point -> its A, B, C, NaN where not written
        self.given: list[tuple[bool, bool, bool]] = []
        self.prefix: list[str] = []
        self.comments: dict[int, str] = {}
        self.sources: list[tuple[int, str]] = []
        self.lines: list[tuple[int, str]] = []  # (points before it, line that stays as it is)

    def take_over(self, state: State) -> None:
        """The modal state in which the following points are meant."""
        if self.emitted is None:
            self.emitted = list(state.position)
        frame = ("offset", "tool_length", "inch", "absolute")
        if any(getattr(state, key) != getattr(self.state, key) for key in frame):
            self.flush()
            self.emitted = _moved(self.emitted, self.state, state, self.setup)
        self.state = state

    def line(self, source: str) -> None:
        """A line that stays as it is."""
        self.lines.append((len(self.points), source))
        if len(self.lines) >= MAX_POINTS:
            self.flush()

    def point(
        self, point: Sequence[float | None], given: tuple[bool, bool, bool], prefix: str, number: int, source: str
    ) -> None:
        """One tool point, part coordinates, mm; given: axes that the block names; number, source: for refusals."""
        self.points.append(point)
        self.given.append(given)
        self.prefix.append(prefix)
        self.sources.append((number, source))
        if len(self.points) >= MAX_POINTS:
            self.flush()

    def path(self, block: Block, points: np.ndarray, prefix: str) -> None:
        """The tool points of a block, shape (n, 6), NaN for a rotary axis that is not known."""
        x, y, z, *rotary = (block.value(letter) is not None for letter in _AXES)
        if block.comments:
            self.comments[len(self.points)] = " ".join(block.comments)
        for n, point in enumerate(points):
            if any(rotary):
                self.rotary[len(self.points)] = np.where(rotary, point[3:], np.nan).tolist()
            self.points.append(point[:3])
            self.given.append((x, y, z))
            self.prefix.append(prefix if n == 0 else "")
            self.sources.append((block.line, block.source))
        if len(self.points) >= MAX_POINTS:
            self.flush()

    def flush(self) -> None:
        """Write all that was collected. Raises DataError where the table has no value."""
        texts = self._moves() if self.points else []
        out: list[str | None] = []
        done = 0
        for before, line in self.lines:
            out += texts[done:before]
            out.append(line)
            done = before
        out += texts[done:]
        kept = [text for text in out if text is not None]
        self.blocks += len(kept)
        if kept:
            self.write("\n".join(kept) + "\n")
        self._clear()

    def _moves(self) -> list[str | None]:
        """The text of every point; None where nothing is left to write."""
        assert self.emitted is not None
        commands = self._commands(np.array(self.points, dtype=float))
        scale, decimals = (MM_PER_INCH, self.decimals + 2) if self.state.inch else (1.0, self.decimals)
        values = np.round(commands / scale, decimals) + 0.0
        first = [np.nan if v is None else v for v in self.emitted[:3]]
        last = np.vstack([first, values[:-1]])
        shown = values if self.state.absolute else np.round(values - last, decimals) + 0.0
        if np.isnan(shown).any():
            number, source = self.sources[0]
            raise refuse(number, source, "an increment from a place that is not known")
        wanted = np.array(self.given) | (values != last)
        self.emitted[:3] = [float(v) for v in values[-1]]
        columns = []
        for n, letter in enumerate(LINEAR):
            texts = (f"{letter}%.{decimals}f\n" * len(shown) % tuple(shown[:, n].tolist())).split("\n")
            columns.append([t if w else "" for t, w in zip(texts, wanted[:, n].tolist(), strict=False)])
        rows: list[str | None] = [" ".join(filter(None, parts)) for parts in zip(self.prefix, *columns, strict=True)]
        for row, angles in self.rotary.items():
            rows[row] = f"{rows[row]} {self._angles(angles)}".strip()
        for row, comment in self.comments.items():
            rows[row] = f"{rows[row]} {comment}".strip()
        return [text or None for text in rows]

    def _commands(self, points: np.ndarray) -> np.ndarray:
        """Commands in part coordinates whose tool points are `points`, mm. Raises DataError outside the table."""
        length = self.state.tool_length
        x, y, z = offset_of(Block(*self.sources[0]), self.setup, self.state.offset)
        zero = np.array([x, y, z + length])
        wanted = points + zero
        command = wanted.copy()
        for _ in range(ITERATIONS):
            command = wanted - self.deviation(command, length)
            bad = np.flatnonzero(~np.isfinite(command).all(axis=1))
            if bad.size:
                number, source = self.sources[bad[0]]
                raise DataError(f"line {number}: the table has no value here: {source.strip()!r}")
        self.largest = max(self.largest, float(np.abs(command - wanted).max()))
        return command - zero

    def _angles(self, angles: Sequence[float] | np.ndarray) -> str:
        """Words of the rotary axes, which are not corrected."""
        assert self.emitted is not None
        words = []
        for n, angle in enumerate(angles, len(LINEAR)):
            if not np.isnan(angle):
                last, value = self.emitted[n], round(float(angle), self.decimals) + 0.0
                shown = value if self.state.absolute or last is None else round(value - last, self.decimals) + 0.0
                words.append(f"{_AXES[n]}{shown:.{self.decimals}f}")
                self.emitted[n] = value
        return " ".join(words)


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
