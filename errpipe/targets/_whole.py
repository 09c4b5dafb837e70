"""What a controller makes of files that hold the whole table: the table itself, evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import ReadBack


@dataclass(frozen=True, kw_only=True)
class WholeTable(ReadBack):
    """Nothing is lost: corrections come from the table that was read back."""

    table: CompensationTable

    def axes(self) -> tuple[str, ...]:
        return tuple(_sample.outputs_by_axis(self.table))

    def correction(
        self, axis: str, positions: Mapping[str, np.ndarray], side: np.ndarray, sensors: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        if axis not in self.axes():
            return np.zeros(side.size)
        names = _sample.positions_of(self.table)
        known = {i.name for i in self.table.inputs}
        states = {names[a]: values for a, values in positions.items() if a in names}
        states |= {name: values for name, values in sensors.items() if name in known}
        return _sample.corrections(self.table, axis, states, side)
