"""EPICS ecmc look-up table of an encoder: position and value in two columns.

Value     in the axis' unit (mm, deg), ADDED to the encoder's position (ecmcEncoder.cpp, readHwActPos), so the error:
          the deviation itself. An axis that is 10 um too long at +X reads 10 um more there and is brought back by the
          loop.
Order     ascending; straight between, held beyond both ends; at least three rows (ecmcLookupTable.h, validate).
Text      lines that begin with # are comments, one with PREC= sets digits; an empty line is refused.
"""

from __future__ import annotations

import re

import numpy as np

from errpipe.targets._base import Curve, expect
from errpipe.targets._screw_map import ScrewMap

MIN_POINTS = 3  # points of a table
DIGITS = 12  # significant digits of each number


class EcmcLut(ScrewMap):
    """Error of each axis over its encoder's position, the mean of both directions."""

    name = "ecmc_lut"
    controller = "EPICS ecmc"
    confidence = "documented"
    sign = (
        "a positive value is added to the measured position, so the loop moves the axis in minus (it is the deviation)"
    )
    limits = "one curve for both directions; the axis' own position; no temperature"
    holds = ("screw",)
    remark = {"": "# {}"}
    source = "epics-modules/ecmc: devEcmcSup/misc/ecmcLookupTable.h, devEcmcSup/motion/ecmcEncoder.cpp (readHwActPos)"
    activation = (
        "load the file as the encoder's look-up table and enable it (encoder configuration); home the axis",
        "it acts only once the encoder is homed: compare the actual position before and after enabling at three points",
    )

    max_points, error_um = 5000, 0.02

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        x = curve.positions
        if x.size < MIN_POINTS:
            x = np.linspace(x[0], x[-1], MIN_POINTS)
        value = -np.interp(x, curve.positions, curve.mean)
        lines = [f"# {curve.axis}: position, error to be added to it; mm (deg)", f"PREC={DIGITS}"]
        lines += [f"{p + 0.0:.9f} {v + 0.0:.9f}" for p, v in zip(x.tolist(), value.tolist(), strict=True)]
        return f"{curve.axis}_lut.dat", "\n".join([*lines, ""])

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        """As loadTable does: comments and PREC skipped, two numbers a line, sorted, three rows at least."""
        rows = []
        for line in text.splitlines():
            if line.startswith("#") or re.match(r"PREC=\d", line):
                continue
            words = line.split()
            expect(len(words) >= 2, name, f"invalid line {line!r}")
            rows.append([float(w) for w in words[:2]])
        expect(len(rows) >= MIN_POINTS, name, f"{len(rows)} rows ({MIN_POINTS} or more are taken)")
        x, value = np.array(rows).T
        expect(bool(np.all(np.diff(x) >= 0)), name, "is not sorted")
        axis = name.rpartition("_")[0]
        return Curve(axis, axis, x, -value, -value)
