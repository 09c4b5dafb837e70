"""Haas lead screw compensation (classic controls): a list in inches every half inch from machine zero downwards.

Value     inches with four decimals. That a value above zero moves the axis in plus is from experience: prove it.
Order     the first entry belongs to machine zero, the next ones to positions half an inch further in minus each (VF
          series manual 96-8000, Lead screw compensation). Machine zero is taken to be the upper end of the axis'
          travel.
Limits    +-127 encoder steps; the same in both directions; the control spreads the list over 256 entries (parameter
          58).
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import ANOTHER_FORMAT, CAUTION, ByHand, Curve, ReadBack, expect, matched
from errpipe.targets._screw_map import ScrewMap

INCH = 25.4  # mm
STEP = INCH / 2  # of HAAS' table: half an inch
# inch: 127 encoder steps, the largest value, of the coarsest encoder, whose step is the list's own resolution of 0.0001
# inch. A finer one allows less: 127 / (steps per inch: parameter 5, 19 or 33).
LIMIT = 127e-4


class HaasPitch(ScrewMap):
    """Compensation values of each axis, the mean of both directions."""

    name = "haas_pitch"
    controller = "Haas VF, HS, SL (classic controls)"
    confidence = "experimental"
    sign = "a positive value moves the axis in plus (prove it on the machine)"
    limits = "every 12.7 mm from the upper end of travel; 2.54 um steps; both directions alike; no temperature"
    unit = "inches, as the control keeps this list whatever it displays"
    holds = ("screw",)
    linear_only = "a list in inches holds no rotary axis"
    keeps_level = False
    rounding_um = 2.6
    remark = {"": "# {}"}
    source = "Haas VF series manual 96-8000 (June 1999) p. 305, Lead screw compensation"
    activation = (
        "the upper end of the axis' travel must be machine zero; note the list that is there before changing it",
        "enter the values on the lead screw compensation page; zero return; compare three points with a gauge",
    )

    max_points, error_um = 256, 1.0

    @classmethod
    def grid(cls, table: CompensationTable, axis: str) -> np.ndarray:
        low, high = _sample.span(table, axis)
        if (needed := int(np.ceil((high - low) / STEP - 1e-9)) + 1) > cls.max_points:
            needs = f"{needed} values of half an inch are needed, {cls.max_points} fit: {ANOTHER_FORMAT}"
            raise GateError(f"{cls.name}: {axis}: {needs}")
        return high - STEP * np.arange(int(np.ceil((high - low) / STEP - 1e-9)), -1, -1)

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        mean = curve.mean
        values = ((mean - mean[-1]) / INCH)[::-1]
        if (largest := float(np.abs(values).max())) > LIMIT:
            raise GateError(
                f"{cls.name}: {curve.axis}: a value of {largest:.4f} inch is needed, {LIMIT:.4f} inch (127 steps) is "
                "the largest that any of these controls takes"
            )
        lines = [
            f"# {CAUTION}",
            f"# {curve.axis}: {values.size} values in inches, machine zero at {curve.positions[-1]:.6f} mm",
        ]
        lines += [f"{n} {v + 0.0:.4f}" for n, v in enumerate(values.tolist())]
        return f"leadscrew_{curve.axis}.txt", "\n".join([*lines, ""])

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        entries = []
        for c in read.curves:
            largest = float(np.abs(c.up).max()) / INCH
            if largest > 0:
                entries.append(
                    f"{c.axis}: the largest value is {largest:.4f} inch; it takes at most 127 encoder steps, so "
                    f"its steps per inch (parameter 5, 19 or 33) must not be more than {127 / largest:.0f}"
                )
        return (*super().by_hand(table, read, others), *map(ByHand, entries))

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        pattern = r"^# (\w+): (\d+) values in inches, machine zero at (\S+) mm$"
        head = matched(pattern, text, name, "has not the values that it announces")
        rows = re.findall(r"^(\d+) (-?[\d.]+)$", text, re.M)
        expect(len(rows) == int(head[2]), name, "has not the values that it announces")
        value = INCH * np.array([float(v) for _, v in rows])[::-1]
        x = float(head[3]) - STEP * np.arange(value.size - 1, -1, -1)
        return Curve(head[1], head[1], x, value, value)
