"""A machine's chain as a list of factors, with all its error components, named after ISO 230-1.

From workpiece to tool each axis contributes, in this order when it carries the tool (mirrored otherwise),

    drift of its frame's origin . location . motion . location^-1 . its six error motions

so that a location error (squareness, offset and tilt of a rotary axis' line) acts only on the motion: a
constant rotation of a carriage is set-up, absorbed by the workpiece's or tool's datum. In words:

* Squareness. The first of `datum_axes` is the datum. The second can only rotate in the plane of both; every
  further one rotates about both directions perpendicular to its own. C0Y = +1 urad: the +Y motion leans towards -X.
* Straightness has neither offset nor slope over the travel (least squares): the slope is squareness.
* Positioning is zero at the axis' datum position; its slope stays (scale). Angular motions have no offset.
* Directions of error motions travel with a linear axis, and stand for a rotary one (ISO 230-1, 230-7).
* Deviations are those of the tool's side relative to the workpiece's side, in the workpiece's frame.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from errpipe.domain.machine import LETTERS, Machine, Vector
from errpipe.kernels import volumetric as k

_ALL = ("X", "Y", "Z", "A", "B", "C")
_UNIT = {**LETTERS, "A": LETTERS["X"], "B": LETTERS["Y"], "C": LETTERS["Z"]}
_OWN = {"U": "X", "V": "Y", "W": "Z", "P": "X", "Q": "Y", "R": "Z"}


@dataclass(frozen=True)
class Chain:
    """A compiled machine.

    axes: names, the columns of every `q` (mm, deg); components: names, the columns of every `comps` (um, urad);
    drives: for each component the column of q it is a function of, or -1 for a constant.
    """

    machine: Machine
    axes: tuple[str, ...]
    components: tuple[str, ...]
    drives: np.ndarray
    factors: tuple[np.ndarray, ...] = field(repr=False)

    @cached_property
    def angular(self) -> np.ndarray:
        """True for components in urad, shape (components,)."""
        return np.array([_letter(name) in "ABC" for name in self.components])

    @cached_property
    def travel(self) -> np.ndarray:
        """Lowest and highest position, shape (axes, 2)."""
        return np.array([self.machine.axes[a].travel for a in self.axes])

    @cached_property
    def linear(self) -> list[int]:
        """Columns of `q` of the linear axes that correct."""
        return [self.axes.index(a) for a in self.machine.correcting_axes()]

    def axis_unit(self, axis: str) -> str:
        """mm or deg."""
        return "mm" if self.machine.axes[axis].kind == "linear" else "deg"

    def of_axis(self, axis: str) -> tuple[str, ...]:
        """The six error motions of an axis: X Y Z A B C."""
        return tuple(f"E{d}{axis}" for d in _ALL)

    def index(self, component: str) -> int:
        """Column of a component. Raises KeyError naming it."""
        try:
            return self.components.index(component)
        except ValueError:
            raise KeyError(f"{self.machine.name} has no component {component}") from None

    def unit(self, component: str) -> str:
        """um or urad."""
        return "urad" if self.angular[self.index(component)] else "um"

    def tip(self, length: np.ndarray | float | None = None, offset: Vector | None = None) -> np.ndarray:
        """Tool tip with all axes at zero, mm, shape (n, 3); default: the machine file's tool."""
        tool = self.machine.tool
        size = np.atleast_1d(np.asarray(tool.length if length is None else length, dtype=float))
        base = np.asarray(self.machine.mount()) + np.asarray(tool.offset if offset is None else offset)
        return base + size[:, None] * np.asarray(tool.direction)

    def counts(self) -> dict[str, int]:
        """Number of components of each kind, and in total: error motions, location, drift, spindle."""
        motions = sum(n[0] == "E" for n in self.components)
        spindle = sum(n[0] != "E" and n[2:] == "S" for n in self.components)
        drift = sum(
            n[0] in "XYZ" and n[2:] in self.machine.axes and self.machine.axes[n[2:]].kind == "linear"
            for n in self.components
        )
        total = len(self.components)
        return {
            "error_motions": motions,
            "location": total - motions - spindle - drift,
            "drift": drift,
            "spindle": spindle,
            "total": total,
        }


def _letter(component: str) -> str:
    """Direction of a component: the second letter of an error motion, the first of a constant."""
    return component[1] if component[0] == "E" else component[0]


class _Builder:
    def __init__(self) -> None:
        self.components: list[str] = []
        self.drives: list[int] = []
        self.rows: list[tuple[int, int, Vector, Vector, bool]] = []
        self.entries: list[list[tuple[int, bool, Vector]]] = []

    def motion(self, kind: int, axis: int, vec: Vector, point: Vector) -> None:
        self.rows.append((kind, axis, vec, point, False))
        self.entries.append([])

    def error(self, point: Vector, parts: list[tuple[str, Vector]], drive: int = -1, inverse: bool = False) -> None:
        """One error factor; a component with a known name is the same component."""
        if not parts:
            return
        entry = []
        for name, vec in parts:
            if name not in self.components:
                self.components.append(name)
                self.drives.append(drive)
            entry.append((self.components.index(name), _letter(name) in "ABC", vec))
        self.rows.append((k.ERROR, -1, (0.0, 0.0, 0.0), point, inverse))
        self.entries.append(entry)

    def arrays(self) -> tuple[np.ndarray, ...]:
        kind, axis, vec, point, inverse = zip(*self.rows, strict=True)
        flat = [e for entry in self.entries for e in entry]
        comp, angle, evec = zip(*flat, strict=True)
        starts = np.cumsum([0] + [len(e) for e in self.entries])
        return (
            np.array(kind, dtype=np.int64),
            np.array(axis, dtype=np.int64),
            np.array(vec),
            np.array(point),
            np.array(inverse, dtype=np.bool_),
            starts.astype(np.int64),
            np.array(comp, dtype=np.int64),
            np.array(angle, dtype=np.bool_),
            np.array(evec),
        )


def combinations(grids: Iterable[np.ndarray]) -> np.ndarray:
    """Every combination of one position of each axis, the last axis running fastest, shape (n, axes)."""
    return np.stack([g.ravel() for g in np.meshgrid(*grids, indexing="ij")], axis=1)


def compile_chain(machine: Machine) -> Chain:
    """Factors and components of a machine."""
    axes = tuple(sorted(machine.axes, key=lambda n: ("XYZUVWPQRABC".find(n[0]), n)))
    b = _Builder()
    for link in machine.chain[1:-1]:
        name = link.rstrip("'")
        if name == "bed":
            continue
        if name == "spindle":
            _spindle(b, machine)
        else:
            _axis(b, machine, name, axes.index(name))
    return _sorted(Chain(machine, axes, tuple(b.components), np.array(b.drives), b.arrays()))


def _axis(b: _Builder, machine: Machine, name: str, column: int) -> None:
    axis = machine.axes[name]
    vec, point = machine.direction(name), axis.reference
    work = machine.side_moved_by(name) == "workpiece"
    inverse = work and axis.errors_of == "carriage"
    linear = axis.kind == "linear"
    axis_letter = _own_letter(name, vec, linear)
    motions = [(f"E{d}{name}", vec if d == axis_letter and not linear else _UNIT[d]) for d in _ALL]
    location = _location(machine, name, vec, axis_letter)
    drift = [(f"{d}0{name}", _UNIT[d]) for d in "XYZ"] if axis.drifts and linear else []
    zero = [] if linear else [(f"{axis_letter}0{name}", vec)]

    def moving() -> None:
        b.error(point, location)
        b.motion(k.MOVE if linear else k.TURN, column, vec, point)
        b.error(point, location, inverse=True)
        b.error(point, zero, inverse=inverse)

    def errors() -> None:
        b.error(point, motions, drive=column, inverse=inverse)

    steps = [lambda: b.error(point, drift, inverse=inverse), moving, errors]
    if not axis.errors_travel:
        steps = [steps[0], errors, moving]
    for step in reversed(steps) if work else steps:
        step()


def _spindle(b: _Builder, machine: Machine) -> None:
    """Growth and tilt of the spindle itself about its nose (separate motion, also if it holds the workpiece)."""
    s = machine.spindle
    along = max("XYZ", key=lambda d: abs(np.dot(s.direction, LETTERS[d])))
    parts = [(f"{d}0S", LETTERS[d]) for d in "XYZ"] if s.growth else []
    if s.tilt:
        parts += [(f"{d}0S", _UNIT[d]) for d in "ABC" if _UNIT[d] != LETTERS[along]]
    b.error(s.position, parts, inverse=machine.side_moved_by("spindle") == "workpiece")


def _own_letter(name: str, vec: Vector, linear: bool) -> str:
    """Letter of the axis' own direction: X Y Z of a linear, A B C of a rotary axis."""
    letter = _OWN.get(name[0], name[0])
    if letter in ("XYZ" if linear else "ABC"):
        return letter
    return max("XYZ" if linear else "ABC", key=lambda d: abs(np.dot(vec, _UNIT[d])))


def _location(machine: Machine, name: str, vec: Vector, own: str) -> list[tuple[str, Vector]]:
    if machine.axes[name].kind == "rotary":
        along = max("XYZ", key=lambda d: abs(np.dot(vec, LETTERS[d])))
        shifts = [(f"{d}0{name}", LETTERS[d]) for d in "XYZ" if d != along]
        return shifts + [(f"{d}0{name}", _UNIT[d]) for d in "ABC" if d != own]
    linear = machine.linear_axes()
    place = linear.index(name)
    if place == 0:
        return []
    if place == 1:
        normal = np.cross(machine.direction(linear[0]), vec)
        size = float(np.linalg.norm(normal))
        if size > 1e-6:
            letter = max("ABC", key=lambda d: abs(np.dot(normal, _UNIT[d])))
            normal = normal / size * np.sign(np.dot(normal, _UNIT[letter]))
            x, y, z = (float(v) for v in normal)
            return [(f"{letter}0{name}", (x, y, z))]
    along = max("ABC", key=lambda d: abs(np.dot(vec, _UNIT[d])))
    return [(f"{d}0{name}", _UNIT[d]) for d in "ABC" if d != along]


def _sorted(chain: Chain) -> Chain:
    """Components in reading order: error motions axis by axis, location, drift, spindle."""

    def key(item: tuple[int, str]) -> tuple[int, int, int]:
        _, name = item
        if name[0] == "E":
            return (0, chain.axes.index(name[2:]), _ALL.index(name[1]))
        if name[2:] == "S":
            return (3, 0, _ALL.index(name[0]))
        drift = name[0] in "XYZ" and chain.machine.axes[name[2:]].kind == "linear"
        return (2 if drift else 1, chain.axes.index(name[2:]), _ALL.index(name[0]))

    order = [i for i, _ in sorted(enumerate(chain.components), key=key)]
    rank = np.argsort(order)
    factors = list(chain.factors)
    factors[6] = rank[factors[6]].astype(np.int64)
    components = tuple(chain.components[i] for i in order)
    return Chain(chain.machine, chain.axes, components, chain.drives[order], tuple(factors))
