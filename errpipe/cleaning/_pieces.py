"""Cleaning of a recording that is never whole in memory: whole runs at a time, and a longer run piece by piece.

Rules look at one run at a time, so what they remove, blank and hold in whole runs is the same as in memory. Two things
are judged piece by piece instead: the share that a rule may remove, and whether a column is set aside (in a piece its
cells are blanked; where every piece sets it aside, the column is). A run that does not fit is cut, and each piece sees
`MARGIN` rows of its neighbours: no border looks like the end of a run. What rules take over a whole run (its scatter,
its usual time between rows) is then that of a piece.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from errpipe.cleaning import WHOLE_RUN, ActionRecord, CleaningReport, Rule, RuleReport, cleaned_rows
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError

MARGIN = 5000  # rows of context at a cut: a hole that is held (300 s at most) at 15 rows a second


@dataclass(frozen=True)
class Piece:
    """Rows to be cleaned. first, end: which of them count; those before and after are context, in the same run."""

    rows: Recording
    first: int
    end: int


def returning_run(batches: Iterable[Recording]) -> str | None:
    """The first run whose rows do not all follow each other, or None."""
    seen: set[str] = set()
    last = None
    for batch in batches:
        codes, labels = batch.run_codes(), batch.run_labels()
        for start in np.flatnonzero(np.diff(codes, prepend=-1)):
            label = labels[codes[start]]
            if label in seen and label != last:
                return label
            seen.add(label)
            last = label
    return None


def in_pieces(batches: Iterable[Recording], rows: int) -> Iterator[Piece]:
    """Every row once, in pieces of whole runs of at least `rows` rows; a run of more than about twice that is cut."""
    held: list[pd.DataFrame] = []
    first, margin = 0, min(MARGIN, rows // 2)
    for batch in batches:
        held.append(batch.frame)
        while sum(map(len, held)) - first >= rows:
            joined = Recording(batch.manifest, pd.concat(held, ignore_index=True))
            held = [joined.frame]
            last_run = int(np.flatnonzero(np.diff(joined.run_codes(), prepend=-1))[-1])  # it may continue
            long = len(joined) - first > 2 * rows + margin
            if last_run >= first + rows or (long and last_run > first):
                end, after = last_run, 0
            elif long:
                end, after = first + rows, margin
            else:
                break
            yield Piece(joined.take(np.arange(end + after)), first, end)
            held, first = [joined.frame.iloc[end - after :]], after
    if held:
        joined = Recording(batch.manifest, pd.concat(held, ignore_index=True))
        yield Piece(joined, first, len(joined))


@dataclass
class Cleaning:
    """Rules carried out piece by piece. manifest: of the cleaned rows, complete when all pieces are through."""

    rules: Sequence[Rule]
    source: Manifest
    at: int = 0
    kept: int = 0
    done: dict[int, list[ActionRecord]] = field(default_factory=dict)  # number of the rule -> what it did
    used: set[str] = field(default_factory=set)  # columns that some piece kept
    part: int = 0  # of the run that continues in the next piece: how many pauses have split it

    @property
    def run(self) -> str:
        """Column of the runs; what it is called where the recording has none and a pause splits it."""
        return next(iter(self.source.names("run")), "run")

    def written(self) -> Manifest:
        """The manifest of every piece: the source's columns, and the label of a run before it was split."""
        more = {}
        if any(rule.splits_runs for rule in self.rules):
            more = {self.run: Column(role="run"), WHOLE_RUN: Column(role="group", of="run")}
        return self.source.model_copy(update={"columns": {**self.source.columns, **more}})

    def manifest(self) -> Manifest:
        """The manifest of what was written: columns that no piece kept are ignored."""
        columns = {n: c if n in self.used else Column(role="ignore") for n, c in self.written().columns.items()}
        return self.source.model_copy(update={"columns": columns})

    def pieces(self, pieces: Iterable[Piece]) -> Iterator[Recording]:
        """Cleaned pieces, with every column of `written`. Raises DataError, with the rows of the piece."""
        for piece in pieces:
            begin = self.at - piece.first
            try:
                cleaned, report, origin = cleaned_rows(piece.rows, self.rules)
            except DataError as why:
                raise DataError(f"{why} (rows counted from row {begin})") from None
            self._add_to_report(report, cleaned, piece, begin)
            complete = self._complete(cleaned)
            if WHOLE_RUN in complete.frame and len(complete):
                self._number_parts(complete.frame, origin, piece, begin)
            complete = complete.take((origin >= piece.first) & (origin < piece.end))
            self.at, self.kept = self.at + piece.end - piece.first, self.kept + len(complete)
            yield complete

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

    def _add_to_report(self, report: CleaningReport, cleaned: Recording, piece: Piece, begin: int) -> None:
        self.used |= {n for n, c in cleaned.manifest.columns.items() if c.role != "ignore"}
        for number, rule in enumerate(report.rules):
            for done in rule.done:
                inside = [(max(a, piece.first), min(b, piece.end)) for a, b in done.rows]
                rows = tuple((a + begin, b + begin) for a, b in inside if a < b)
                if rows or not done.rows:
                    count = sum(b - a for a, b in rows)
                    moved = done.model_copy(update={"rows": rows, "count": count})
                    self.done.setdefault(number, []).append(moved)

    def _complete(self, cleaned: Recording) -> Recording:
        written, frame = self.written(), cleaned.frame
        names = [n for n, c in written.columns.items() if c.role != "ignore"]
        missing = {n: np.nan for n in names if n not in frame and n not in (self.run, WHOLE_RUN)}
        labels = {n: frame.get(self.run, "1") for n in (self.run, WHOLE_RUN) if n in names and n not in frame}
        return Recording(written, frame.assign(**missing, **labels)[names])

    def _number_parts(self, frame: pd.DataFrame, origin: np.ndarray, piece: Piece, begin: int) -> None:
        """Parts of a run that was cut count on from the piece before; its report continues too."""
        whole, label = frame[WHOLE_RUN].to_numpy(), frame[self.run].to_numpy()
        begins = np.r_[True, whole[1:] != whole[:-1]]
        changes = np.cumsum(np.r_[0, label[1:] != label[:-1]])
        part = changes - changes[np.flatnonzero(begins)[np.cumsum(begins) - 1]]
        known, last = (max(int(np.searchsorted(origin, row)) - 1, 0) for row in (piece.first, piece.end))
        if piece.first:
            goes_on = np.cumsum(begins) == 1
            part[goes_on] += self.part - part[known]
            frame.loc[goes_on, self.run] = [f"{whole[0]} part {k + 1}" if k else whole[0] for k in part[goes_on]]
            unsaid = origin[goes_on & (part > 0) & (label == whole) & (origin >= piece.first) & (origin < piece.end)]
            if unsaid.size:
                self._report_split((int(unsaid[0]) + begin, int(unsaid[-1]) + begin + 1))
        self.part = int(part[last])

    def _report_split(self, rows: tuple[int, int]) -> None:
        """Add rows to what was last reported of a run that was split."""
        for actions in self.done.values():
            for k in reversed(range(len(actions))):
                if actions[k].what == "split run":
                    more = {"rows": (*actions[k].rows, rows), "count": actions[k].count + rows[1] - rows[0]}
                    actions[k] = actions[k].model_copy(update=more)
                    return
