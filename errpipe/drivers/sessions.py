"""Stretches of a recording through which a machine's states live on."""

from __future__ import annotations

import numpy as np

from errpipe.domain.recording import Recording

MAX_PAUSE = 7200.0  # s between runs of one session (by judgement: a machine at rest cools down)


def sessions(recording: Recording) -> np.ndarray:
    """Integer per row, shape (rows,): runs that follow in time share one, for heat does not stop between them.

    A new session starts where the run changes and time goes back, is missing, or jumps by more than
    `MAX_PAUSE`; without a time column, or where the recording says so, every run is its own.
    """
    if "sessions" not in recording.derived:
        recording.derived["sessions"] = _sessions(recording)
    return recording.derived["sessions"]


def _sessions(recording: Recording) -> np.ndarray:
    run = recording.run_codes()
    if len(run) == 0 or recording.separate_runs or recording.name("time") is None:
        return run
    step = np.diff(recording.time())
    goes_on = (step >= 0) & (step <= MAX_PAUSE)
    return np.r_[0, np.cumsum((run[1:] != run[:-1]) & ~goes_on)].astype(np.int64)


def in_order_of_time(recording: Recording) -> Recording:
    """The recording with its runs in the order of their times; as it is where they overlap or hold no times.

    States, wear and length cut continue from run to run, in whatever order a table lists them.
    """
    if recording.name("time") is None or len(recording) == 0:
        return recording
    t, run = recording.time(), recording.run_codes()
    first = np.r_[0, np.flatnonzero(np.diff(run)) + 1]
    last = np.r_[first[1:], t.size] - 1
    order = np.argsort(t[first], kind="stable")
    in_turn = np.isfinite(t).all() and np.all(t[first[order][1:]] > t[last[order][:-1]])
    if not in_turn or np.all(np.diff(order) > 0):
        return recording
    return recording.take(np.concatenate([np.arange(first[k], last[k] + 1) for k in order]))


def hold(run: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Last finite value of each run, shape (rows,); NaN before the first."""
    index = np.where(np.isnan(values), -1, np.arange(values.size))
    starts = np.r_[True, run[1:] != run[:-1]]
    first = np.maximum.accumulate(np.where(starts, np.arange(values.size), 0))
    last = np.maximum.accumulate(index)
    return np.where(last >= first, values[np.maximum(last, 0)], np.nan)
