"""Sensors that are read less often than the rows: straight lines between their readings."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.drivers.sessions import sessions

SLOW_ROLES = ("temperature", "pressure", "humidity")
MIN_READINGS = 5  # by judgement: fewer show no course
MAX_READ_SHARE = 0.5  # share of rows with a reading, from which the other rows are failures
MAX_GAP = 10.0  # over the mean one; a sensor that is silent for longer failed (chosen: rows lost at random reach 6)
MIN_HELD_ROWS = 3.0  # rows from one reading to the next, from which the rows between hold it


def rows_between(values: np.ndarray) -> int:
    """Usual number of rows from one reading to the next: above 1 of a sensor that is logged less often than rows."""
    known = np.flatnonzero(np.isfinite(values))
    return max(int(np.median(np.diff(known))), 1) if known.size > 1 else 1


def between_readings(recording: Recording) -> Recording:
    """The recording with slow sensors that are read now and then, in fewer than half of the rows, filled in.

    In the other rows they are empty or hold the last reading. Gaps of a sensor that is read in most rows, or that is
    silent for long, are failures and stay.
    """
    filled = {}
    for name in (n for role in SLOW_ROLES for n in recording.names(role)):
        values = recording.array(name)
        read = np.isfinite(values)
        fresh = np.flatnonzero(read & np.r_[True, values[1:] != values[:-1]])
        good = fresh if _held(values[fresh], np.diff(fresh)) else np.flatnonzero(read)
        gaps = np.diff(np.r_[-1, good, values.size])
        regular = gaps.max() * good.size < MAX_GAP * values.size
        if regular and MIN_READINGS <= good.size < MAX_READ_SHARE * values.size:
            filled[name] = _lines(recording, values, good)
    return replace(recording, frame=recording.frame.assign(**filled)) if filled else recording


def _held(fresh: np.ndarray, ways: np.ndarray) -> bool:
    """Does a reading change every few rows? A coarse one changes when it must. ways: rows from change to change."""
    if fresh.size < MIN_READINGS:
        return False
    steps = np.abs(np.diff(fresh))
    often = np.quantile(ways, 0.1) < max(MIN_HELD_ROWS, 0.5 * float(np.median(ways)))
    return not often and bool(np.ptp(steps) > 0.5 * np.median(steps))


def _lines(recording: Recording, values: np.ndarray, good: np.ndarray) -> np.ndarray:
    """Straight lines in time between the good rows of each session; a session without any is left empty."""
    t, session, out = recording.time(), sessions(recording), np.full(values.size, np.nan)
    for s in np.unique(session[good]):
        rows, known = np.flatnonzero(session == s), good[session[good] == s]
        out[rows] = np.interp(t[rows], t[known], values[known])
    return out
