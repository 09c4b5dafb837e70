"""Noise with a memory: white noise plus a first-order autoregressive part, filtered out and multiplied through.

`sequence` holds an integer per row; the noise restarts wherever it changes. Noise variance is 1, of which
`share` is correlated from row to row by `rho`.
"""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel


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
