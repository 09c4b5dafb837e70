"""Run of each row of a table, as stored in the table, so that its labels need not be read."""

from __future__ import annotations

import json
from dataclasses import dataclass, field

import numpy as np
import pyarrow.parquet as pq

from errpipe.domain.batch import Stretches
from errpipe.domain.recording import Recording

RUNS = "errpipe.runs"  # key of the list of a table's runs: [[label, rows], ...], in order
MOST_RUNS = 100_000  # largest number stored: some MB


def known_runs(labels: list[str], ends: np.ndarray, at: int, rows: int) -> Stretches:
    """The runs of `rows` rows from row `at` on. ends: row after the last of each run of the table, in order."""
    first, last = ends.searchsorted([at, at + rows - 1], side="right").tolist()
    return Stretches(labels[first : last + 1], np.concatenate(([0], ends[first:last] - at)), rows)


def runs_stated(facts: pq.FileMetaData) -> dict[str, int] | None:
    """Rows of each run of a table, in order, if it states them; None if it has to be read."""
    try:
        stretches = json.loads((facts.metadata or {})[RUNS.encode()])
        runs = {str(label): int(rows) for label, rows in stretches}
    except (KeyError, ValueError, TypeError, RecursionError):
        return None
    sound = len(runs) == len(stretches) and min(runs.values(), default=0) > 0
    return runs if sound and sum(runs.values()) == facts.num_rows else None


@dataclass
class Runs:
    """Stretches of rows of one run, as they are written."""

    labels: list[str] = field(default_factory=list)
    rows: list[int] = field(default_factory=list)

    def add(self, chunk: Recording) -> Recording:
        """Take note of the rows of a chunk."""
        if chunk.name("run") is None or len(self.labels) > MOST_RUNS:
            return chunk
        labels, starts = chunk.run_stretches
        for label, rows in zip(labels, np.diff(starts, append=len(chunk)).tolist(), strict=True):
            if self.labels[-1:] == [label]:
                self.rows[-1] += rows
            else:
                self.labels.append(label)
                self.rows.append(rows)
        return chunk

    def facts(self) -> dict[str, str]:
        """The stored list of runs; nothing if there are too many."""
        known = 0 < len(self.labels) <= MOST_RUNS
        return {RUNS: json.dumps(list(zip(self.labels, self.rows, strict=True)))} if known else {}
