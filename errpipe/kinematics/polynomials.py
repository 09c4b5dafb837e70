"""The Jacobian in symbols: every entry as a polynomial in coordinates, sines, cosines and tool dimensions.

A polynomial is a mapping from sorted tuples of variable names to coefficients; () is the constant.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from errpipe.kernels import volumetric as k
from errpipe.kinematics.chain import Chain

Polynomial = dict[tuple[str, ...], float]
_TINY = 1e-12  # smaller coefficients are rounding of the geometry (mm, direction cosines)


def function_of(variable: str) -> tuple[str, str]:
    """("sin", "C") of the variable "sin C"; ("", "X") of one that is no function."""
    function, _, axis = variable.rpartition(" ")
    return function, axis


def add(a: Polynomial, b: Polynomial, factor: float = 1.0) -> Polynomial:
    """a + factor * b, without terms that cancel."""
    out = dict(a)
    for key, value in b.items():
        out[key] = out.get(key, 0.0) + factor * value
    return {key: value for key, value in out.items() if abs(value) > _TINY}


def _constant(x: float) -> Polynomial:
    return {(): x} if x else {}


def times(a: Polynomial, b: Polynomial) -> Polynomial:
    """a * b."""
    out: Polynomial = {}
    for (ka, va), (kb, vb) in product(a.items(), b.items()):
        key = tuple(sorted(ka + kb))
        out[key] = out.get(key, 0.0) + va * vb
    return {key: value for key, value in out.items() if abs(value) > _TINY}


def jacobian(chain: Chain, frame: str = "axes") -> dict[tuple[str, str], Polynomial]:
    """(output, component) -> polynomial, um per um or urad; urad per urad for orientations.

    frame "workpiece": outputs E_X ... E_C in the workpiece's frame. "axes": outputs are the linear axes, each the
    deviation that moving this axis back would undo.
    Variables: axis letters (mm), "sin C", "cos C", "tool_length" and "tool_offset_X" (Y, Z).
    Raises ValueError for "axes" where a rotary axis turns a linear one.
    """
    kind, _, _, point, inverse, entries, comp, angle, evec = chain.factors
    arms, turns = _arms(chain), _turns(chain, frame)
    rows: dict[tuple[int, int], Polynomial] = {}
    for f in np.flatnonzero(kind == k.ERROR):
        sign = -1.0 if inverse[f] else 1.0
        arm = [add(arms[f][m], {(): -float(point[f, m])}) for m in range(3)]
        for t in range(entries[f], entries[f + 1]):
            v = [float(x) * sign for x in evec[t]]
            if angle[t]:
                place = [
                    add(_scale(arm[(m + 2) % 3], v[(m + 1) % 3]), arm[(m + 1) % 3], -v[(m + 2) % 3]) for m in range(3)
                ]
                parts = [_scale(p, k.UM) for p in place] + [_constant(x) for x in v]
            else:
                parts = [_constant(x) for x in v] + [{}, {}, {}]
            for block in (0, 3):
                for m in range(3):
                    for j in range(3):
                        if parts[block + j] and turns[f][m][j]:
                            key = (block + m, int(comp[t]))
                            rows[key] = add(rows.get(key, {}), times(turns[f][m][j], parts[block + j]))
    return _named(chain, rows, frame)


def _scale(a: Polynomial, factor: float) -> Polynomial:
    return {key: v * factor for key, v in a.items() if abs(v * factor) > _TINY}


def _arms(chain: Chain) -> list[list[Polynomial]]:
    """Ideal tip position after each factor, in symbols, mm."""
    kind, axis, vec, point, *_ = chain.factors
    tool = chain.machine.tool
    tip = []
    for m, d in enumerate("XYZ"):
        letters = {
            (): float(chain.machine.mount()[m]),
            (f"tool_offset_{d}",): 1.0,
            ("tool_length",): float(tool.direction[m]),
        }
        tip.append({key: v for key, v in letters.items() if abs(v) > _TINY})
    out: list[list[Polynomial]] = [[] for _ in kind]
    for f in range(len(kind) - 1, -1, -1):
        out[f] = tip
        if kind[f] == k.MOVE:
            tip = [add(tip[m], {(chain.axes[axis[f]],): float(vec[f, m])}) for m in range(3)]
        elif kind[f] == k.TURN:
            turn = _rotation(chain.axes[axis[f]], vec[f])
            local = [add(tip[m], {(): -float(point[f, m])}) for m in range(3)]
            tip = [add(_row(turn[m], local), {(): float(point[f, m])}) for m in range(3)]
    return out


def _turns(chain: Chain, frame: str) -> list[list[list[Polynomial]]]:
    """Ideal turn from each factor's frame to the frame of the outputs."""
    kind, axis, vec, *_ = chain.factors
    unit: list[list[Polynomial]] = [[{(): 1.0} if i == j else {} for j in range(3)] for i in range(3)]
    out = [unit for _ in kind]
    bed = _bed(chain) if frame == "axes" else 0
    turn = unit
    for f in range(bed, len(kind)):
        out[f] = turn
        if kind[f] == k.TURN:
            turn = _product(turn, _rotation(chain.axes[axis[f]], vec[f]))
    turn = unit
    for f in range(bed - 1, -1, -1):
        if kind[f] == k.TURN:
            back = _rotation(chain.axes[axis[f]], vec[f])
            turn = _product(turn, [[back[j][i] for j in range(3)] for i in range(3)])
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


def _rotation(name: str, v: np.ndarray) -> list[list[Polynomial]]:
    """Rodrigues' formula in symbols: c I + s [v]x + (1 - c) v v'."""
    c, s = (f"cos {name}",), (f"sin {name}",)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    out = []
    for i in range(3):
        row = []
        for j in range(3):
            vv = float(v[i] * v[j])
            letters = {(): vv, c: float(i == j) - vv, s: float(cross[i, j])}
            row.append({key: x for key, x in letters.items() if abs(x) > _TINY})
        out.append(row)
    return out


def _row(row: list[Polynomial], column: list[Polynomial]) -> Polynomial:
    total: Polynomial = {}
    for a, b in zip(row, column, strict=True):
        total = add(total, times(a, b))
    return total


def _product(a: list[list[Polynomial]], b: list[list[Polynomial]]) -> list[list[Polynomial]]:
    return [[_row(a[i], [b[m][j] for m in range(3)]) for j in range(3)] for i in range(3)]


def _named(chain: Chain, rows: dict[tuple[int, int], Polynomial], frame: str) -> dict[tuple[str, str], Polynomial]:
    if frame == "workpiece":
        names = ["E_X", "E_Y", "E_Z", "E_A", "E_B", "E_C"]
        return {(names[i], chain.components[c]): p for (i, c), p in sorted(rows.items()) if p}
    linear = chain.machine.linear_axes()
    _linear_axes_stand(chain, linear)
    directions = np.array([chain.machine.direction(a) for a in linear]).T
    undo = np.linalg.pinv(directions)
    out: dict[tuple[str, str], Polynomial] = {}
    for c, component in enumerate(chain.components):
        for a, name in enumerate(linear):
            total: Polynomial = {}
            for m in range(3):
                total = add(total, rows.get((m, c), {}), float(undo[a, m]))
            if total:
                out[name, component] = total
    return out


def _linear_axes_stand(chain: Chain, linear: tuple[str, ...]) -> None:
    links = [n.rstrip("'") for n in chain.machine.chain]
    bed = links.index("bed")
    for name in linear:
        place = links.index(name)
        between = links[min(place, bed) + 1 : max(place, bed)]
        turning = [n for n in between if n in chain.axes and n not in linear]
        if turning:
            raise ValueError(
                f"{', '.join(turning)} turns {name} against the bed; corrections by axis have no fixed direction"
            )
