"""Time and travel since events. `run` holds an integer per row; states restart where it changes."""

from __future__ import annotations

import numpy as np

from errpipe.kernels import kernel


@kernel
def since_turn(run, t, d):
    """Time since d last changed its sign, shape of t; infinity before the first change of a run."""
    y = np.empty(t.size)
    last = -np.inf
    held = np.nan
    for i in range(t.size):
        if i == 0 or run[i] != run[i - 1]:
            last = -np.inf
            held = np.nan
        if not np.isnan(d[i]) and d[i] != 0.0:
            if not np.isnan(held) and d[i] != held:
                # the sign changed somewhere between the rows: take the middle
                last = 0.5 * (t[i] + t[i - 1])
            held = d[i]
        y[i] = t[i] - last
    return y


@kernel
def travelled(run, x):
    """Distance moved between a row and the one before it, shape of x; 0 at the start of a run and over gaps."""
    y = np.zeros(x.size)
    held = np.nan
    for i in range(x.size):
        if i == 0 or run[i] != run[i - 1]:
            held = x[i]
        elif not np.isnan(x[i]):
            if not np.isnan(held):
                y[i] = abs(x[i] - held)
            held = x[i]
    return y


def stretches(flags: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends (half open) of the stretches of True, each shape (stretches,)."""
    edges = np.diff(np.r_[False, flags, False].astype(np.int8))
    return np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
