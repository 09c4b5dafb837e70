"""The display step of each column: noted, because a residual cannot fall below it."""

from __future__ import annotations

from typing import Literal

import numpy as np

from errpipe.cleaning._base import SENSORS, Action, Rule, resolution
from errpipe.domain.recording import Recording
from errpipe.yamlfile import quantity

MIN_VALUES = 20  # values; too few to identify a lattice


class Quantisation(Rule):
    """Report every sensor and deviation whose resolution is coarser than its noise."""

    rule: Literal["quantisation"] = "quantisation"
    coarse: float = quantity(
        "1", "Note a step above this multiple of the typical change from row to row that is not zero.", 1.0, gt=0
    )

    def find(self, recording: Recording) -> list[Action]:
        """Notes only."""
        actions = []
        for role in (*SENSORS, "error"):
            for name in recording.names(role):
                values = recording.array(name)
                step = resolution(values)
                if step == 0.0 or np.count_nonzero(np.isfinite(values)) < MIN_VALUES:
                    continue
                change = np.abs(np.diff(values[np.isfinite(values)]))
                if np.median(change) <= self.coarse * step:
                    unit = recording.manifest.columns[name].unit or ""
                    floor = step / np.sqrt(12)
                    reason = f"displayed in steps of {step:g} {unit}: rounding alone is {floor:.2g} {unit} rms"
                    actions.append(Action("note", reason, column=name))
        return actions
