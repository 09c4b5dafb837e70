"""What a controller makes of files that hold the whole table: the table itself, evaluated."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.tables import ect
from errpipe.targets import _sample
from errpipe.targets._base import ReadBack, Target, expect, matched

MIN_THERMAL_UM = 0.01  # per kelvin; less is not worth a line of a checklist


@dataclass(frozen=True, kw_only=True)
class WholeTable(ReadBack):
    """Nothing is lost: corrections come from the table that was read back."""

    table: CompensationTable

    @classmethod
    def of(cls, table: CompensationTable) -> WholeTable:
        """With the curves and lines of which a checklist is made; what moves an axis is the table alone."""
        axes, known = _sample.outputs_by_axis(table), _sample.positions_of(table)
        pairs = [(axis, over) for axis in axes for over in known if _sample.changes_along(table, axis, over)]
        ends = {over: _sample.spread(*_sample.span(table, over), 101) for over in known}
        lines = [_sample.line(table, axis, sensor) for axis in axes for sensor in _sample.sensors_of(table)]
        return cls(
            curves=tuple(_sample.curve(table, axis, over, ends[over]) for axis, over in pairs),
            lines=tuple(line for line in lines if abs(line.level) * 1e3 >= MIN_THERMAL_UM),
            table=table,
        )

    @classmethod
    def from_array(cls, target: type[Target], files: Mapping[str, str], name: str, array: str) -> WholeTable:
        """From a file that contains the table's bytes as an array in C; the files must be those written from it."""
        match = matched(rf"{array}\[(\d+)\] = \{{([\d,\s]*)\}};", files.get(name, ""), name, "holds no table")
        data = bytes(int(v) for v in match[2].split(","))
        expect(len(data) == int(match[1]), name, f"{len(data)} bytes of {match[1]}")
        return cls.as_written(target, files, data)

    @classmethod
    def as_written(cls, target: type[Target], files: Mapping[str, str], data: bytes) -> WholeTable:
        """From the table's bytes. Raises VerifyError if the files are not those that the target writes of it."""
        table, plain_files = ect.loads(data), target.without_remarks(files)
        for name, text in target.write(table).items():
            expect(plain_files.get(name) == text, name, "is missing or was changed")
        return cls.of(table)

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
