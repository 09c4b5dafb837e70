"""Aerotech Automation1 axis calibration file (`.cal`): one 1D table an axis.

Value     a correction in mm, ADDED by the controller (help: "axis calibration is additive"; which way, and how the
          keywords are spelt, is from experience: load it with the axis clear of any part and prove it).
Order     equidistant from the offset in sample distances; straight between, the nearest end held beyond (help, Axis
          Calibration); axes are counted from 1, UTF-8; the sign follows the encoder, not ReverseMotionDirection.
Limits    both directions alike ("all corrections are bidirectional"); the axis' own position.
"""

from __future__ import annotations

import numpy as np

from errpipe.targets._base import CAUTION, Curve, matched
from errpipe.targets._screw_map import ScrewMap


class AerotechCal(ScrewMap):
    """1D calibration of each axis, the mean of both directions."""

    name = "aerotech_cal"
    controller = "Aerotech Automation1"
    confidence = "experimental"
    sign = "a positive value moves the axis in plus (prove it on the machine)"
    limits = "equidistant; one curve for both directions; the axis' own position; no temperature"
    holds = ("screw",)
    remark = {"": "; {}"}
    numbering = "axis {1}"
    source = "help.aerotech.com/automation1, Axis Calibration (semantics); keywords from experience"
    activation = (
        "compare the keywords with the controller's own help before loading; list the file under Calibration",
        "home; read the axis' calibration correction back at three points: it must be the list below",
    )

    max_points, error_um = 5000, 0.05

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        step = float(curve.positions[1] - curve.positions[0])
        head = f":START1D REFAXIS={number} OUTAXIS={number} POSUNIT=PRIMARY CORUNIT=PRIMARY"
        lines = [
            f"; {CAUTION}",
            f"; {number} = {curve.axis}",
            f"{head} OFFSET={curve.positions[0]:.9f} SAMPLEDIST={step:.9f}",
        ]
        lines += [f"{v + 0.0:.7f}" for v in (curve.mean).tolist()]
        return f"{curve.axis}.cal", "\n".join([*lines, ":END", ""])

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        pattern = r"^:START1D REFAXIS=(\d+) OUTAXIS=\1 .*OFFSET=(\S+) SAMPLEDIST=(\S+)$((?:\n[-\d.]+)+)\n:END$"
        match = matched(pattern, text, name, "has no table between :START1D and :END")
        value = np.array(match[4].split(), dtype=float)
        axis = name.partition(".")[0]
        return Curve(axis, axis, float(match[2]) + float(match[3]) * np.arange(value.size), value, value)
