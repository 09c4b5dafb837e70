"""A column heated from the front: its temperatures, and how far it leans (Ni 1997, Fig. 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu


@dataclass(frozen=True)
class Column:
    """A column in the plane: width x height, m; heat enters at `heat` (height fractions) of the front face.

    loss: h / k of the faces, 1/m; diffusivity: m2/s; the base is held at the start temperature; cells across.
    """

    width: float = 0.4
    height: float = 1.2
    heat: tuple[float, float] = (0.65, 0.8)
    loss: float = 0.25
    diffusivity: float = 1.3e-5
    across: int = 12

    @property
    def shape(self) -> tuple[int, int]:
        """Cells (up, across)."""
        return round(self.across * self.height / self.width), self.across

    @property
    def spacing(self) -> float:
        """Side of a cell, m."""
        return self.width / self.across

    def places(self) -> tuple[np.ndarray, np.ndarray]:
        """Height fraction and depth fraction (0 front) of each cell, both (up, across)."""
        up, across = self.shape
        return np.meshgrid((np.arange(up) + 0.5) / up, (np.arange(across) + 0.5) / across, indexing="ij")

    def respond(self, times: np.ndarray, flux: np.ndarray) -> np.ndarray:
        """Temperature rise per unit flux gradient (K per K/m of the heated face), (times, up, across); implicit Euler.

        flux[i] acts from times[i-1] to times[i] (s); a new factorisation per new step length.
        """
        up, across = self.shape
        system, source = self._system()
        state, before, factors = np.zeros(up * across), 0.0, {}
        out = np.empty((times.size, up, across))
        for i, (now, heat) in enumerate(zip(times, flux, strict=True)):
            step = round(now - before, 9)
            before = now
            if step not in factors:
                factors[step] = splu(sparse.identity(up * across, format="csc") + step * system)
            state = factors[step].solve(state + step * heat * source)
            out[i] = state.reshape(up, across)
        return out

    def _system(self) -> tuple[sparse.csc_matrix, np.ndarray]:
        """Rate matrix (1/s) and source (K/s per K/m) of the cells, rows first."""
        up, across = self.shape
        h, a = self.spacing, self.diffusivity

        def line(n: int, low: float, high: float) -> sparse.csr_matrix:
            main = np.full(n, 2.0)
            main[0], main[-1] = 1.0 + low, 1.0 + high
            return sparse.diags([main, -np.ones(n - 1), -np.ones(n - 1)], [0, 1, -1], format="csr")

        face = self.loss * h / (1.0 + self.loss * h / 2.0)
        vertical = sparse.kron(line(up, 2.0, face), sparse.identity(across))
        level = sparse.kron(sparse.identity(up), line(across, face, face))
        heated = np.zeros((up, across))
        where = (np.arange(up) + 0.5) / up
        heated[(where >= self.heat[0]) & (where <= self.heat[1]), 0] = a / h
        return ((vertical + level) * (a / h**2)).tocsc(), heated.ravel()

    def lean(self, field: np.ndarray) -> np.ndarray:
        """How far the spindle leans back per alpha, (times,), m K: thermal curvature integrated twice up to it.

        field: (times, up, across). Curvature at a height = 12 / width^3 * integral of T (depth - middle); beam theory.
        """
        up, across = self.shape
        depth = (np.arange(across) + 0.5) * self.spacing - self.width / 2.0
        curvature = 12.0 / self.width**3 * (field @ depth) * self.spacing
        top = round(float(np.mean(self.heat)) * up)
        arm = (top - np.arange(top) - 0.5) * self.spacing
        return -(curvature[:, :top] @ arm) * self.spacing
