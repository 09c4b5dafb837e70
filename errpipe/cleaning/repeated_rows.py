"""Rows that a logger wrote twice: every cell as in the row before, time included."""

from __future__ import annotations

from typing import Literal

import numpy as np

from errpipe.cleaning._base import Action, Rule
from errpipe.domain.recording import Recording
from errpipe.yamlfile import quantity


class RepeatedRows(Rule):
    """Remove a row whose every cell, time included, equals that of the row before it.

    Without a time column nothing is removed: two equal readings are then two readings.
    """

    rule: Literal["repeated_rows"] = "repeated_rows"
    most: float = quantity("1", "Refuse to remove more than this share of the rows.", 0.1, gt=0, le=1)

    def find(self, recording: Recording) -> list[Action]:
        """Rows to remove. Raises DataError beyond the stated share."""
        time = recording.name("time")
        if time is None or len(recording) < 2:
            return []
        t = recording.array(time)
        rows = np.flatnonzero(np.r_[False, t[1:] == t[:-1]])
        before, here = recording.frame.iloc[rows - 1], recording.frame.iloc[rows]
        equal = (before.to_numpy() == here.to_numpy()) | (before.isna().to_numpy() & here.isna().to_numpy())
        repeated, still = rows[equal.all(axis=1)], rows[~equal.all(axis=1)]
        actions = []
        if repeated.size:
            self.refuse_beyond(self.most, repeated, len(recording), "rows", recording)
            actions.append(Action("remove rows", "equal to the row before in every cell, time included", rows=repeated))
        if still.size:
            actions.append(Action("note", "same time as the row before, other readings: kept", rows=still))
        return actions
