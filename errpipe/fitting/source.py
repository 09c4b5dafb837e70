"""A recording on disk, in one part or several: its rows batch by batch, its runs in order and the hold-out for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.spec import ModelSpec


@dataclass(frozen=True)
class Source:
    """A recording on disk.

    ends: two rows, the smallest and the largest value of every column. batches: names of columns -> its rows in order,
    batch by batch, each with the state after the rows before it; `runs=` gives the rows of each run if known.
    complete: columns without a missing value. runs: rows of each run, if the file states them. at: row of the whole
    recording at which it begins, where it is a part of one.
    """

    rows: int
    ends: Recording
    batches: Callable[..., Iterator[Recording]]
    complete: frozenset[str] = frozenset()
    runs: Mapping[str, int] | None = None
    at: int = 0

    @property
    def manifest(self) -> Manifest:
        return self.ends.manifest

    def over(self, function: Callable[..., Any], *arguments: Any) -> list[Any]:
        """What a function of a source and further arguments gives for each part, in their order."""
        return [function(self, *arguments)]

    def mapped(self, change: Callable[[Source], Source]) -> Source:
        """The source with a change to each part."""
        return change(self)


@dataclass(frozen=True)
class Layout:
    """Runs in order with their rows, the hold-out for them, and the column that groups are read from."""

    runs: tuple[str, ...]
    lengths: np.ndarray
    scheme: holdout.HoldOut
    rows: int

    @cached_property
    def rows_of_runs(self) -> dict[str, int]:
        return dict(zip(self.runs, self.lengths.tolist(), strict=True))

    def runs_of(self, source: Source) -> Mapping[str, int]:
        """Rows of each run of a part, in order."""
        if source.rows == self.rows:
            return self.rows_of_runs
        first, last = np.cumsum(self.lengths).searchsorted([source.at, source.at + source.rows - 1], side="right")
        return {run: self.rows_of_runs[run] for run in self.runs[first : last + 1]}


def survey(source: Source, spec: ModelSpec, scheme: holdout.HoldOut | str | None = None) -> Layout:
    """Runs and hold-out of a recording, from its labels and responses alone. Raises DataError if runs are mixed."""
    manifest, asked = source.manifest, spec.holdout if scheme is None else scheme
    responses = [n for n, c in manifest.columns.items() if c.role == "error"]
    all_measured = not source.complete.isdisjoint(responses)
    names = [*manifest.names("run"), *([] if all_measured else responses)] or responses[:1]
    lengths: dict[str, int] = dict(source.runs or {}) if all_measured else {}
    measured: set[str] = set(lengths)
    for part in () if lengths else source.over(_survey_part, names, all_measured):
        for label in part[0]:
            if label in lengths:
                raise DataError(f"run {label} has rows in two parts: the rows of a run must be in one")
        lengths, measured = lengths | part[0], measured | part[1]
    few = Recording(
        Manifest(recording=1, tables=("-",), columns={"run": Column(role="run")}),
        pd.DataFrame({"run": sorted(measured)}),
    )
    chosen = holdout.resolved(few, asked)
    if chosen.gap > 0:
        raise DataError(
            "hold-out: a gap around the judged rows cannot be kept in batches (gap: 0, or raise rows_in_memory)"
        )
    return Layout(tuple(lengths), np.array(list(lengths.values())), chosen, source.rows)


def _survey_part(source: Source, names: Sequence[str], all_measured: bool) -> tuple[dict[str, int], set[str]]:
    """Rows of each run of a part, in order, and the runs with a response. Raises DataError if runs are mixed."""
    lengths: dict[str, int] = {}
    measured: set[str] = set()
    last = ""
    for batch in source.batches(names):
        seen = None if all_measured else holdout.measured(batch)
        for label, first, end in stretches(batch):
            if label in lengths and label != last:
                raise DataError(
                    f"run {label} appears again after run {last}: in batches the rows of a run must be contiguous"
                )
            lengths[label] = lengths.get(label, 0) + int(end - first)
            last = label
            if seen is None or seen[first:end].any():
                measured.add(label)
    return lengths, measured


def stretches(batch: Recording) -> Iterator[tuple[str, int, int]]:
    """(run, first row, row after the last) of each stretch of a batch."""
    runs, starts = batch.run_stretches
    return zip(runs, starts.tolist(), [*starts[1:].tolist(), len(batch)], strict=True)
