"""Holes: short ones in a sensor hold the value before, as a controller does; long ones in time split the run."""

from __future__ import annotations

from typing import ClassVar, Literal

import numpy as np

from errpipe.cleaning._base import Action, Rule, sensors
from errpipe.domain.recording import Recording
from errpipe.drivers.between_readings import rows_between
from errpipe.kernels.events import stretches
from errpipe.yamlfile import quantity


class Gaps(Rule):
    """Hold a sensor over short gaps; start a new run after a long pause.

    Held cells repeat the reading before the gap (causal). Longer gaps stay empty.
    A split run keeps its old label in a group column, so that a hold-out can still leave it out whole.
    """

    rule: Literal["gaps"] = "gaps"
    splits_runs: ClassVar[bool] = True
    does: ClassVar[str] = "fill, with the reading before,"
    hold: float = quantity("s", "A sensor's hole up to this long is held.", 300.0, ge=0)
    longest: float = quantity("s", "A longer pause between two rows splits the run.", 14400.0, gt=0)
    most: float = quantity("1", "Refuse to hold more than this share of a sensor's cells.", 0.1, gt=0, le=1)

    def find(self, recording: Recording) -> list[Action]:
        """Cells to hold, and new run labels. Raises DataError beyond the stated share."""
        if recording.name("time") is None:
            return []
        t, run = recording.time(), recording.run_codes()
        actions = [a for name in sensors(recording) if (a := self._cells_to_hold(recording, name, t, run)) is not None]
        return [*actions, *self._split(recording, t, run)]

    def _cells_to_hold(self, recording: Recording, name: str, t: np.ndarray, run: np.ndarray) -> Action | None:
        values = recording.array(name)
        missing, usual = np.isnan(values), rows_between(values)
        rows: list[int] = []
        held: list[float] = []
        for start, over in zip(*stretches(missing), strict=True):
            end = start + int(np.argmax(np.r_[run[start:over] != run[start], True]))  # no further than the run
            if end - start < usual:  # the sensor is logged less often than the rows: no hole
                continue
            if start > 0 and run[start - 1] == run[start] and t[end - 1] - t[start - 1] <= self.hold:
                rows += range(start, end)
                held += [values[start - 1]] * (end - start)
        if not rows:
            return None
        cells = np.array(rows)
        self.refuse_beyond(self.most, cells, values.size, f"cells of {name}", recording)
        reason = f"empty for no longer than {self.hold:g} s: the reading before holds"
        return Action("hold cells", reason, column=name, rows=cells, values=np.array(held))

    def _split(self, recording: Recording, t: np.ndarray, run: np.ndarray) -> list[Action]:
        same = np.r_[False, run[1:] == run[:-1]]
        pause = np.r_[0.0, np.diff(t)]
        cuts = np.flatnonzero(same & (pause > self.longest))
        if not cuts.size:
            return []
        part = np.zeros(run.size, dtype=int)
        for cut in cuts:
            later = (run == run[cut]) & (np.arange(run.size) >= cut)
            part[later] += 1
        labels = recording.run_labels()
        rows = np.flatnonzero(part > 0)
        new = np.array([f"{labels[run[r]]} part {part[r] + 1}" for r in rows], dtype=object)
        longest = pause[cuts].max()
        reason = f"{cuts.size} pause(s) longer than {self.longest:g} s, the longest {longest:g} s: a new run begins"
        return [Action("split run", reason, rows=rows, values=new)]
