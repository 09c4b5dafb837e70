"""Rows that a robust fit rejects: outliers of single runs, or what the terms cannot describe?

An outlier is not repeated. Where a curve has too few degrees, every run leaves the same residual at the same place; a
redescending loss then takes the ends of the travel for outliers and leaves a curve that is far off there.
"""

from __future__ import annotations

import numpy as np

from errpipe.fitting.solve import Solution

REJECTED = 1e-6  # weight: below, Tukey's biweight is zero
FEWEST_RUNS = 3  # of two, one may hold the outlier
# Of the rejected rows: that are repeated by most other runs. Of outliers at random in 30 % of the rows of three or more
# runs, half of them of either sign, 2.3 % at most are repeated by chance; of the ends of a curve, nearly all.
SHARE = 0.1
MOST_ROWS = 2000  # rejected rows that are compared


def is_repeated(design: np.ndarray, solution: Solution, sequence: np.ndarray) -> bool:
    """Whether most other runs leave a residual of the same sign, and rejected, too, in the same state of the machine.

    design: (n, p); sequence: run of each row, (n,). The same state is the row of a run whose columns are nearest.
    """
    from scipy.spatial import cKDTree

    sign = np.where(solution.weights < REJECTED, np.sign(solution.residual), 0.0)
    rejected, runs = np.flatnonzero(sign), np.unique(sequence)
    if rejected.size == 0 or runs.size < FEWEST_RUNS:
        return False
    rejected = rejected[:: -(-rejected.size // MOST_ROWS)]
    spread = design.std(axis=0)
    states = design[:, spread > 0] / spread[spread > 0]
    repeated = np.zeros(rejected.size)
    if states.shape[1] == 0:
        return False
    for run in runs:
        rows = np.flatnonzero(sequence == run)
        near = rows[cKDTree(states[rows]).query(states[rejected])[1]]
        repeated += (sequence[rejected] != run) & (sign[near] == sign[rejected])
    return bool(np.mean(repeated > (runs.size - 1) / 2) >= SHARE)
