"""TwinCAT CNC / ISG kernel temperature compensation: ds = offset0(T) + coefficient(T) * (s - s0).

Value     an ERROR like the screw table's (the documents give the formula, not the sense: prove it on the machine).
Units     temp_comp_offset_0 and temp_comp_position_0 in 0.1 um, temp_comp_coefficient in um/m; the PLC refreshes them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Line, ReadBack, Target, expect

FILE = "temp_comp.lis"
_ROW = re.compile(r"# (\w+) (.+) T0=(\S+) offset_per_K=(\S+) coefficient_per_K=(\S+) position_0=(\S+)")


class BeckhoffTemperature(Target):
    """Offset and coefficient per kelvin of each axis, for a PLC that writes them from the sensors."""

    name = "beckhoff_temperature"
    controller = "TwinCAT CNC, ISG kernel"
    confidence = "experimental"
    sign = "a positive value means the axis went too far (as the screw table; prove it on the machine)"
    limits = "a straight line over the axis per sensor; settled state, no lag"
    holds = ("temperature",)
    source = "ISG kernel documentation, temperature compensation (P-AXIS-00272, -00273, -00274)"
    activation = ("lr_param.temp_comp 1", "the PLC writes offset and coefficient; read the axis' compensation back")
    goes_with = ("beckhoff_ssfk", "beckhoff_crosscomp")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return {FILE: "".join([f"# {CAUTION}\n", *map(_text, _sample.warm_lines(table, cls.name))])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        rows = _ROW.findall(files[FILE])
        expect(bool(rows), FILE, "holds no line of an axis")
        return ReadBack(
            lines=tuple(
                Line(axis, sensor, float(t0), -float(off) * 1e-4, -float(coefficient) * 1e-6, float(p0) * 1e-4)
                for axis, sensor, t0, off, coefficient, p0 in rows
            )
        )


def _text(line: Line) -> str:
    offset, coefficient, zero = -line.level * 1e4 + 0.0, -line.slope * 1e6 + 0.0, round(line.zero * 1e4)
    return (
        f"# {line.axis} {line.sensor} T0={line.reference:.4f} offset_per_K={offset:.6f} "
        f"coefficient_per_K={coefficient:.6f} position_0={zero}\n"
        f"lr_param.temp_comp 1\nlr_param.temp_comp_position_0 {zero}\n"
        f"# PLC: add to temp_comp_offset_0: {offset:.6f}*({line.sensor}-{line.reference:.4f})\n"
        f"# PLC: add to temp_comp_coefficient: {coefficient:.6f}*({line.sensor}-{line.reference:.4f})\n"
    )
