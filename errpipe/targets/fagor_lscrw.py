"""Fagor CNC 8055 leadscrew error table: position and error in both directions, to be entered point by point.

Value     the amount of ERROR of the axis at the point in mm, in plus and in minus (installation manual, 7.5.7). That
          an error is positive where the axis goes too far is from experience, as is the layout of the lines: prove
          both.
Order     ascending, referred to machine zero; at most 1000 points (NPOINTS, P16); straight between points. Where the
          minus column is 0 at all points the control takes the plus column for both directions.
Turns     an axis that turns on counts on; a table from 0 to 360 deg with equal ends acts in every turn (same page).
Limits    four decimals; the error at machine zero is 0, as the control wants it at the reference point.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets._base import (
    CAUTION,
    ByHand,
    Curve,
    ReadBack,
    expect,
    matched,
    periodic_curve,
    points_in_file,
    unit_of,
)
from errpipe.targets._screw_map import ScrewMap


class FagorLscrw(ScrewMap):
    """Table of each axis with the errors of both directions."""

    name = "fagor_lscrw"
    controller = "Fagor CNC 8055, 8055i"
    confidence = "experimental"
    sign = "a positive value means the axis went too far; it is moved in minus (prove it on the machine)"
    limits = "1000 points; tenths of a micrometre; the axis' own position; no temperature"
    holds = ("screw", "both directions")
    keeps_level = False
    remark = {"": "; {}"}
    source = "Fagor CNC 8055 / 8055i installation manual V02.2X, 7.5.7 (p. 328)"
    activation = (
        "axis parameters: LSCRWCOM (P15) = ON, NPOINTS (P16) = the number of points; enter the table; reset",
        "BACKLASH (P14), the control's backlash value, as below",
        "home; compare three points from both sides with a gauge",
    )

    max_points, error_um, turns_from_zero = 1000, 0.1, True

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        lines = (
            ByHand(f"{c.axis}: NPOINTS (P16) = {points_in_file(c)}, and each line of the file") for c in read.curves
        )
        return (*lines, *super().by_hand(table, read, others))

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        zero = float(np.interp(0.0, curve.positions, curve.up))
        rows = zip(curve.positions.tolist(), (zero - curve.up).tolist(), (zero - curve.down).tolist(), strict=True)
        what = f"{curve.positions.size} points: position, error +, error -, {unit_of(curve.axis)}"
        lines = [f"; {CAUTION}", f"; axis {curve.axis}, {what}"]
        lines += [f"P{n} {x + 0.0:.4f} {up + 0.0:.4f} {down + 0.0:.4f}" for n, (x, up, down) in enumerate(rows, 1)]
        return f"LSCRW_{curve.axis}.txt", "\n".join([*lines, ""])

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        points = re.findall(r"^P(\d+) (\S+) (\S+) (\S+)$", text, re.M)
        announced = matched(r"^; axis (\w+), (\d+) points", text, name, "has not the points that it announces")
        expect(len(points) == int(announced[2]), name, "has not the points that it announces")
        _, x, up, down = np.array(points, dtype=float).T
        expect(bool(np.all(np.diff(x) > 0)), name, "positions are not ascending")
        if not np.any(down):
            down = up
        curve = Curve(announced[1], announced[1], x, -up, -down)
        closed = curve.turns and (x[0], up[0], down[0]) == (0.0, up[-1], down[-1])
        return periodic_curve(curve) if closed else curve
