"""A log of several days in one run, treated as runs that start at several places of it.

A prediction starts where the next recording does, with slow effects at zero. One run has one
start, so it does not show how slow lags combine: a gantry in a hall, fitted to one log of three weeks,
was predicted with an error of 35 um for two weeks that began on a cold morning. So the log is also evaluated from
each of its blocks on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from errpipe.domain.recording import Column, Recording
from errpipe.thermal.arithmetic import BLOCKS, FEWEST_RUNS, inner_groups
from errpipe.thermal.interval import DAY, independent_runs

# Blocks of a run (one a day), and the number of blocks for which a start is followed. Chosen on logs of 5, 8 and 21
# days of six simulated gantries, the next two weeks judged: rms over uncompensated 0.39, 0.21, 0.29 without later
# starts, 0.13, 0.16, 0.11 with these; five blocks followed to the end 0.17, 0.15, 0.16; ten for three 0.14, 0.13, 0.11.
MOST_STARTS = 10
FOLLOWED = 2


class LaterStarts(NamedTuple):
    """recording: its own rows first, then those of each later start; rows: mask of the usable ones; group: of
    each row, the same for one block of time in all runs; run_count: number of independent runs.
    """

    recording: Recording
    rows: np.ndarray
    group: np.ndarray
    run_count: int


def started(recording: Recording, rows: np.ndarray) -> LaterStarts:
    """The rows of a mask, and again from every block on if too few runs contain several days."""
    run, run_count, time = recording.run_codes(), independent_runs(recording, rows), recording.time()
    used_runs = np.unique(run[rows])
    days = sum(round(float(np.ptp(time[rows & (run == code)])) / DAY) for code in used_runs)
    if used_runs.size >= FEWEST_RUNS or days < FEWEST_RUNS:
        return LaterStarts(recording, rows, inner_groups(run, rows), run_count)
    group = inner_groups(run, rows, int(np.clip(days, BLOCKS, MOST_STARTS)))
    labels = recording.run_labels()
    parts, names = [np.arange(run.size)], [np.array(labels, dtype=object)[run]]
    for code in used_runs:
        used = np.flatnonzero(rows & (run == code))
        blocks = np.unique(group[used])
        for number in range(1, blocks.size):
            first, last = used[np.isin(group[used], blocks[number : number + FOLLOWED])][[0, -1]]
            own = np.flatnonzero(run == code)
            parts.append(own[(own >= first) & (own <= last)])
            names.append(np.full(parts[-1].size, f"{labels[code]} from {number + 1}", dtype=object))
    at = np.concatenate(parts)
    name = recording.name("run") or "run"
    again = recording.take(at).with_columns({name: np.concatenate(names)}, {name: Column(role="run")})
    return LaterStarts(again, rows[at], group[at], run_count)
