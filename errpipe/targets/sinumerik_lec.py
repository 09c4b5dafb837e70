"""SINUMERIK 840D sl / 828D / 808D leadscrew error compensation ($AA_ENC_COMP), one direction.

Value     the ERROR in mm: a positive value moves the axis in NEGATIVE direction (808D manual), so the deviation.
Order     equidistant from MIN to MAX in STEP; straight between points; held outside (experience).
Limits    one curve for both directions; the reversal error belongs to MD32450 BACKLASH or to two CEC tables.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import Curve, ReadBack, Target, expect

MOST = 200  # 808D fixed; 840D sl by MD38000
ERROR_UM = 0.1


class SinumerikLec(Target):
    """Leadscrew error compensation of each axis: the mean of both directions."""

    name = "sinumerik_lec"
    controller = "SINUMERIK 840D sl, 828D, 808D"
    confidence = "documented"
    sign = "a positive value moves the axis in minus (it is the error)"
    limits = "equidistant; 200 points (808D; 840D sl: MD38000); one direction; the axis' own position"
    source = "Function Manual Extended Functions 6FC5397-1BP40-3BA1 (K3); 808D manual"
    activation = (
        "MD38000 MM_ENC_COMP_MAX_POINTS at least the number of points, then power on",
        "MD32700 ENC_COMP_ENABLE = 0 while the file is loaded, then 1; reference the axis again",
        "the value at the reference point must be 0: read $AA_ENC_COMP back and compare three points",
        "MD32450 BACKLASH carries what differs between the directions",
    )
    goes_with = ("sinumerik_cec", "sinumerik_temperature")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        files = {}
        for number, axis in enumerate(_sample.axes_of(table), 1):
            if axis not in _sample.positions_of(table) or axis not in _sample.outputs_by_axis(table):
                continue
            points, _ = _sample.uniform(table, axis, axis, MOST, ERROR_UM)
            curve = _sample.curve(table, axis, axis, points.positions())
            values = -(curve.up + curve.down) / 2
            files[f"AX{number}_{axis}_EEC.INI"] = _text(f"AX{number}", axis, points, values)
        if not files:
            raise GateError("sinumerik_lec: no axis of the table is corrected over its own position")
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return ReadBack(curves=tuple(_read(name, text) for name, text in sorted(files.items())))


def _text(machine_axis: str, axis: str, points, values: np.ndarray) -> str:
    lines = [f"%_N_{machine_axis}_EEC_INI", "CHANDATA(1)"]
    lines += [f"$AA_ENC_COMP[0,{n},{machine_axis}]={v + 0.0:.6f}" for n, v in enumerate(values)]
    end = points.start + points.step * (points.count - 1)
    facts = {"STEP": points.step, "MIN": points.start, "MAX": end}
    lines += [f"$AA_ENC_COMP_{key}[0,{machine_axis}]={value + 0.0:.9f}" for key, value in facts.items()]
    return "\n".join([*lines, f"$AA_ENC_COMP_IS_MODULO[0,{machine_axis}]=0", "M17", ""])


def _read(name: str, text: str) -> Curve:
    found = {int(n): float(v) for n, v in re.findall(r"\$AA_ENC_COMP\[0,(\d+),\w+\]=(\S+)", text)}
    facts = {k: float(v) for k, v in re.findall(r"\$AA_ENC_COMP_(STEP|MIN|MAX)\[0,\w+\]=(\S+)", text)}
    expect(len(facts) == 3 and facts["STEP"] > 0, name, "STEP, MIN or MAX is missing")
    count = round((facts["MAX"] - facts["MIN"]) / facts["STEP"]) + 1
    expect(sorted(found) == list(range(count)), name, f"{len(found)} points where MIN, MAX and STEP say {count}")
    expect(text.rstrip().endswith("M17"), name, "does not end with M17")
    value = -np.array([found[n] for n in range(count)])
    axis = name.split("_")[1]
    return Curve(axis, axis, facts["MIN"] + facts["STEP"] * np.arange(count), value, value)
