"""The values of a machine's components: curves over the axes, and constants.

A curve is a uniform grid read with straight lines between its points and held beyond its ends, the same on
this side and in a controller. `MachineErrors.of` takes any functions and grids them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe.kernels import volumetric as k
from errpipe.kinematics.chain import Chain


def positions_of(curve: Mapping[str, Any]) -> np.ndarray:
    """Positions, mm (deg), of the points of a curve in a document: its `start`, `step` and `value`s."""
    return curve["start"] + curve["step"] * np.arange(len(curve["value"]))


def interpolated(curve: Mapping[str, Any]) -> Callable[[np.ndarray], np.ndarray]:
    """A curve of a document as a function of position: straight between its points, held beyond its ends."""
    grid = positions_of(curve)
    return lambda p: np.interp(p, grid, curve["value"])


@dataclass(frozen=True)
class MachineErrors:
    """Values of all components of a chain.

    start, step: of each axis' grid (axes,); tables: one (nodes, 6) array per axis, X Y Z A B C in um and urad;
    constants: (components,), 0 for error motions.
    """

    chain: Chain
    start: np.ndarray
    step: np.ndarray
    tables: tuple[np.ndarray, ...]
    constants: np.ndarray

    @classmethod
    def of(
        cls, chain: Chain, values: Mapping[str, Callable[[np.ndarray], np.ndarray] | float], nodes: int = 201
    ) -> MachineErrors:
        """Grid functions of position (mm, deg) and take constants (um, urad). Components left out are zero.

        Raises KeyError for a component the machine does not have.
        """
        for name in values:
            chain.index(name)
        start, stop = chain.travel.T
        step = (stop - start) / (nodes - 1)
        tables = []
        for a, axis in enumerate(chain.axes):
            grid = start[a] + step[a] * np.arange(nodes)
            table = np.zeros((nodes, 6))
            for column, name in enumerate(chain.of_axis(axis)):
                value = values.get(name, 0.0)
                table[:, column] = value(grid) if callable(value) else float(value)
            tables.append(table)
        constants = np.zeros(len(chain.components))
        for i, name in enumerate(chain.components):
            if chain.drives[i] < 0:
                value = values.get(name, 0.0)
                if callable(value):
                    raise TypeError(f"{name} does not depend on a position: it takes a number")
                constants[i] = value
        return cls(chain, start, step, tuple(tables), constants)

    def at(self, q: np.ndarray) -> np.ndarray:
        """Values of all components at axis positions q (n, axes), shape (n, components)."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        out = np.tile(self.constants, (len(q), 1))
        for a, axis in enumerate(self.chain.axes):
            columns = [self.chain.index(n) for n in self.chain.of_axis(axis)]
            out[:, columns] = k.curves(np.ascontiguousarray(q[:, a]), self.start[a], self.step[a], self.tables[a])
        return out

    def curve(self, component: str) -> tuple[np.ndarray, np.ndarray]:
        """Grid and values of an error motion. Raises KeyError for a constant or an unknown component."""
        a = int(self.chain.drives[self.chain.index(component)])
        if a < 0:
            raise KeyError(f"{component} is a constant, not a curve")
        table = self.tables[a]
        column = self.chain.of_axis(self.chain.axes[a]).index(component)
        return self.start[a] + self.step[a] * np.arange(len(table)), table[:, column]

    def scaled(self, factor: float) -> MachineErrors:
        """All components times a factor."""
        tables = tuple(t * factor for t in self.tables)
        return MachineErrors(self.chain, self.start, self.step, tables, self.constants * factor)


@dataclass(frozen=True)
class ThreeAxisVolume:
    """Tool-point deviation of a machine whose axes are all three linear, in one pass over the points.

    Beyond an axis' travel everything that belongs to it keeps its last value, its squareness too.
    """

    axes: np.ndarray
    facts: np.ndarray
    rows: np.ndarray
    nodes: int

    @classmethod
    def of(cls, errors: MachineErrors) -> ThreeAxisVolume:
        """Prepare the arrays. Raises ValueError where an axis is rotary or the spindle is tilted."""
        chain = errors.chain
        kind, axis, vec, point, inverse, entries, comp, angle, evec = chain.factors
        if len(chain.axes) != 3 or (kind == k.TURN).any():
            raise ValueError("the one-pass form is for three linear axes")
        tables = np.stack(errors.tables)
        direction, reference, location = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3))
        moves = np.flatnonzero(kind == k.MOVE)
        direction[axis[moves]] = vec[moves]
        own_first, shift = np.zeros(3, dtype=np.bool_), np.zeros(3)
        for f in np.flatnonzero(kind == k.ERROR):
            part = slice(entries[f], entries[f + 1])
            sign = -1.0 if inverse[f] else 1.0
            a = int(chain.drives[comp[part][0]])
            if a >= 0:
                tables[a] *= sign
                reference[a] = point[f]
                own_first[a] = f < moves[axis[moves] == a][0]
                continue
            values = errors.constants[comp[part]]
            turn = (values * angle[part]) @ evec[part] * k.UM
            if turn.any() and any(chain.components[c][2:] == "S" for c in comp[part]):
                raise ValueError("the one-pass form has no spindle tilt")
            shift += sign * (values * ~angle[part]) @ evec[part]
            for b in axis[moves[moves > f]]:
                location[b] += sign * np.cross(turn, direction[b])
        tables[0, :, :3] += shift
        order = axis[moves][::-1]
        facts, rows = np.zeros((3, 12)), np.zeros((3, tables.shape[1], 8))
        for i, a in enumerate(order):
            facts[i, :9] = np.r_[errors.start[a], 1 / errors.step[a], direction[a], reference[a], own_first[a]]
            grid = errors.start[a] + errors.step[a] * np.arange(tables.shape[1])
            rows[i, :, :3] = tables[a, :, :3] + grid[:, None] * location[a]
            rows[i, :, 4:7] = tables[a, :, 3:] * k.UM
        return cls(order.astype(np.uintp), facts.ravel(), rows.ravel(), tables.shape[1])

    def __call__(self, q: np.ndarray, tip: np.ndarray, out: np.ndarray | None = None) -> np.ndarray:
        """Deviation (n, 3), um, at q (n, 3) and tip (n, 3), both contiguous float64, mm."""
        out = np.empty((len(q), 3)) if out is None else out
        k.linear_axes(q.reshape(-1), tip.reshape(-1), self.axes, self.facts, self.rows, self.nodes, out.reshape(-1))
        return out
