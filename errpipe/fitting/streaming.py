"""Least squares over rows that never stand in memory together: QR accumulated over chunks.

Only the triangular factor of [design | response] is kept, p + 1 columns square, so memory does not grow with
rows. Factors merge (QR of stacked factors), so parts of a fleet or of a year can be fitted apart and joined.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from errpipe.errors import DataError, NotIdentifiable
from errpipe.fitting.solve import LOWEST_RANK, one_thread

ROWS_AT_ONCE = 4096  # per decomposition: [chunk | factor] stays within a core's second-level cache (1024..8192 alike)


class StreamingFit:
    """Accumulates rows; `solve` gives what numpy's lstsq would give on all of them at once."""

    def __init__(self, columns: int):
        self.columns = columns
        self.rows = 0
        self._factor = np.zeros((0, columns + 1))

    def add(self, design: np.ndarray, response: np.ndarray) -> StreamingFit:
        """Take in rows: design (n, p), response (n,). Rows with a missing value are left out."""
        if design.shape[1] != self.columns or design.shape[0] != response.size:
            raise DataError(f"streaming fit: a chunk of shape {design.shape} for {self.columns} columns")
        with one_thread():
            for start in range(0, response.size, ROWS_AT_ONCE):
                part = slice(start, start + ROWS_AT_ONCE)
                self._take(np.column_stack([design[part], response[part]]))
        return self

    def merge(self, other: StreamingFit) -> StreamingFit:
        """Join what another one has taken in."""
        with one_thread():
            self._factor = _factor(np.vstack([self._factor, other._factor]))
        self.rows += other.rows
        return self

    def _take(self, block: np.ndarray) -> None:
        total = block.sum(axis=1)
        if not np.isfinite(total).all():
            block = block[np.isfinite(block).all(axis=1)]
        self.rows += block.shape[0]
        self._factor = _factor(np.vstack([self._factor, block]))

    def solve(self) -> tuple[np.ndarray, np.ndarray, float]:
        """(coefficients (p,), (design' design)^-1 (p, p), residual sum of squares).

        Raises NotIdentifiable where a column is a combination of others.
        """
        p = self.columns
        if self.rows < p:
            raise NotIdentifiable(f"fit: {self.rows} rows cannot tell {p} parameters")
        factor = self._factor
        length = np.sqrt(np.sum(factor[:, :p] ** 2, axis=0))
        length[length == 0] = 1.0
        q, r = np.linalg.qr(factor[:, :p] / length)
        pivots = np.abs(np.diag(r))
        if pivots.min() <= LOWEST_RANK * pivots.max():
            raise NotIdentifiable(f"fit: column {int(np.argmin(pivots)) + 1} is a combination of those before it")
        inner = np.linalg.solve(r, np.eye(p))
        coefficients = inner @ (q.T @ factor[:, p])
        left = factor[:, p] - factor[:, :p] @ (coefficients / length)
        return coefficients / length, (inner @ inner.T) / np.outer(length, length), float(left @ left)


def _factor(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def fit_chunks(chunks: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, float]:
    """`StreamingFit` over (design, response) chunks. Raises DataError where there is none."""
    running: StreamingFit | None = None
    for design, response in chunks:
        running = running or StreamingFit(design.shape[1])
        running.add(design, response)
    if running is None:
        raise DataError("streaming fit: no rows")
    return running.solve()
