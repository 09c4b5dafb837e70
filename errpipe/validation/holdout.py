"""Hold-outs of a calendar: every scheme of `fitting.holdout`, and months and days told from the recording's dates.

leave-one-group-out:season   leave-one-group-out:duty_cycle   leave-one-group-out:day   leave-one-run-out
forward:month                forward:day                      blocks:6
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np

from errpipe.domain.recording import Column, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.holdout import Fold, HoldOut

CALENDAR = {"day": 10, "month": 7, "year": 4}  # characters of an ISO 8601 date that name it


def folds(recording: Recording, scheme: HoldOut | str) -> list[Fold]:
    """Folds of a scheme in order of first appearance, rows of `recording`; months and days need no column of their own.

    Raises DataError where the recording has no such group, no date, or only one group.
    """
    chosen = holdout.parse(scheme) if isinstance(scheme, str) else scheme
    return holdout.groups(with_calendar(recording, chosen.of), chosen)


def with_calendar(recording: Recording, of: str | None) -> Recording:
    """The recording with a group column for a day, month or year that it lacks; else itself."""
    if of not in CALENDAR or any(of in (n, recording.manifest.columns[n].of) for n in recording.names("group")):
        return recording
    return recording.with_columns({of: calendar(recording, of)}, {of: Column(role="group", of=of)})


def calendar(recording: Recording, of: str) -> np.ndarray:
    """Day, month or year of each row as text, shape (rows,): from the column of days, else from the time's epoch."""
    length = CALENDAR[of]
    for name in recording.names("group"):
        if recording.manifest.columns[name].of == "day":
            return np.array([str(v)[:length] for v in recording.frame[name]], dtype=object)
    time = recording.name("time")
    epoch = recording.manifest.columns[time].epoch if time else None
    if epoch is None:
        raise DataError(f"hold-out by {of}: the recording has neither a column of days nor an epoch of its time")
    start = datetime.fromisoformat(epoch).astimezone(UTC)
    days = np.floor(recording.time() / 60.0)
    known = {m: (start + timedelta(minutes=float(m))).isoformat()[:length] for m in np.unique(days)}
    return np.array([known[m] for m in days], dtype=object)


def subset(fold: Fold, rows: np.ndarray) -> Fold:
    """The fold with only the training rows of a mask."""
    return Fold(fold.label, fold.train & rows, fold.test)
