"""Cleaning: one file a rule. A new rule is one file here and one entry in RULES.

    cleaned, report = clean(recording)                    # the usual rules in their usual order
    cleaned, report = clean(recording, (Outliers(threshold=8.0),))

Every row, cell and column that a rule touches is in the report, with the rule's reason. Rows are counted from 0
in the recording that came in, whatever earlier rules removed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from errpipe.cleaning._base import Action, ActionKind, Rule
from errpipe.domain.recording import Column, FrozenModel, Recording
from errpipe.yamlfile import Choice

# In the order in which they are applied where none is named: order of rows first, sensors before responses.
RULES: Choice[type[Rule]] = Choice.of_files(
    "errpipe.cleaning",
    "rule",
    ("time_order", "repeated_rows", "unit_slips", "stuck_sensors", "outliers", "sensor_jumps", "gaps", "quantisation"),
)


def by_default() -> tuple[Rule, ...]:
    """The rules that are applied where none is named, with their usual options."""
    return tuple(cast(Any, rule).model_construct() for rule in RULES if rule.by_default)  # defaults need no check


DEFAULT = by_default()

WHOLE_RUN = "run_before_split"  # the group column that keeps the label of a run that was split


class ActionRecord(FrozenModel):
    """One action that was carried out. rows: half-open ranges of rows of the recording that came in."""

    what: ActionKind
    reason: str
    column: str | None = None
    count: int = 0
    rows: tuple[tuple[int, int], ...] = ()


class RuleReport(FrozenModel):
    """What one rule did. options: every option it ran with."""

    rule: str
    options: dict[str, Any]
    done: tuple[ActionRecord, ...] = ()


class CleaningReport(FrozenModel):
    """Format version 1 of `cleaning.json`."""

    cleaning: int = 1
    rows_before: int
    rows_after: int
    rules: tuple[RuleReport, ...] = ()

    def plain(self) -> Mapping[str, Any]:
        """The report as plain values for canonical JSON."""
        return self.model_dump(mode="json")


def clean(recording: Recording, rules: Sequence[Rule] = DEFAULT) -> tuple[Recording, CleaningReport]:
    """Apply rules one after the other. Raises DataError if one would remove more than its stated share."""
    return cleaned_rows(recording, rules)[:2]


def cleaned_rows(recording: Recording, rules: Sequence[Rule]) -> tuple[Recording, CleaningReport, np.ndarray]:
    """`clean`, and of which row of the recording that came in each row is, (rows,)."""
    origin = np.arange(len(recording))
    rows_before = len(recording)
    reports = []
    for rule in rules:
        actions = rule.find(recording)
        options = rule.model_dump(mode="json", exclude={"rule"})
        done = tuple(_done(action, origin) for action in actions)
        reports.append(RuleReport(rule=rule.rule, options=options, done=done))
        removed = [a.rows for a in actions if a.kind == "remove rows"]
        for action in actions:
            recording = _carry_out(recording, action)
        if removed:
            kept = np.ones(len(recording), dtype=bool)
            kept[np.concatenate(removed)] = False
            recording, origin = recording.take(kept), origin[kept]
    report = CleaningReport(rows_before=rows_before, rows_after=len(recording), rules=tuple(reports))
    return recording, report, origin


def _done(action: Action, origin: np.ndarray) -> ActionRecord:
    rows = tuple(_ranges(origin[action.rows]))
    return ActionRecord(what=action.kind, reason=action.reason, column=action.column, count=action.rows.size, rows=rows)


def _ranges(rows: np.ndarray) -> list[tuple[int, int]]:
    """Ascending row numbers as half-open ranges."""
    if not rows.size:
        return []
    breaks = np.flatnonzero(np.diff(rows) != 1) + 1
    return [(int(part[0]), int(part[-1]) + 1) for part in np.split(rows, breaks)]


def _carry_out(recording: Recording, action: Action) -> Recording:
    """The recording after an action; rows are removed by `clean` itself, once a rule."""
    manifest, frame = recording.manifest, recording.frame
    if action.kind in ("blank cells", "hold cells"):
        values = recording.array(str(action.column)).copy()
        values[action.rows] = np.nan if action.values is None else action.values
        return Recording(manifest, frame.assign(**{str(action.column): values}))
    if action.kind == "set column aside":
        columns = {**manifest.columns, str(action.column): Column(role="ignore")}
        kept = frame.drop(columns=str(action.column))
        return Recording(manifest.model_copy(update={"columns": columns}), kept)
    if action.kind == "split run":
        return _split(recording, action)
    return recording


def _split(recording: Recording, action: Action) -> Recording:
    name = recording.name("run")
    labels = np.array(recording.run_labels(), dtype=object)[recording.run_codes()]
    new = labels.copy()
    new[action.rows] = action.values
    columns = {name or "run": Column(role="run"), WHOLE_RUN: Column(role="group", of="run")}
    return recording.with_columns({name or "run": new, WHOLE_RUN: labels}, columns)


__all__ = ["DEFAULT", "RULES", "ActionRecord", "CleaningReport", "Rule", "RuleReport", "clean"]
