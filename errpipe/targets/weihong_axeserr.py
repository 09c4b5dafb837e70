"""Weihong NcStudio / EasyRoute screw error file `axeserr.dat`: one section an axis, both directions.

Value     the ERROR in mm (actual minus nominal). The manual's example of lost motion alone says so: a backward error of
          +0.030 for a backlash of 0.03, where an axis that comes from above stops 0.03 too high.
Order     nominal machine coordinate ascending, forward error (moving up), backward error (moving down).
Text      `unit = mm` first; comments on lines of their own that begin with a semicolon.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets._base import Curve, ReadBack, expect
from errpipe.targets._screw_map import ScrewMap

FILE = "axeserr.dat"


class WeihongAxeserr(ScrewMap):
    """Errors of each axis in both directions, one file for all axes."""

    name = "weihong_axeserr"
    controller = "Weihong NcStudio, NK200, EasyRoute"
    confidence = "documented"
    sign = "a positive value means the axis went too far (it is the deviation); it is moved in minus"
    limits = "straight between points; the axis' own position; no temperature"
    unit = "mm, as the first line says"
    holds = ("screw", "both directions")
    remark = {"": "; {}"}
    source = "EasyRoute manufacturer's manual p. 68; NK200 manual p. 64, 65 (table 3-2)"
    activation = (
        "copy the file to the installation folder (NK200: from a USB disk); restart the software",
        "parameter: screw error compensation 2 (both directions); the separate backlash value as below",
        "compare three points from both sides with a gauge",
    )

    max_points, error_um = 1000, 0.1

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return {name: "unit = mm\n" + text for name, text in super().write(table).items()}

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        rows = zip(curve.positions.tolist(), (-curve.up).tolist(), (-curve.down).tolist(), strict=True)
        text = "".join(f"{x + 0.0:.6f}, {up + 0.0:.6f}, {down + 0.0:.6f}\n" for x, up, down in rows)
        return FILE, f"[{curve.axis}]\n{text}"

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        lines = [line for line in files[FILE].splitlines() if line.strip() and not line.startswith(";")]
        expect(
            bool(lines) and re.fullmatch(r"unit\s*=\s*mm", lines[0]) is not None, FILE, "does not begin with unit = mm"
        )
        by_axis: dict[str, list[list[float]]] = {}
        axis = ""
        for line in lines[1:]:
            if line.startswith("["):
                axis = line.strip("[] ").upper()
                by_axis[axis] = []
                continue
            row = [float(v) for v in line.split(",")]
            expect(axis != "" and len(row) == 3, FILE, f"line {line!r} is not position, forward, backward")
            expect(not by_axis[axis] or row[0] > by_axis[axis][-1][0], FILE, f"{axis} is not ascending")
            by_axis[axis].append(row)
        curves = []
        for letter, rows in by_axis.items():
            expect(len(rows) >= 2, FILE, f"{letter} has {len(rows)} points")
            x, up, down = np.array(rows).T
            curves.append(Curve(letter, letter, x, -up, -down))
        return ReadBack(curves=tuple(curves))
