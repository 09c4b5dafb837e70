"""The Jacobian in symbols: every entry as a polynomial in coordinates, sines, cosines and tool dimensions."""

from __future__ import annotations

from itertools import product

import numpy as np

from errpipe.kernels import volumetric as k
from errpipe.kinematics.chain import Chain

_TINY = 1e-12  # smaller coefficients are rounding of the geometry (mm, direction cosines)
Key = tuple[str, ...]


class Polynomial(dict[Key, float]):
    """Sorted tuples of variable names -> coefficients; () is the constant. Terms that cancel are left out.

    Sums and products of them are what NumPy needs to multiply vectors and matrices of polynomials.
    """

    def __add__(self, other: Polynomial) -> Polynomial:
        out = dict(self)
        for key, value in other.items():
            out[key] = out.get(key, 0.0) + value
        return of(out)

    def __sub__(self, other: Polynomial) -> Polynomial:
        return self + other * -1.0

    def __mul__(self, other: Polynomial | float) -> Polynomial:
        if not isinstance(other, Polynomial):
            return of({key: value * other for key, value in self.items()})
        out: dict[Key, float] = {}
        for (ka, va), (kb, vb) in product(self.items(), other.items()):
            key = tuple(sorted(ka + kb))
            out[key] = out.get(key, 0.0) + va * vb
        return of(out)


def of(letters: dict[Key, float]) -> Polynomial:
    """A polynomial without terms that are rounding."""
    return Polynomial({key: value for key, value in letters.items() if abs(value) > _TINY})


def function_of(variable: str) -> tuple[str, str]:
    """("sin", "C") of the variable "sin C"; ("", "X") of one that is no function."""
    function, _, axis = variable.rpartition(" ")
    return function, axis


def _constants(values: np.ndarray) -> np.ndarray:
    """An array of constant polynomials, shape of the values."""
    out = np.empty(np.shape(values), dtype=object)
    for place, value in np.ndenumerate(values):
        out[place] = of({(): float(value)})
    return out


def jacobian(chain: Chain, frame: str = "axes") -> dict[tuple[str, str], Polynomial]:
    """(output, component) -> polynomial, um per um or urad; urad per urad for orientations.

    frame "workpiece": outputs E_X ... E_C in the workpiece's frame. "axes": outputs are the linear axes that no rotary
    axis turns, each the deviation that moving this axis back would undo.
    Variables: axis letters (mm), "sin C", "cos C", "tool_length" and "tool_offset_X" (Y, Z).
    """
    kind, _, _, point, inverse, entries, comp, angle, evec = chain.factors
    tips, turns = _tips(chain), _turns(chain, frame)
    rows: dict[tuple[int, int], Polynomial] = {}
    for f in np.flatnonzero(kind == k.ERROR):
        arm = tips[f] - _constants(point[f])
        for t in range(entries[f], entries[f + 1]):
            v = _constants(-evec[t] if inverse[f] else evec[t])
            cross = np.roll(v, -1) * np.roll(arm, -2) - np.roll(v, -2) * np.roll(arm, -1)  # product of the two vectors
            parts = {0: cross * k.UM, 3: v} if angle[t] else {0: v}
            for block, part in parts.items():
                for m, j in np.ndindex(3, 3):
                    key = (block + m, int(comp[t]))
                    rows[key] = rows.get(key, Polynomial()) + turns[f][m, j] * part[j]
    return _named(chain, rows, frame)


def _tips(chain: Chain) -> list[np.ndarray]:
    """Ideal tip position (3,) after each factor, in symbols, mm."""
    kind, axis, vec, point, *_ = chain.factors
    direction, mount = chain.machine.tool.direction, chain.machine.mount()
    tip = _constants(np.asarray(mount))
    for m, d in enumerate("XYZ"):
        tip[m] = of({(): float(mount[m]), (f"tool_offset_{d}",): 1.0, ("tool_length",): float(direction[m])})
    out = [tip] * len(kind)
    for f in range(len(kind) - 1, -1, -1):
        out[f] = tip
        if kind[f] == k.MOVE:
            tip = tip + _constants(vec[f]) * Polynomial({(chain.axes[axis[f]],): 1.0})
        elif kind[f] == k.TURN:
            place = _constants(point[f])
            tip = _rotation(chain.axes[axis[f]], vec[f]) @ (tip - place) + place
    return out


def _turns(chain: Chain, frame: str) -> list[np.ndarray]:
    """Ideal turn (3, 3) from each factor's frame to the frame of the outputs."""
    kind, axis, vec, *_ = chain.factors
    unit = _constants(np.eye(3))
    out = [unit] * len(kind)
    bed = _bed(chain) if frame == "axes" else 0
    turn = unit
    for f in range(bed, len(kind)):
        out[f] = turn
        if kind[f] == k.TURN:
            turn = turn @ _rotation(chain.axes[axis[f]], vec[f])
    turn = unit
    for f in range(bed - 1, -1, -1):
        if kind[f] == k.TURN:
            turn = turn @ _rotation(chain.axes[axis[f]], vec[f]).T
        out[f] = turn
    return out


def _bed(chain: Chain) -> int:
    """Number of the first factor on the tool's side of the bed."""
    links = chain.machine.chain
    names = [n.rstrip("'") for n in links[: links.index("bed")]]
    kind, axis, *_, entries, comp, _, _ = chain.factors
    last = 0
    for f in range(len(kind)):
        first = comp[entries[f]] if kind[f] == k.ERROR else -1
        owner = chain.axes[axis[f]] if kind[f] != k.ERROR else chain.components[first][2:]
        if owner in names or (owner == "S" and "spindle" in names):
            last = f + 1
    return last


def _rotation(name: str, v: np.ndarray) -> np.ndarray:
    """Rodrigues' formula in symbols, shape (3, 3): c I + s [v]x + (1 - c) v v'."""
    out, unit, along = np.empty((3, 3), dtype=object), np.eye(3), np.outer(v, v)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    for at in np.ndindex(3, 3):
        cosine = float(unit[at] - along[at])
        out[at] = of({(): float(along[at]), (f"cos {name}",): cosine, (f"sin {name}",): float(cross[at])})
    return out


def _named(chain: Chain, rows: dict[tuple[int, int], Polynomial], frame: str) -> dict[tuple[str, str], Polynomial]:
    if frame == "workpiece":
        names = ["E_X", "E_Y", "E_Z", "E_A", "E_B", "E_C"]
        return {(names[i], chain.components[c]): p for (i, c), p in sorted(rows.items()) if p}
    linear = chain.machine.correcting_axes()
    undo = np.linalg.pinv(np.array([chain.machine.direction(a) for a in linear]).T)
    out: dict[tuple[str, str], Polynomial] = {}
    for c, component in enumerate(chain.components):
        for a, name in enumerate(linear):
            parts = (rows.get((m, c), Polynomial()) * float(undo[a, m]) for m in range(3))
            if total := sum(parts, Polynomial()):
                out[name, component] = total
    return out
