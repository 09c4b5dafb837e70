"""The time by which a known signal comes late in a mismatch."""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.simulated import DelayDifference
from errpipe.terms._search import Signals

PRECISION = 1e-5  # sampling steps


def shift_of(late: DelayDifference, recording: Recording, signals: Signals, trial: np.ndarray, step: float) -> float:
    """The delay in s with the smallest residual: among those tried (ascending), then between its neighbours.

    step: sampling interval in s.
    """
    from scipy.optimize import minimize_scalar

    rest_of = _residual_squares(late, recording, signals)
    k = int(np.argmin([rest_of(float(delay)) for delay in trial]))
    low, high = trial[max(k - 1, 0)], trial[min(k + 1, trial.size - 1)]
    near = minimize_scalar(rest_of, bounds=(low, high), method="bounded", options={"xatol": PRECISION * step})
    return float(near.x)


def _residual_squares(late: DelayDifference, recording: Recording, signals: Signals):
    """Residual sum of squares of a delay with a datum and a gain of the signal."""
    known = late.signal(recording)[signals.rows]
    beside = np.column_stack([np.ones(known.size), known / max(float(np.abs(known).max()), 1e-300)])
    basis, _ = np.linalg.qr(beside)

    def of(delay: float) -> float:
        rest = signals.whole() - DelayDifference(delay, late.name, late.axis).value(recording)[signals.rows]
        rest = rest - basis @ (basis.T @ rest)
        return float(rest @ rest)

    return of
