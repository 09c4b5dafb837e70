"""Rows without a time, and rows whose time lies before that of an earlier row of their run."""

from __future__ import annotations

from bisect import bisect_right
from typing import Literal

import numpy as np

from errpipe.cleaning._base import Action, Rule, rows_of_runs
from errpipe.domain.recording import Recording
from errpipe.yamlfile import quantity


class TimeOrder(Rule):
    """Remove the smallest number of rows such that time never decreases in a run; and rows without a time.

    A recording folder with such a step is already refused on reading; other sources may have it.
    """

    rule: Literal["time_order"] = "time_order"
    most: float = quantity("1", "Refuse to remove more than this share of the rows.", 0.01, gt=0, le=1)

    def find(self, recording: Recording) -> list[Action]:
        """Rows to remove. Raises DataError beyond the stated share."""
        time = recording.name("time")
        if time is None:
            return []
        t, run = recording.array(time), recording.run_codes()
        without = np.flatnonzero(np.isnan(t))
        back = []
        for run_rows in rows_of_runs(run):
            rows = run_rows[~np.isnan(t[run_rows])]
            if np.any(np.diff(t[rows]) < 0):
                back.append(rows[~_longest_rise(t[rows])])
        earlier = np.sort(np.concatenate(back)) if back else without[:0]
        actions = []
        for rows, reason in ((without, "no time"), (earlier, "time before that of an earlier row of the run")):
            if rows.size:
                self.refuse_beyond(self.most, rows, len(recording), "rows", recording)
                actions.append(Action("remove rows", reason, rows=rows))
        return actions


def _longest_rise(t: np.ndarray) -> np.ndarray:
    """Mask of one longest subsequence that never falls (patience sorting), shape of t."""
    tails: list[float] = []
    last: list[int] = []
    before = np.full(t.size, -1)
    for i, value in enumerate(t.tolist()):
        k = bisect_right(tails, value)
        before[i] = last[k - 1] if k else -1
        tails[k : k + 1] = [value]
        last[k : k + 1] = [i]
    kept = np.zeros(t.size, dtype=bool)
    i = last[-1]
    while i >= 0:
        kept[i] = True
        i = before[i]
    return kept
