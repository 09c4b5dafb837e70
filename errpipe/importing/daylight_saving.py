"""Logs of another device that begin and end whole hours before or after a run: daylight saving time in one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

MOST = 2  # h: two time zones
AGREE = 300.0  # s, by judgement: loggers are started and stopped by hand, some minutes from each other


def note(stem: str, run: Sequence[str], at: np.ndarray, clock: np.ndarray, longest: float) -> list[str]:
    """A note for all runs that a log misses by the same hours at both ends; none for one that goes on between runs.

    run, at: run and time of each deviation, s; clock: ascending times of the log, s; longest: that is no break of it.
    """
    after = np.flatnonzero(np.diff(clock) > longest) + 1
    begins, ends = clock[np.r_[0, after]], clock[np.r_[after, clock.size] - 1]
    found = dict[int, list[str]]()
    for label, own in pd.Series(at).groupby(np.asarray(run), sort=False):
        k = int(np.argmax(np.minimum(ends, own.max()) - np.maximum(begins, own.min())))
        off = np.array([begins[k] - own.min(), ends[k] - own.max()])
        hours = round(float(off.mean()) / 3600.0)
        if 1 <= abs(hours) <= MOST and np.abs(off - 3600.0 * hours).max() <= AGREE:
            found.setdefault(hours, []).append(str(label))
    return [
        f"{stem}: its rows begin and end {abs(h)} h {'later' if h > 0 else 'earlier'} than the deviations of "
        f"{', '.join(labels)}: daylight saving time in one of the two? If so, shift the times of one"
        for h, labels in found.items()
    ]
