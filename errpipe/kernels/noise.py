"""Coloured noise made white: an ARMA(1,1) filter over runs of rows."""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel


@kernel
def whiten(run, columns, phi, theta, gain):
    """Columns (rows, k) filtered by (1 - phi B) / (1 - theta B) / gain; each run starts anew with its own value."""
    n, k = columns.shape
    out = np.empty((n, k))
    for i in range(n):
        if i == 0 or run[i] != run[i - 1]:
            for j in range(k):
                out[i, j] = columns[i, j]
        else:
            for j in range(k):
                out[i, j] = (columns[i, j] - phi * columns[i - 1, j]) / gain + theta * out[i - 1, j]
    return out


@kernel
def whiten_each(run, columns, out, phi, theta, gain):
    """As `whiten`, the same bits, into `out`: columns and out (k, rows), each column in one piece."""
    k, n = columns.shape
    for first in range(0, k, 4):
        a, b, c, d = first, min(first + 1, k - 1), min(first + 2, k - 1), min(first + 3, k - 1)
        for i in range(n):
            if i == 0 or run[i] != run[i - 1]:
                for j in (a, b, c, d):
                    out[j, i] = columns[j, i]
            else:
                for j in (a, b, c, d):
                    out[j, i] = (columns[j, i] - phi * columns[j, i - 1]) / gain + theta * out[j, i - 1]


@kernel
def coloured(run, columns, phi, theta, gain):
    """The inverse of `whiten`: columns (rows, k) as they were before the filter."""
    n, k = columns.shape
    out = np.empty((n, k))
    for i in range(n):
        if i == 0 or run[i] != run[i - 1]:
            for j in range(k):
                out[i, j] = columns[i, j]
        else:
            for j in range(k):
                out[i, j] = gain * (columns[i, j] - theta * columns[i - 1, j]) + phi * out[i - 1, j]
    return out
