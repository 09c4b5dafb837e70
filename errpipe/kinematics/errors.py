"""The values of a machine's components: curves over the axes, and constants.

A curve is a uniform grid with linear interpolation between its points, held beyond its ends, identical
here and in a controller. `MachineErrors.of` samples any functions.
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
    """A curve of a document as a function of position: linear between its points, held beyond its ends."""
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
        """Sample functions of position (mm, deg) and take constants (um, urad). Missing components are zero.

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
