"""Mach4 screw map: start, length, number of points, error at each point.

Value     "expected minus actual" in mm: the correction (minus the deviation). The document is ambiguous about the
          sense and the file's layout is from experience: enter the numbers by hand and prove them with an indicator.
Limits    equidistant; one map before build 4780, separate maps per direction after it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets._base import CAUTION, ByHand, Curve, ReadBack, expect
from errpipe.targets._screw_map import ScrewMap


class Mach4ScrewMap(ScrewMap):
    """Screw map of each motor, one section a direction."""

    name = "mach4_screw_map"
    controller = "Mach4"
    confidence = "experimental"
    sign = "a positive value moves the axis in plus: expected minus actual (prove it on the machine)"
    limits = "equidistant; the axis' own position; no temperature; direction from build 4780 on"
    holds = ("screw", "both directions")
    remark = {"": "# {}"}
    source = "Mach4 screw mapping page of the controller's maker"
    activation = ("enter start, length and points under screw mapping; enable; compare three points from both sides",)

    max_points, error_um = 1000, 0.2

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        lines = (
            ByHand(
                f"{c.axis}: start {c.positions[0]:g}, length {np.ptp(c.positions):g}, {c.positions.size} points, and "
                "each Error line of the file"
            )
            for c in read.curves
        )
        return (*lines, *super().by_hand(table, read, others))

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        n, length, lines = curve.positions.size, float(np.ptp(curve.positions)), [f"# {CAUTION}"]
        for side, values in (("+", curve.up), ("-", curve.down)):
            lines += [f"[{curve.axis}{side}]", f"Start={curve.positions[0]:.6f}", f"Length={length:.6f}", f"Points={n}"]
            lines += [f"Error{k}={v + 0.0:.6f}" for k, v in enumerate(values.tolist())]
        return f"screwmap_{curve.axis}.txt", "\n".join([*lines, ""])

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        axis, sides, facts = name.split(".")[0].split("_")[1], {}, {}
        for part in text.split("[")[1:]:
            head, body = part.split("]\n", 1)
            facts = dict(line.split("=") for line in body.splitlines())
            count = int(facts["Points"])
            expect(count >= 2 and f"Error{count - 1}" in facts, name, f"has not {count} points")
            sides[head[-1]] = np.array([float(facts[f"Error{k}"]) for k in range(count)])
        expect(set(sides) == {"+", "-"}, name, "needs a map for each direction")
        x = float(facts["Start"]) + np.linspace(0.0, float(facts["Length"]), sides["+"].size)
        return Curve(axis, axis, x, sides["+"], sides["-"])
