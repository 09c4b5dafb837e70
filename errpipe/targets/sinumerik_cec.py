"""SINUMERIK cross-error compensation ($AN_CEC): sag, straightness, squareness, and screw errors in both directions.

Value     the ERROR of the output axis in mm, taken to have the sense of the leadscrew table (positive moves minus);
          the manual's excerpts do not say so: prove it on the machine with the three-point list before cutting.
Direction table DIRECTION 1 acts in plus, -1 in minus, 0 in both: a screw error in two directions is two tables.
Limits    828D: 8 tables of 200 points; held outside MIN..MAX.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import Curve, ReadBack, Target, expect

MOST, TABLES = 200, 8
ERROR_UM = 0.1
SAME_UM = 0.02  # directions closer than this share one table
FILE = "NC_CEC.INI"


class SinumerikCec(Target):
    """Up to eight curves: each axis over itself in two directions, and over the other axes."""

    name = "sinumerik_cec"
    controller = "SINUMERIK 840D sl, 828D"
    confidence = "experimental"
    sign = "a positive value moves the output axis in minus (as the leadscrew table; prove it on the machine)"
    limits = "8 tables of 200 points, equidistant; sums of curves over one axis each; no temperature"
    source = "Function Manual Extended Functions K3 (p. 248, 264); 802D sl manual p. 222"
    activation = (
        "MD18342 points per table; the option for sag compensation, else alarm 8040",
        "MD32710 CEC_ENABLE = 1 for each output axis; SD41300 CEC_TABLE_ENABLE[n] = 1; reference again",
        "SD41310 CEC_TABLE_WEIGHT[n] = 1; read the compensation value in the axis' service screen at three points",
    )
    goes_with = ("sinumerik_lec", "sinumerik_temperature")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return cls.write_beside(table, ())

    @classmethod
    def write_beside(cls, table: CompensationTable, others: Sequence[str]) -> dict[str, str]:
        blocks: list[str] = []
        axes = _sample.axes_of(table)
        screws = "sinumerik_lec" in others  # they hold each axis over itself: here it would act twice
        for axis in _sample.outputs_by_axis(table):
            # Whether another curve holds what stands still: only one of an axis' curves may.
            rest = screws and axis in _sample.positions_of(table)
            for over in _sample.own_first(table, axis):
                if (screws and over == axis) or not _sample.moves_with(table, axis, over):
                    continue
                points, _ = _sample.uniform(table, axis, over, MOST, ERROR_UM)
                curve = _sample.curve(table, axis, over, points.positions(), relative=rest)
                rest = True
                same = float(np.abs(curve.up - curve.down).max()) * 1e3 < SAME_UM
                sides = {0: curve.up} if same else {1: curve.up, -1: curve.down}
                for side, value in sides.items():
                    ends = (f"AX{axes.index(over) + 1}", f"AX{axes.index(axis) + 1}")
                    blocks.append(_block(len(blocks), *ends, side, points, -value))
        if not blocks:
            raise GateError("sinumerik_cec: no axis of the table is corrected over a position")
        if len(blocks) > TABLES:
            raise GateError(f"sinumerik_cec: {len(blocks)} tables are needed, {TABLES} fit")
        named = "".join(f"; AX{n} = {letter}\n" for n, letter in enumerate(axes, 1))
        return {FILE: "%_N_NC_CEC_INI\n" + named + "CHANDATA(1)\n" + "".join(blocks) + "M17\n"}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("M17"), FILE, "does not end with M17")
        letters = dict(re.findall(r"; (AX\d+) = (\w)", text))
        curves = []
        for number in sorted({int(n) for n in re.findall(r"\$AN_CEC\[(\d+),", text)}):
            curves.append(_read(text, number, letters))
        return ReadBack(curves=tuple(curves))


def _block(number: int, over: str, axis: str, side: int, points, error: np.ndarray) -> str:
    lines = [f"$AN_CEC[{number},{n}]={v + 0.0:.6f}" for n, v in enumerate(error)]
    end = points.start + points.step * (points.count - 1)
    lines += [f"$AN_CEC_INPUT_AXIS[{number}]=({over})", f"$AN_CEC_OUTPUT_AXIS[{number}]=({axis})"]
    facts = {"STEP": points.step, "MIN": points.start, "MAX": end}
    lines += [f"$AN_CEC_{key}[{number}]={value + 0.0:.9f}" for key, value in facts.items()]
    modes = {"DIRECTION": side, "MULT_BY_TABLE": 0, "IS_MODULO": 0}
    lines += [f"$AN_CEC_{key}[{number}]={value}" for key, value in modes.items()]
    return "\n".join(lines) + "\n"


def _read(text: str, number: int, letters: dict[str, str]) -> Curve:
    found = {int(n): float(v) for n, v in re.findall(rf"\$AN_CEC\[{number},(\d+)\]=(\S+)", text)}
    facts = {k: float(v) for k, v in re.findall(rf"\$AN_CEC_(STEP|MIN|MAX|DIRECTION)\[{number}\]=(\S+)", text)}
    ends = dict(re.findall(rf"\$AN_CEC_(INPUT|OUTPUT)_AXIS\[{number}\]=\((\w+)\)", text))
    expect(len(facts) == 4 and len(ends) == 2, FILE, f"table {number} lacks STEP, MIN, MAX, DIRECTION or its axes")
    count = round((facts["MAX"] - facts["MIN"]) / facts["STEP"]) + 1
    expect(sorted(found) == list(range(count)), FILE, f"table {number} has {len(found)} points, not {count}")
    value = -np.array([found[n] for n in range(count)])
    nothing = np.zeros(count)
    up, down = (value if facts["DIRECTION"] >= 0 else nothing), (value if facts["DIRECTION"] <= 0 else nothing)
    x = facts["MIN"] + facts["STEP"] * np.arange(count)
    return Curve(letters[ends["OUTPUT"]], letters[ends["INPUT"]], x, up, down)
