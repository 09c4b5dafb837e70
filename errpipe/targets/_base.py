"""What a target is: a controller's file format, its sign in words, its limits, and a reader like the controller's own.

A target gets a `CompensationTable` and nothing else. `write` gives the files; `read_back` parses them the way
the controller would and returns what that controller would *add to the command*. The difference to the table is
the loss of the format, in micrometres, and is always reported.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError, VerifyError
from errpipe.targets._text import ascii_text, plain

Confidence = Literal["verified", "documented", "experimental"]
# What a format expresses: an axis over its own position (one curve, or one for each direction of travel), an axis over
# another one, Z over a bed, lost motion alone, a straight line per kelvin.
Holds = Literal["screw", "both directions", "cross", "bed", "reversal", "temperature"]
# Warning comment in the files of an experimental format.
CAUTION = "experimental: rests on experience, not on a manual or a run; prove the sign on the machine before use"

# Unit of formats whose numbers a control reads in the unit that the axis is set to.
AS_THE_AXIS = "mm (deg for rotary axes): the axis must count in mm (deg); set to inches it would take them 25.4 times"

# Of a control's own backlash value, where the table of an axis is the same in both directions.
KEPT_BACKLASH = "stays as it was while measuring (the table has no lost motion)"

# Of LinuxCNC, in its own screw files as in a component: tests/e2e/linuxcnc/test_closed_loop.py.
HOMED_AT_ONCE = (
    "after homing move each joint 1 mm up and down before touching off: one that is homed in place "
    "(HOME_SEARCH_VEL = 0) jumps to its new position, which counts as a move; its lost motion may be on the wrong "
    "side, and a COMP_FILE may not act at all, until it moves"
)

# Advice where a format cannot take a table, or does harm.
ANOTHER_FORMAT = "choose another format (`errpipe compare-targets TABLE` states what each loses)"
REMARK = "errpipe remark: "  # prefix of the comment with a file's origin


class NothingToAddError(GateError):
    """A format adds nothing to the other targets that were requested."""


@dataclass(frozen=True)
class Curve:
    """Correction added to `axis` over the position of `over`, mm (deg): up and down are the directions of travel.

    positions: ascending, shape (n,); straight between them, held beyond them.
    """

    axis: str
    over: str
    positions: np.ndarray
    up: np.ndarray
    down: np.ndarray

    def at(self, position: np.ndarray, side: np.ndarray) -> np.ndarray:
        """Correction at positions, approached from below (+1) or above (-1)."""
        rising = np.interp(position, self.positions, self.up)
        return np.where(side > 0, rising, np.interp(position, self.positions, self.down))

    @property
    def mean(self) -> np.ndarray:
        """Mean of both directions, mm (deg), shape (n,)."""
        return (self.up + self.down) / 2

    @property
    def turns(self) -> bool:
        """Whether it covers one whole turn of a rotary axis, and repeats."""
        return is_rotary(self.over) and is_turn(self.positions)


TURN = 360.0  # deg
TURNS_READ = 5  # of a curve that a controller repeats: two on either side of its own


def is_turn(positions: np.ndarray) -> bool:
    """Whether ascending positions cover one turn, deg."""
    return abs(float(positions[-1] - positions[0]) - TURN) < 1e-6


def unit_of(axis: str) -> str:
    """Unit of the positions and corrections of an axis."""
    return "deg" if is_rotary(axis) else "mm"


def periodic_curve(curve: Curve) -> Curve:
    """A curve over one turn as a controller has it that repeats it."""
    x, up, down = (v[:-1] for v in (curve.positions, curve.up, curve.down))
    positions = np.concatenate([x + TURN * (n - TURNS_READ // 2) for n in range(TURNS_READ)])
    return Curve(curve.axis, curve.over, positions, np.tile(up, TURNS_READ), np.tile(down, TURNS_READ))


def points_in_file(curve: Curve) -> int:
    """Points of a file's curve that was read back: for a curve that repeats with every turn, those of one turn."""
    count, turns = curve.positions.size, (curve.positions[-1] - curve.positions[0]) / TURN
    repeated = is_rotary(curve.over) and TURNS_READ - 1 < turns < TURNS_READ
    return count // TURNS_READ + 1 if repeated else count


@dataclass(frozen=True)
class Plane:
    """Correction added to `axis` over two axes: values[i, j] at (first[i], second[j]), bilinear, held beyond."""

    axis: str
    over: tuple[str, str]
    first: np.ndarray
    second: np.ndarray
    values: np.ndarray

    def at(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Correction at points of the plane, mm."""
        i, f = _cell(self.first, a)
        j, g = _cell(self.second, b)
        v = self.values
        low = v[i, j] * (1 - f) + v[i + 1, j] * f
        high = v[i, j + 1] * (1 - f) + v[i + 1, j + 1] * f
        return low * (1 - g) + high * g


@dataclass(frozen=True)
class Product:
    """Correction added to `axis`: first(position of over[0]) * second(position of over[1]), mm.

    Each factor is straight between its positions and held beyond them; their values are roots of mm.
    """

    axis: str
    over: tuple[str, str]
    positions: tuple[np.ndarray, np.ndarray]
    values: tuple[np.ndarray, np.ndarray]

    def at(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Correction at points of the two axes, mm."""
        first, second = (np.interp(x, p, v) for x, p, v in zip((a, b), self.positions, self.values, strict=True))
        return first * second


def _cell(grid: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    inside = np.clip(x, grid[0], grid[-1])
    index = np.clip(np.searchsorted(grid, inside, side="right") - 1, 0, grid.size - 2)
    return index, (inside - grid[index]) / (grid[index + 1] - grid[index])


@dataclass(frozen=True)
class Line:
    """Correction of `axis` per kelvin of a sensor over `reference`: level (mm/K) + slope (1/K) * (position - zero)."""

    axis: str
    sensor: str
    reference: float
    level: float
    slope: float
    zero: float = 0.0


@dataclass(frozen=True)
class ReadBack:
    """Everything a controller would make of the files: the sum of its parts."""

    curves: tuple[Curve, ...] = ()
    planes: tuple[Plane, ...] = ()
    lines: tuple[Line, ...] = ()
    products: tuple[Product, ...] = ()

    def __add__(self, other: ReadBack) -> ReadBack:
        lines, products = self.lines + other.lines, self.products + other.products
        return ReadBack(self.curves + other.curves, self.planes + other.planes, lines, products)

    def moving(self, axis: str) -> ReadBack:
        """The parts that move one axis."""
        return ReadBack(
            tuple(c for c in self.curves if c.axis == axis),
            tuple(p for p in self.planes if p.axis == axis),
            tuple(x for x in self.lines if x.axis == axis),
            tuple(p for p in self.products if p.axis == axis),
        )

    def grids(self) -> list[tuple[str, np.ndarray]]:
        """Axis and ascending positions, mm (deg), of every part over an axis: curves, products, planes."""
        of_products = (pair for p in self.products for pair in zip(p.over, p.positions, strict=True))
        of_planes = (pair for p in self.planes for pair in zip(p.over, (p.first, p.second), strict=True))
        return [*((c.over, c.positions) for c in self.curves), *of_products, *of_planes]

    def spans(self) -> dict[str, tuple[float, float]]:
        """Axis -> the ends of the positions over which anything is corrected, mm (deg)."""
        return {axis: (float(x[0]), float(x[-1])) for axis, x in self.grids()}

    def axes(self) -> tuple[str, ...]:
        """Axes that would be moved."""
        parts: tuple[Curve | Plane | Line | Product, ...] = (*self.curves, *self.planes, *self.lines, *self.products)
        return tuple(dict.fromkeys(p.axis for p in parts))

    def correction(
        self, axis: str, positions: Mapping[str, np.ndarray], side: np.ndarray, sensors: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Correction of one axis, mm (deg), shape (n,). positions: axis -> (n,); sensors: input -> (n,)."""
        total = np.zeros(side.size)
        for c in self.curves:
            if c.axis == axis:
                total = total + c.at(positions[c.over], side)
        pairs: tuple[Plane | Product, ...] = (*self.planes, *self.products)
        for p in pairs:
            if p.axis == axis:
                total = total + p.at(positions[p.over[0]], positions[p.over[1]])
        for line in self.lines:
            if line.axis == axis:
                rise = sensors[line.sensor] - line.reference
                total = total + rise * (line.level + line.slope * (positions.get(axis, line.zero) - line.zero))
        return total


@dataclass(frozen=True)
class ByHand:
    """A number to enter, in words, and the curve that it adds to the files (None: it adds nothing)."""

    text: str
    curve: Curve | None = None


class Target:
    """Base of all targets. One subclass a file; subclasses are never instantiated."""

    name: ClassVar[str]
    controller: ClassVar[str]
    confidence: ClassVar[Confidence]
    sign: ClassVar[str]  # what a positive value does, in words
    limits: ClassVar[str]  # of the format, in words
    unit: ClassVar[str] = AS_THE_AXIS  # of positions and values in the files, in words
    holds: ClassVar[tuple[Holds, ...]]  # for the tests that every format goes through
    rounding_um: ClassVar[float] = 0.1  # largest error at a node
    keeps_level: ClassVar[bool] = (
        True  # whether a constant is kept: many formats are 0 at their reference by definition
    )
    source: ClassVar[str]  # the manual or the program's source that says so
    activation: ClassVar[Sequence[str]]  # what a person at the machine sets and reads back
    numbering: ClassVar[str] = ""  # what the files call an axis by its number: {0} counts from 0, {1} from 1
    remark: ClassVar[Mapping[str, str]] = {}  # end of a file's name -> a comment in it, {} standing for the text
    synthesised: ClassVar[bool] = False  # the controller adds more than is read back, by its own kinematics
    goes_with: ClassVar[Sequence[str]] = ()  # targets whose files the same controller adds to these (either states it)

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        """File name -> text. Raises GateError if the table does not fit the format."""
        raise TypeError(f"{cls.__name__} does not write")

    @classmethod
    def write_with(cls, table: CompensationTable, others: Sequence[str]) -> dict[str, str]:
        """As `write`, without what the files of `others` (targets of the same controller) hold already."""
        return cls.write(table)

    @classmethod
    def with_remarks(cls, files: Mapping[str, str], lines: Sequence[str]) -> dict[str, str]:
        """The files with lines as comments behind the first line of those that have room for comments."""
        out = dict(files)
        for name in files:
            form = next((form for end, form in cls.remark.items() if name.endswith(end)), None)
            if form is not None:
                first, body = files[name].split("\n", 1)
                out[name] = "\n".join([first, *(form.format(f"{REMARK}{ascii_text(line)}") for line in lines), body])
        return out

    @classmethod
    def without_remarks(cls, files: Mapping[str, str]) -> dict[str, str]:
        """The files without such comments, for a reader that compares every line."""
        out = dict(files)
        for end, form in cls.remark.items():
            for name in (n for n in files if n.endswith(end)):
                out[name] = "\n".join(x for x in files[name].split("\n") if not _is_remark(x, form))
        return out

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        """Numbers that no file carries and a person enters.

        read: what the controller makes of the files; others: names of the targets that are loaded besides.
        """
        return ()

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        """What the controller makes of the files. Raises VerifyError if it would not take them."""
        raise TypeError(f"{cls.__name__} does not read back")


def _is_remark(line: str, form: str) -> bool:
    """Whether a line is a remark in this form of comment, and nothing besides."""
    _, mark, content = line.partition(REMARK)
    content = content[: len(content) - len(form.partition("{}")[2])]
    return bool(mark) and line == form.format(REMARK + plain(content))


@dataclass(frozen=True)
class Points:
    """A uniform grid of at most so many points, as formats require it."""

    start: float
    step: float
    count: int

    def positions(self) -> np.ndarray:
        """Ascending positions, shape (count,)."""
        return self.start + self.step * np.arange(self.count)


def too_many(target: str, points: int, limit: int, error_um: float) -> GateError:
    """The error of a format whose points do not suffice."""
    return GateError(
        f"{target}: {points} points are needed, {limit} fit; with {limit} the error would be {error_um:.3g} um. "
        "Allow a larger error, or choose a target that holds more."
    )


def matched(pattern: str | re.Pattern[str], text: str, target: str, what: str) -> re.Match[str]:
    """The first match (^ and $ at every line) of a pattern. Raises VerifyError if there is none."""
    match = re.search(pattern, text) if isinstance(pattern, re.Pattern) else re.search(pattern, text, re.M)
    if match is None:
        raise VerifyError(f"{target}: {what}")
    return match


def grid_stated(facts: Mapping[str, float]) -> np.ndarray:
    """Positions from MIN by STEP up to MAX: not rounded, for a control may not do so either."""
    return facts["MIN"] + facts["STEP"] * np.arange(math.floor((facts["MAX"] - facts["MIN"]) / facts["STEP"]) + 1)


def settings_in(text: str) -> dict[str, str]:
    """Lines of a name and its value, comments behind # left out."""
    return dict(line.split("#")[0].split() for line in text.splitlines() if line.split("#")[0].strip())


def expect(condition: bool, target: str, what: str) -> None:
    """Raise VerifyError if a file is not what the controller takes."""
    if not condition:
        raise VerifyError(f"{target}: {what}")
