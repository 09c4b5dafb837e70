"""CODESYS SoftMotion `SMC_BacklashCompensation` (SM3_Basic): a program that calls it for each axis.

Value     fBacklash in the axis' unit: HALF of the lost motion. The slave goes fBacklash further in the direction of
          the master and covers twice that at a reversal (library documentation). One maker's manual draws half of it:
          prove the size once with an indicator.
Limits    one number an axis, the mean over its travel; a virtual master and the real slave axis stand at one position
          when the block starts.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, ReadBack, Target, expect

FILE = "PRG_Backlash.st"
CREEP = 1.0  # mm/s (deg/s), with ten times that as acceleration and a hundred times as jerk: slow beside any feed


class CodesysBacklash(Target):
    """Lost motion of each axis, as a program for the motion task."""

    name = "codesys_backlash"
    controller = "CODESYS SoftMotion"
    confidence = "experimental"
    sign = "a positive value pushes the axis further in the direction of travel (prove it on the machine)"
    limits = "lost motion only, one number an axis; nothing over the position; no temperature"
    holds = ("reversal",)
    remark = {"": "(* {} *)"}
    source = "SM3_Basic library documentation: SMC_BacklashCompensation, SMC_BACKLASH_STARTSTATE"
    activation = (
        "declare a virtual master <axis>_Master for each axis besides the real <axis>_Slave; call it each bus cycle",
        "bring both to one position, then set bExecute; compare one position from both sides with an indicator",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        backlash = _sample.backlash(table, cls.name)
        blocks = "".join(f"    fb{axis} : SMC_BacklashCompensation;\n" for axis in backlash)
        calls = "".join(_call(axis, value) for axis, value in backlash.items())
        head = f"(* {CAUTION} *)\nPROGRAM PRG_Backlash\nVAR\n    bExecute : BOOL;\n"
        return {FILE: f"{head}{blocks}END_VAR\n{calls}END_PROGRAM\n"}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("END_PROGRAM"), FILE, "is cut off")
        rows = re.findall(
            r"fb(\w+)\(Master := \1_Master, Slave := \1_Slave, bExecute := bExecute, fBacklash := ([\d.]+),", text
        )
        expect(bool(rows), FILE, "calls no block")
        return ReadBack(curves=_sample.lost_motions((axis, 2 * float(half)) for axis, half in rows))


def _call(axis: str, lost: float) -> str:
    speeds = (
        f"fCompensationVel := {CREEP:.1f}, fCompensationAcc := {10 * CREEP:.1f}, fCompensationDec := {10 * CREEP:.1f}"
    )
    return (
        f"    fb{axis}(Master := {axis}_Master, Slave := {axis}_Slave, bExecute := bExecute, "
        f"fBacklash := {lost / 2:.6f},\n        {speeds}, fCompensationJerk := {100 * CREEP:.1f});\n"
    )
