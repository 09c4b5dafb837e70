"""Stepped shafts and tools under a static force: Timoshenko beam elements between springs.

The stiffness of an element of length L: Przemieniecki, Theory of Matrix Structural Analysis (1968), section 5.6,
with Phi = 12 E I / (k G A L^2); point forces at nodes are exact. Lengths in mm, forces in N, compliance in um/N.
Shear factors k: Cowper, Journal of Applied Mechanics 33 (1966) 335.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

UM_PER_MM = 1e3
STEEL = (210e3, 0.3)  # Young's modulus, N/mm2; Poisson's ratio


@dataclass(frozen=True)
class Section:
    """A prismatic part: length; diameter and bore, or width and height (in the direction of the force), mm."""

    length: float
    diameter: float = 0.0
    bore: float = 0.0
    width: float = 0.0
    height: float = 0.0

    def area(self) -> float:
        """Cross section, mm2."""
        return self.width * self.height if self.width else np.pi / 4 * (self.diameter**2 - self.bore**2)

    def inertia(self) -> float:
        """Second moment of area, mm4."""
        return self.width * self.height**3 / 12 if self.width else np.pi / 64 * (self.diameter**4 - self.bore**4)

    def shear_factor(self, poisson: float) -> float:
        """Cowper's factor of the section."""
        if self.width:
            return 10 * (1 + poisson) / (12 + 11 * poisson)
        m = (self.bore / self.diameter) ** 2
        above = 6 * (1 + poisson) * (1 + m) ** 2
        return above / ((7 + 6 * poisson) * (1 + m) ** 2 + (20 + 12 * poisson) * m)


@dataclass(frozen=True)
class Support:
    """Springs at the clamped end (N/um; N m/urad, turning) and at the other end (N/um): None is rigid, 0 is free."""

    radial: float | None = None
    turning: float | None = None
    far: float | None = 0.0


def compliance(
    parts: Sequence[Section],
    at: np.ndarray,
    support: Support | None = None,
    young: float = STEEL[0],
    poisson: float = STEEL[1],
) -> np.ndarray:
    """Displacement per force where the force acts, at distances `at` (n,) from the clamped end; um/N, shape (n,).

    Raises ValueError for a position that is not on the shaft.
    """
    support = support or Support()
    ends = np.cumsum([0.0, *(part.length for part in parts)])
    at = np.asarray(at, dtype=float)
    if at.size and (at.min() < -1e-9 or at.max() > ends[-1] + 1e-9):
        raise ValueError(f"a force at {at.min():g} to {at.max():g} mm is not on a shaft of {ends[-1]:g} mm")
    nodes = np.unique(np.round(np.r_[ends, np.clip(at, 0.0, ends[-1])], 9))
    stiff = np.zeros((2 * len(nodes), 2 * len(nodes)))
    for i, (start, stop) in enumerate(pairwise(nodes.tolist())):
        part = parts[min(int(np.searchsorted(ends, (start + stop) / 2, side="right")) - 1, len(parts) - 1)]
        stiff[2 * i : 2 * i + 4, 2 * i : 2 * i + 4] += _element(part, stop - start, young, poisson)
    springs = ((0, support.radial, 1e3), (1, support.turning, 1e9), (len(stiff) - 2, support.far, 1e3))
    for place, size, scale in springs:  # N/um -> N/mm; N m/urad -> N mm/rad
        stiff[place, place] += (size or 0.0) * scale
    free = np.setdiff1d(np.arange(len(stiff)), [place for place, size, _ in springs if size is None])
    flexible = np.zeros(len(stiff))
    flexible[free] = np.diag(np.linalg.inv(stiff[np.ix_(free, free)]))
    return flexible[2 * np.searchsorted(nodes, np.round(np.clip(at, 0.0, ends[-1]), 9))] * UM_PER_MM


def _element(part: Section, length: float, young: float, poisson: float) -> np.ndarray:
    bend = young * part.inertia()
    shear = part.shear_factor(poisson) * young / (2 * (1 + poisson)) * part.area()
    phi = 12 * bend / (shear * length**2)
    h = length
    matrix = np.array(
        [
            [12, 6 * h, -12, 6 * h],
            [6 * h, (4 + phi) * h**2, -6 * h, (2 - phi) * h**2],
            [-12, -6 * h, 12, -6 * h],
            [6 * h, (2 - phi) * h**2, -6 * h, (4 + phi) * h**2],
        ]
    )
    return matrix * bend / ((1 + phi) * h**3)
