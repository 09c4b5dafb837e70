"""Interface of a cleaning rule: it examines a recording and returns actions; `clean` executes and reports them.

A rule never changes a recording itself, so nothing can be removed without its rows and its reason being reported.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from math import ceil
from typing import ClassVar, Literal

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.yamlfile import Options

SENSORS = ("temperature", "pressure", "humidity")
ActionKind = Literal["remove rows", "blank cells", "hold cells", "set column aside", "split run", "note"]


@dataclass(frozen=True)
class Action:
    """One thing to do, or to note.

    rows: indices of the recording the rule was given. values: the cells' new values (hold cells) or the
    rows' new run labels (split run), one a row.
    """

    kind: ActionKind
    reason: str
    column: str | None = None
    rows: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    values: np.ndarray | None = None


class Rule(Options, ABC):
    """Base of the cleaning rules. A subclass sets `rule: Literal[name]` and finds its actions."""

    rule: str
    splits_runs: ClassVar[bool] = False  # whether it may give rows another run label
    does: ClassVar[str] = "remove"  # what it does with the cells or rows that it finds, in a message
    by_default: ClassVar[bool] = True  # whether it is applied where no rule is named

    @abstractmethod
    def find(self, recording: Recording) -> list[Action]:
        """The actions of the rule. Raises DataError if it would remove more than its stated share."""

    def refuse_beyond(
        self, most: float, rows: np.ndarray, of: int, what: str, recording: Recording, why: Callable[[], str] = str
    ) -> None:
        """Raises DataError if `rows` are more than the share `most` of `of` cells or rows. why: a cause, if known."""
        if rows.size > most * of:
            first, share = place(recording, int(rows[0])), 100 * rows.size / of
            raise DataError(
                f"clean, {self.rule}: would {self.does} {rows.size} of {of} {what} ({share:.1f} %), more than its "
                f"share of {100 * most:g} %; the first at {first}.{why()} Look at the data, or raise `most` of the "
                f"stage clean: rules: [..., {{rule: {self.rule}, most: {ceil(share + 1) / 100:g}}}] (rules that are "
                "named take the place of the usual ones)."
            )


def place(recording: Recording, row: int) -> str:
    """A row in words: 'row 17 (run 3, t = 90 s)'. Rows count from 0, as in `cleaning.json`."""
    facts = []
    if (run := recording.name("run")) is not None:
        facts.append(f"run {recording.frame[run].iloc[row]}")
    if (time := recording.name("time")) is not None:
        facts.append(f"t = {recording.array(time)[row]:g} s")
    return f"row {row}" + (f" ({', '.join(facts)})" if facts else "")


def sensors(recording: Recording) -> tuple[str, ...]:
    """Names of the slow sensors' columns, in manifest order."""
    return tuple(n for role in SENSORS for n in recording.names(role))


def resolution(values: np.ndarray) -> float:
    """The display step of a column: its smallest difference of values where all are multiples of it, else 0.

    Differences of a millionth of the range are of arithmetic: a deviation that is read minus commanded position.
    """
    distinct = np.unique(values[np.isfinite(values)])
    if distinct.size < 2:
        return 0.0
    distinct = distinct[np.r_[True, np.diff(distinct) > 1e-6 * np.ptp(distinct)]]
    if distinct.size < 2:  # a million values and more, as dense as that: no display shows them
        return 0.0
    step = float(np.diff(distinct).min())
    # Steps of 0.05 come back from text as 0.04999999999999716: compare in units of the step.
    ratio = (distinct - distinct[0]) / step
    lattice = np.abs(ratio - np.round(ratio)).max() < 1e-3 * max(1.0, 1e-9 * ratio.max())
    return float(f"{step:.6g}") if lattice and distinct.size * 20 > ratio.max() / 20 else 0.0


def rows_of_runs(run: np.ndarray) -> list[np.ndarray]:
    """Ascending row numbers of each run, in the order of the runs' codes (rows,)."""
    order = np.argsort(run, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(run[order])) + 1)
