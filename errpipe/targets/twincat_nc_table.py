"""TwinCAT NC PTP position compensation: arrays for `MC_TableBasedPositionCompensation` (Tc2_MC2).

Value     an additive correction in mm (deg): set point + value (minus the deviation).
Order     equidistant, ascending; one function block per direction (WorkDirectionPositive, WorkDirectionNegative). The
          calls stand below the arrays: inputs by the manual's page of the block; not run here, no TwinCAT.
Turns     Modulo is TRUE for an axis that turns on: from 0 to 360 deg, equal at both ends.
Literals  IEC real literals with a point; the file is a global variable list, compiled with the PLC program.
"""

from __future__ import annotations

import re

import numpy as np

from errpipe.targets._base import Curve, expect, matched, periodic_curve, unit_of
from errpipe.targets._screw_map import ScrewMap

RAMP = 1.0  # mm/s: 1 um/ms, as corrections of a table move at most (`tables/limits.py`)
SIDES = {"Up": "WorkDirectionPositive", "Down": "WorkDirectionNegative"}
_ELEMENT = re.compile(r"\(Position := ([-+\d.E]+), Compensation := ([-+\d.E]+)\)")


class TwincatNcTable(ScrewMap):
    """Position compensation of each axis as initialised arrays, one per direction."""

    name = "twincat_nc_table"
    controller = "TwinCAT NC PTP"
    confidence = "documented"
    sign = "a positive value moves the axis in plus (it is added to the set point)"
    limits = "equidistant; memory of the PLC; the axis' own position; no temperature"
    holds = ("screw", "both directions")
    remark = {"": "(* {} *)"}
    source = "Tc2_MC2: MC_TableBasedPositionCompensation, ST_PositionCompensationTableElement"
    activation = (
        "call P_Compensation<axis> in the task of the axis, bEnable TRUE once it is homed",
        "compare AxisRef position with and without Enable at three points, from both sides",
    )

    max_points, error_um, turns_from_zero = 2000, 0.05, True

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        return f"GVL_Compensation_{curve.axis}.st", _text(curve.axis, curve)

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        axis = name.split(".")[0].split("_")[-1]
        sides = []
        for side in SIDES:
            array = re.compile(rf"aCompensation{axis}{side} : ARRAY\[0\.\.(\d+)\].*?:= \[(.*?)\];", re.S)
            match = matched(array, text, name, f"has no array for {SIDES[side]}")
            rows = [(float(x), float(v)) for x, v in _ELEMENT.findall(match[2])]
            expect(len(rows) == int(match[1]) + 1, name, f"{len(rows)} elements in an array of {int(match[1]) + 1}")
            sides.append(np.array(rows))
        curve = Curve(axis, axis, sides[0][:, 0], sides[0][:, 1], sides[1][:, 1])
        return periodic_curve(curve) if "Modulo := TRUE" in text else curve


def literal(value: float) -> str:
    """An IEC real literal: sixteen digits, always with a point."""
    return f"{value + 0.0:.15E}"


def _text(axis: str, curve: Curve) -> str:
    last = curve.positions.size - 1
    turns = "TRUE" if curve.turns else "FALSE"
    lines = ["VAR_GLOBAL"]
    for side, value in (("Up", curve.up), ("Down", curve.down)):
        lines.append(f"    (* {axis}, {SIDES[side]}: {unit_of(axis)}, added to the set point *)")
        lines.append(f"    aCompensation{axis}{side} : ARRAY[0..{last}] OF ST_PositionCompensationTableElement := [")
        rows = [
            f"        (Position := {literal(x)}, Compensation := {literal(v)})"
            for x, v in zip(curve.positions.tolist(), value.tolist(), strict=True)
        ]
        lines += [",\n".join(rows), "    ];"]
        lines.append(f"    stParameter{axis}{side} : ST_PositionCompensationTableParameter := (")
        low, high = literal(curve.positions[0]), literal(curve.positions[-1])
        lines.append(f"        MinPosition := {low}, MaxPosition := {high},")
        lines.append(f"        NoOfTableElements := {last + 1}, Direction := {SIDES[side]}, Modulo := {turns});")
    return "\n".join([*lines, f"    Axis{axis} : AXIS_REF;", "END_VAR", "", *_program(axis)])


def _program(axis: str) -> list[str]:
    """Calls of both blocks; in a stop the last correction is kept (DisableModeHold)."""
    lines = [f"PROGRAM P_Compensation{axis}", "VAR_INPUT", "    bEnable : BOOL;", "END_VAR", "VAR"]
    lines += [f"    fb{side} : MC_TableBasedPositionCompensation;" for side in SIDES] + ["END_VAR"]
    for side in SIDES:
        table = f"aCompensation{axis}{side}"
        lines += [
            f"    fb{side}(Axis := Axis{axis}, Enable := bEnable, TableParameter := stParameter{axis}{side},",
            f"        pTable := ADR({table}), TableSize := SIZEOF({table}),",
            f"        Ramp := {literal(RAMP)}, DisableMode := DisableModeHold);",
        ]
    return [*lines, "END_PROGRAM", ""]
