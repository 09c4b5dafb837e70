"""SINUMERIK temperature compensation: K0(T) and tan beta(T) about P0, as synchronised actions and setting data.

Value     the ERROR: dK = K0(T) + tan beta(T) * (P - P0); a positive value moves the axis in minus (experience: as the
          leadscrew table). The controller limits how fast it follows (MD32760).
Limits    one straight line per axis and sensor; no lag; the level K0 and slope must be refreshed by the PLC.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import Line, ReadBack, Target, expect

FILE = "TEMP_COMP.SPF"
_ROW = re.compile(r"; (\w+)\[(\w+)\] sensor=(.+) T0=(\S+) K0_PER_K=(\S+) TAN_BETA_PER_K=(\S+) P0=(\S+)")


class SinumerikTemperature(Target):
    """Level and slope per kelvin of each axis, to be refreshed from the sensors."""

    name = "sinumerik_temperature"
    controller = "Siemens SINUMERIK 840D sl, 828D"
    confidence = "documented"
    sign = "a positive value moves the axis in minus (it is the deviation)"
    limits = "a straight line over the axis per sensor; settled state, no lag; slew limited by MD32760"
    holds = ("temperature",)
    remark = {"": "; {}"}
    numbering = "AX{1}"
    source = "Function Manual Extended Functions K3 (p. 225 to 230)"
    activation = (
        "MD32750 TEMP_COMP_TYPE = 3 (level and slope); MD32760 COMP_ADD_VELO_FACTOR bounds the step per cycle",
        "the PLC writes SD43900 and SD43910 from the sensors by the formulas of the file, SD43920 once",
        "read $VA_... compensation value of the axis at two temperatures and compare",
    )
    goes_with = ("sinumerik_lec", "sinumerik_cec")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        axes = _sample.axes_of(table)
        lines = _sample.warm_lines(table, cls.name)
        return {FILE: _text([(f"AX{axes.index(line.axis) + 1}", line) for line in lines])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        rows = _ROW.findall(files[FILE])
        expect(bool(rows), FILE, "holds no line of an axis")
        return ReadBack(
            lines=tuple(
                Line(axis, sensor, float(t0), -float(k0), -float(tan), float(p0))
                for axis, _, sensor, t0, k0, tan, p0 in rows
            )
        )


def _text(lines: list[tuple[str, Line]]) -> str:
    out = ["; temperature compensation: level and slope are errors, refreshed from the sensors (T in degC)"]
    for machine_axis, line in lines:
        k0, tan = -line.level + 0.0, -line.slope + 0.0
        out.append(
            f"; {line.axis}[{machine_axis}] sensor={line.sensor} T0={line.reference:.4f} K0_PER_K={k0:.9f} "
            f"TAN_BETA_PER_K={tan:.12f} P0={line.zero:.6f}"
        )
        out.append(f"$SA_TEMP_COMP_REF_POSITION[{machine_axis}]={line.zero:.6f}")
        out.append(f"; add: $SA_TEMP_COMP_ABS_VALUE[{machine_axis}] = {k0:.9f}*({line.sensor}-{line.reference:.4f})")
        out.append(f"; add: $SA_TEMP_COMP_SLOPE[{machine_axis}] = {tan:.12f}*({line.sensor}-{line.reference:.4f})")
    return "\n".join([*out, "M17", ""])
