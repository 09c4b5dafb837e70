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
    """Residual sum of squares of a delay with a datum and a gain of the signal.

    A simulated signal has one gain, late as it is: with a gain of the undelayed signal instead, a delay times the gain
    is found. Of a position the deviation is recorded, and the gain beside it is that of a scale.
    """
    known = late.signal(recording)[signals.rows]
    size, datum = max(float(np.abs(known).max()), 1e-300), np.ones(known.size)
    still, _ = np.linalg.qr(np.column_stack([datum, known / size]))
    recorded = signals.whole() + known

    def of(delay: float) -> float:
        moved = DelayDifference(delay, late.name, late.axis).value(recording)[signals.rows]
        if late.axis:
            rest, basis = signals.whole() - moved, still
        else:
            rest, basis = recorded, np.linalg.qr(np.column_stack([datum, (known + moved) / size]))[0]
        rest = rest - basis @ (basis.T @ rest)
        return float(rest @ rest)

    return of
