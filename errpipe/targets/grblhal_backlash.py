"""grblHAL backlash settings: $160 for X, $161 for Y and so on.

Value     lost motion in mm, at least 0.0001: at each reversal the motor is moved so much further in the new direction
          (motion_control.c, ENABLE_BACKLASH_COMPENSATION). Against each other, the direction upwards is pushed by it.
Limits    one number an axis, the mean over its travel; axes X Y Z A B C U V; the firmware must have been built with
          ENABLE_BACKLASH_COMPENSATION; an axis that overshoots at reversals cannot be corrected.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import ReadBack, Target, expect

FILE = "backlash.gcode"
LETTERS = "XYZABCUV"
FIRST = 160  # number of the setting of X


class GrblhalBacklash(Target):
    """Lost motion of each axis as a setting."""

    name = "grblhal_backlash"
    controller = "grblHAL"
    confidence = "documented"
    sign = "a positive value pushes the axis further in the direction of travel after a reversal"
    limits = "lost motion only, one number an axis; nothing over the position; no temperature"
    unit = "mm, as its settings always are"
    holds = ("reversal",)
    source = (
        "grblHAL core: motion_control.c (mc_backlash_init, mc_line), settings.h (axis settings, backlash = $160 + n)"
    )
    activation = (
        "the firmware must be built with ENABLE_BACKLASH_COMPENSATION; send the file; $$ must list the values",
        "home (the side that homing leaves loose is where counting begins); compare one position from both sides",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        backlash = _sample.backlash(table, cls.name, LETTERS)
        return {FILE: "".join(f"${FIRST + LETTERS.index(a)}={v:.6f}\n" for a, v in sorted(backlash.items()))}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        rows = re.findall(r"^\$(\d+)=([\d.]+)$", files[FILE], re.M)
        expect(
            bool(rows) and all(0 <= int(n) - FIRST < len(LETTERS) for n, _ in rows), FILE, "holds no backlash setting"
        )
        return ReadBack(curves=_sample.lost_motions((LETTERS[int(n) - FIRST], float(v)) for n, v in rows))
