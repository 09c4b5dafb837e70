"""Temperatures that jump and stay: a sensor that came loose, was plugged again, or whose amplifier slipped.

A body cannot take a step from one reading to the next, so a level that shifts at once, and many times further than the
column ever moves otherwise, is the sensor's. What it shows from there to the end of the run is blanked: which of the
two levels is right is not known, and heat that is counted from the start of a run would count the step.
A drift that is read where no axis moves jumps as little: its probe was moved, or its datum was set anew.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from errpipe.cleaning._base import Action, Rule, resolution, rows_of_runs
from errpipe.domain.recording import Recording
from errpipe.yamlfile import quantity

SIDE = 4  # readings on either side whose median is a level
PAUSE = 5.0  # times the usual time between rows: a longer pause lets everything change
MIN_LASTING_SHARE = 0.8  # of the step, between the levels on either side: less of it is a single wrong reading
MAX_FURTHER_SHARE = 0.1  # of the step, in the reading after it: more is a fast body that warms, which continues
MIN_STEP = 2.0  # K or um: a smaller step is not worth a run
MAX_JUMPS = 2  # of one sensor; one that steps more often does so by nature (coolant that is switched)
DEAD_SHARE = 0.3  # of a sensor's cells after a jump: the rest is not worth the risk


class SensorJumps(Rule):
    """Blank a temperature, or a drift read where no axis moves, from an impossible jump to the end of its run."""

    rule: Literal["sensor_jumps"] = "sensor_jumps"
    threshold: float = quantity(
        "1", "A jump is this many times as large as any other change of the sensor between two rows.", 6.0, ge=2
    )

    def find(self, recording: Recording) -> list[Action]:
        """Cells to blank, or the column to set aside where most of it would be blank."""
        actions = []
        temperatures = recording.names("temperature")
        for name in [*temperatures, *_drifts(recording)]:
            values = recording.array(name)
            at = self._jumps(values, recording)
            if not at:
                continue
            run = recording.run_codes()
            rows = np.unique(np.concatenate([row + np.flatnonzero(run[row:] == run[row]) for row in at]))
            unit = "K" if name in temperatures else recording.manifest.columns[name].unit or "um"
            reason = f"jumps by {_step(values, at[0]):.3g} {unit} from one reading to the next and stays there"
            if name in temperatures and rows.size > DEAD_SHARE * values.size:
                actions.append(Action("set column aside", f"{reason}, before {rows.size} of {values.size} rows", name))
            else:
                actions.append(Action("blank cells", reason, column=name, rows=rows))
        return actions

    def _jumps(self, values: np.ndarray, recording: Recording) -> list[int]:
        """Rows at which a column jumps, ascending."""
        before, after = _neighbours(values, recording)
        if before.size < 4 * SIDE:
            return []
        change = values[after] - values[before]
        order = np.argsort(-np.abs(change), kind="stable")[: MAX_JUMPS + 1]
        size = np.abs(change[order])
        for count in range(min(MAX_JUMPS, size.size - 1), 0, -1):
            usual = max(size[count], resolution(values), MIN_STEP / self.threshold)
            found = sorted(after[order[:count]])
            if size[count - 1] > self.threshold * usual and all(
                _is_lasting_step(values, recording, row, usual) for row in found
            ):
                return [int(row) for row in found]
        return []


def _drifts(recording: Recording) -> list[str]:
    """Deviations that have no position, nor a simulation to compare with, beside temperatures."""
    others = [n for role in ("position", "command", "simulated") for n in recording.names(role)]
    return list(recording.names("error")) if recording.names("temperature") and not others else []


def _step(values: np.ndarray, row: int) -> float:
    before = values[:row][np.isfinite(values[:row])]
    return float(values[row] - before[-1])


def _neighbours(values: np.ndarray, recording: Recording) -> tuple[np.ndarray, np.ndarray]:
    """Rows of each reading and of the next one, of one run and without a pause between them, each (pairs,)."""
    before, after, t = [], [], recording.time()
    for run_rows in rows_of_runs(recording.run_codes()):
        rows = run_rows[np.isfinite(values[run_rows])]
        step = np.diff(t[rows])
        near = step <= PAUSE * np.median(step) if step.size else np.zeros(0, dtype=bool)
        before.append(rows[:-1][near])
        after.append(rows[1:][near])
    return np.concatenate(before), np.concatenate(after)


def _is_lasting_step(values: np.ndarray, recording: Recording, row: int, usual: float) -> bool:
    """Whether a step is one of the level: whole at once, and still there after it. usual: largest other change, K."""
    run = recording.run_codes()
    rows = np.flatnonzero((run == run[row]) & np.isfinite(values))
    k = int(np.searchsorted(rows, row))
    left, right = values[rows[max(k - SIDE, 0) : k]], values[rows[k : k + SIDE]]
    if min(left.size, right.size) < SIDE:
        return False
    step = right[0] - left[-1]
    neighbouring_step = max(abs(right[1] - right[0]), abs(left[-1] - left[-2]))
    return bool(
        (np.median(right) - np.median(left)) / step >= MIN_LASTING_SHARE
        and neighbouring_step <= max(MAX_FURTHER_SHARE * abs(step), usual)
    )
