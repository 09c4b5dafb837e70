"""Coloured noise filtered out, and multiplied through: an ARMA(1,1) filter, and a Kalman filter of an AR(1) part.

`run` or `sequence` holds an integer per row; the noise restarts wherever it changes. In `innovations` and `correlated`
noise has variance 1, of which `share` is correlated from row to row by `rho`.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import bare_kernel, kernel


@kernel
def innovations(sequence, columns, rho, share):
    """Kalman filter of unit noise: (whitened columns, log determinant of the noise covariance).

    columns: shape (rows, k). Exact for the model; least squares on the whitened columns is generalised least squares.
    """
    rows, count = columns.shape
    out = np.empty((rows, count))
    state = np.zeros(count)
    logdet = 0.0
    white = 1.0 - share
    spread = share
    for i in range(rows):
        if i == 0 or sequence[i] != sequence[i - 1]:
            spread = share
            for j in range(count):
                state[j] = 0.0
        total = spread + white
        root = np.sqrt(total)
        logdet += np.log(total)
        gain = spread / total
        for j in range(count):
            surprise = columns[i, j] - state[j]
            out[i, j] = surprise / root
            state[j] = rho * (state[j] + gain * surprise)
        spread = rho * rho * spread * white / total + (1.0 - rho * rho) * share
    return out, logdet


@kernel
def correlated(sequence, columns, rho, share):
    """Noise covariance times columns, shape (rows, k), in two sweeps."""
    rows, count = columns.shape
    out = np.empty((rows, count))
    carry = np.zeros(count)
    for i in range(rows):
        if i == 0 or sequence[i] != sequence[i - 1]:
            carry[:] = 0.0
        for j in range(count):
            out[i, j] = columns[i, j] + share * carry[j]
            carry[j] = rho * (carry[j] + columns[i, j])
    carry[:] = 0.0
    for k in range(rows):
        i = rows - 1 - k
        if i == rows - 1 or sequence[i] != sequence[i + 1]:
            carry[:] = 0.0
        for j in range(count):
            out[i, j] += share * carry[j]
            carry[j] = rho * (carry[j] + columns[i, j])
    return out


@kernel
def whiten(run, columns, phi, theta, gain):
    """Columns (rows, k) filtered by (1 - phi B) / (1 - theta B) / gain; each run restarts with its own value."""
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
    for j in range(k):  # what does not wait for the row before, many rows at a time
        for i in range(1, n):
            out[j, i] = (columns[j, i] - phi * columns[j, i - 1]) / gain
    for first in range(0, k, 4):  # four columns at a time: while one waits for its row before, the others do not
        a, b, c, d = first, min(first + 1, k - 1), min(first + 2, k - 1), min(first + 3, k - 1)
        for i in range(n):
            if i == 0 or run[i] != run[i - 1]:
                at_a, at_b, at_c, at_d = columns[a, i], columns[b, i], columns[c, i], columns[d, i]
            else:
                at_a, at_b = out[a, i] + theta * at_a, out[b, i] + theta * at_b
                at_c, at_d = out[c, i] + theta * at_c, out[d, i] + theta * at_d
            out[a, i], out[b, i], out[c, i], out[d, i] = at_a, at_b, at_c, at_d


@bare_kernel
def fingerprint(column):
    """128 bits that stand for a column's own (rows,), as two integers: four sums in turn, each mixed on.

    No guard against a forger: it tells the columns of one table apart, eight times as fast as SHA-1.
    """
    bits = column.view(np.uint64)
    a, b, c, d = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4)
    odd = np.uint64(0x9E3779B97F4A7C15)
    down = np.uint64(29)
    whole = bits.size // 4 * 4
    for i in range(0, whole, 4):
        a, b = (a ^ bits[i]) * odd, (b ^ bits[i + 1]) * odd
        c, d = (c ^ bits[i + 2]) * odd, (d ^ bits[i + 3]) * odd
        a, b, c, d = a ^ (a >> down), b ^ (b >> down), c ^ (c >> down), d ^ (d >> down)
    for i in range(whole, bits.size):
        a = (a ^ bits[i]) * odd
        a ^= a >> down
    return (a * odd) ^ c, (b * odd) ^ d


@kernel
def unwhiten(run, columns, phi, theta, gain):
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
