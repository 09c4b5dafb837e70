"""Two sensors whose plugs were exchanged in one run: each then follows the rest of the machine as the other does."""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Recording

LEFT = 1 / 3  # of the residuals of both sensors, once they are exchanged back; chosen on a simulated grinding spindle
MIN_ROWS, ENOUGH = 50, 2000  # rows of a run, and about those that a fit is made to


def partner(recording: Recording, name: str) -> str:
    """A message that names the sensor and the run with which `name` was exchanged, or ''.

    Either is predicted from all others, by a linear fit to the other runs. At least four sensors are needed.
    """
    names, run = recording.names("temperature"), recording.run_codes()
    if len(names) < 4 or name not in names:
        return ""
    held = pd.DataFrame({n: recording.array(n) for n in names}).groupby(run).ffill().assign(one=1.0)
    whole, best, hint = held.notna().all(axis=1).to_numpy(), LEFT, ""
    for other in [n for n in names if n != name]:
        rest = held.drop(columns=[name, other]).to_numpy()
        pair = held[[name, other]].to_numpy()
        for code in np.unique(run[whole]):
            own, fitted = whole & (run == code), whole & (run != code)
            if own.sum() < MIN_ROWS or not fitted.any():
                continue
            some = np.flatnonzero(fitted)[:: max(int(fitted.sum()) // ENOUGH, 1)]
            predicted = rest[own] @ np.linalg.lstsq(rest[some], pair[some], rcond=None)[0]
            as_is, back = (float(np.abs(p - predicted).mean()) for p in (pair[own], pair[own][:, ::-1]))
            if back < best * as_is:
                best, hint = (
                    back / as_is,
                    f"{name} and {other} seem to be exchanged in run {recording.run_labels()[code]}",
                )
    return hint and f" {hint} (exchanged back, both follow the other sensors {1 / best:.3g} times as closely)."
