"""A spindle as a bar heated at its nose (Ni 1997, Fig. 7): its temperatures and its growth.

    theta_Fo = theta_xx - mL2 theta on 0..1, flux at x = 0, end insulated, losing (Be) or held cold

Linear with constant coefficients, so the response to a piecewise constant flux is exact
in time (matrix exponential through the eigenvectors of a symmetric matrix); only space is discretised (finite volumes).
Dimensionless: x in bar lengths, time Fo = a t / L2, mL2 = h P L2 / (k A), Be = h_e L / k, growth = mean of theta
(times alpha L for um).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

CELLS = 200  # finite volumes along the bar


@dataclass(frozen=True)
class Bar:
    """One bar. loss: mL2; end: Be of the free end, `inf` holds it cold; cells: finite volumes."""

    loss: float = 1.5
    end: float = 0.0
    cells: int = CELLS

    @property
    def places(self) -> np.ndarray:
        """Centres of the cells, shape (cells,), in bar lengths from the heated end."""
        return (np.arange(self.cells) + 0.5) / self.cells

    @cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray]:
        n, h = self.cells, 1.0 / self.cells
        diagonal = np.full(n, 2.0 / h**2 + self.loss)
        diagonal[0] -= 1.0 / h**2
        half_cell = 2.0 / h
        through = half_cell if np.isinf(self.end) else self.end * half_cell / (self.end + half_cell)
        diagonal[-1] += -1.0 / h**2 + through / h
        matrix = np.diag(diagonal) - np.diag(np.full(n - 1, 1.0 / h**2), 1) - np.diag(np.full(n - 1, 1.0 / h**2), -1)
        values, vectors = np.linalg.eigh(matrix)
        return np.maximum(values, 0.0), vectors

    def respond(self, times: np.ndarray, flux: np.ndarray) -> np.ndarray:
        """theta at `times` (n,) for a flux held between them: flux[i] acts from times[i-1] to times[i]. -> (n, cells).

        The bar is cold at time 0.
        """
        values, vectors = self._modes
        source = vectors[0] * self.cells
        state, out = np.zeros(self.cells), np.empty((times.size, self.cells))
        for i, (step, heat) in enumerate(zip(np.diff(times, prepend=0.0), flux, strict=True)):
            decay = np.exp(-values * step)
            grown = np.where(values > 1e-9, -np.expm1(-values * step) / np.maximum(values, 1e-9), step)
            state = decay * state + grown * source * heat
            out[i] = vectors @ state
        return out


def growth(theta: np.ndarray) -> np.ndarray:
    """Mean temperature rise along the bar, (times,): growth over alpha L."""
    return theta.mean(axis=1)


def random_duty(segments: int, steps: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A duty cycle of random fluxes 0..2.5 in segments of Fo 0.2: (times, flux), each (segments * steps,)."""
    rng = np.random.default_rng(seed)
    level = np.repeat(rng.uniform(0.0, 2.5, segments), steps)
    times = (np.arange(segments * steps) + 1) * (0.2 / steps)
    return times, level
