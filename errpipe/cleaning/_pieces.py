"""Cleaning of a recording that is never whole in memory: whole runs at a time.

Rules look at one run at a time, so what they remove, blank and hold is the same as in memory. Two things are judged
piece by piece instead: the share that a rule may remove, and whether a column is set aside (in a piece its cells are
blanked; where every piece sets it aside, the column is).
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from errpipe.cleaning import WHOLE_RUN, CleaningReport, Done, Rule, RuleReport, clean
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError


def longest_run(batches: Iterable[Recording]) -> int | None:
    """Rows of the longest run; None where the rows of a run do not all follow each other, or there is no run column."""
    lengths: dict[str, int] = {}
    last = None
    for batch in batches:
        codes, labels = batch.run_codes(), batch.run_labels()
        starts = np.flatnonzero(np.diff(codes, prepend=-1))
        for start, end in zip(starts, np.r_[starts[1:], codes.size], strict=True):
            label = labels[codes[start]]
            if label in lengths and label != last:
                return None
            lengths[label] = lengths.get(label, 0) + int(end - start)
            last = label
    return max(lengths.values(), default=0)


def whole_runs(batches: Iterable[Recording], rows: int) -> Iterator[Recording]:
    """The same rows in pieces of whole runs, each with at least `rows` rows but the last."""
    held: list[pd.DataFrame] = []
    for batch in batches:
        held.append(batch.frame)
        if sum(map(len, held)) < rows:
            continue
        joined = Recording(batch.manifest, pd.concat(held, ignore_index=True))
        cut = int(np.flatnonzero(np.diff(joined.run_codes(), prepend=-1))[-1])  # the last run may go on
        held = [joined.frame]
        if cut >= rows:
            yield joined.take(np.arange(cut))
            held = [joined.frame.iloc[cut:]]
    if held:
        yield Recording(batch.manifest, pd.concat(held, ignore_index=True))


@dataclass
class Cleaning:
    """Rules carried out piece by piece. manifest: of the cleaned rows, complete when all pieces are through."""

    rules: Sequence[Rule]
    source: Manifest
    at: int = 0
    kept: int = 0
    done: dict[int, list[Done]] = field(default_factory=dict)  # number of the rule -> what it did
    used: set[str] = field(default_factory=set)  # columns that some piece kept

    def written(self) -> Manifest:
        """The manifest of every piece: the source's columns, and the label of a run before it was split."""
        more = {WHOLE_RUN: Column(role="group", of="run")} if any(rule.splits_runs for rule in self.rules) else {}
        return self.source.model_copy(update={"columns": {**self.source.columns, **more}})

    def manifest(self) -> Manifest:
        """The manifest of what was written: columns that no piece kept are ignored."""
        columns = {n: c if n in self.used else Column(role="ignore") for n, c in self.written().columns.items()}
        return self.source.model_copy(update={"columns": columns})

    def pieces(self, pieces: Iterable[Recording]) -> Iterator[Recording]:
        """Cleaned pieces, with every column of `written`. Raises DataError, with the rows of the piece."""
        for piece in pieces:
            try:
                cleaned, report = clean(piece, self.rules)
            except DataError as why:
                raise DataError(f"{why} (rows counted from row {self.at})") from None
            self._note(report, cleaned)
            self.at, self.kept = self.at + len(piece), self.kept + len(cleaned)
            yield self._complete(cleaned)

    def report(self) -> CleaningReport:
        """What was done, rows counted over the whole recording."""
        rules = tuple(
            RuleReport(
                rule=rule.rule,
                options=rule.model_dump(mode="json", exclude={"rule"}),
                done=tuple(self.done.get(number, ())),
            )
            for number, rule in enumerate(self.rules)
        )
        return CleaningReport(rows_before=self.at, rows_after=self.kept, rules=rules)

    def _note(self, report: CleaningReport, cleaned: Recording) -> None:
        self.used |= {n for n, c in cleaned.manifest.columns.items() if c.role != "ignore"}
        for number, rule in enumerate(report.rules):
            moved = (
                done.model_copy(update={"rows": tuple((a + self.at, b + self.at) for a, b in done.rows)})
                for done in rule.done
            )
            self.done.setdefault(number, []).extend(moved)

    def _complete(self, cleaned: Recording) -> Recording:
        written, frame = self.written(), cleaned.frame
        names = [n for n, c in written.columns.items() if c.role != "ignore"]
        missing = {n: np.nan for n in names if n not in frame and n != WHOLE_RUN}
        if WHOLE_RUN in names and WHOLE_RUN not in frame:
            missing |= {WHOLE_RUN: frame[cleaned.names("run")[0]]}
        return Recording(written, frame.assign(**missing)[names])
