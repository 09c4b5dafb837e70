"""Smoothieware / Carvera pitch compensation, `pitch_compensation.dat`: a local pitch MULTIPLIER at each position.

Value     motor travel per commanded travel, 0.5..1.5: 1 + d(correction)/d(position). The controller integrates it
          by trapezoids from zero, so the correction is zero at position 0 and the table's own level is lost. Beyond
          the first and last point it uses their multipliers: these are 1, so that the correction is held.
Limits    X, Y and Z (other lines are skipped); one curve for both directions; no temperature.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import Curve, ReadBack, expect
from errpipe.targets._screw_map import ScrewMap

POINTS = 201  # of an axis
FILE = "pitch_compensation.dat"
OUTSIDE = 0.01  # mm from an end of travel to the point of multiplier 1; single precision keeps them apart up to 80 m


class SmoothiePitch(ScrewMap):
    """Pitch multipliers of each axis; what the controller integrates is the correction."""

    name = "smoothie_pitch"
    controller = "Smoothieware, Carvera"
    confidence = "documented"
    sign = "a multiplier above 1 moves the axis further per commanded travel"
    limits = "X, Y and Z; multipliers 0.5 to 1.5; both directions alike; zero at position 0; no temperature"
    unit = "mm, and motor travel per commanded travel"
    holds = ("screw",)
    keeps_level = False
    source = "the firmware's own reader of pitch_compensation.dat, module key pitch_compensation.enable"
    activation = (
        "copy the file to the SD card; in config: pitch_compensation.enable true; reset",
        "home, then compare three points with a gauge: without that line the file is not read, without any warning",
    )

    @classmethod
    def own_axes(cls, table: CompensationTable) -> list[tuple[int, str]]:
        axes = [(number, axis) for number, axis in super().own_axes(table) if axis in ("X", "Y", "Z")]
        if not axes:
            raise GateError(f"{cls.name}: X, Y and Z only (the firmware skips lines of other axes)")
        return axes

    @classmethod
    def grid(cls, table: CompensationTable, axis: str) -> np.ndarray:
        return np.linspace(*_sample.span(table, axis), POINTS)

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        return FILE, "".join(_rows(curve))

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        rows: dict[str, list[tuple[float, float]]] = {}
        for line in files[FILE].splitlines():
            axis, position, factor = line.split()
            expect(axis in ("X", "Y", "Z"), FILE, f"a line of {axis}, which is skipped")
            expect(0.5 <= float(factor) <= 1.5, FILE, f"a multiplier of {factor}")
            rows.setdefault(axis, []).append((float(position), float(factor)))
        return ReadBack(curves=tuple(_integrated(axis, np.array(r)) for axis, r in rows.items()))


def _rows(curve: Curve) -> list[str]:
    """Multipliers at the nodes such that the trapezoid sums meet the curve at every node, as smooth as can be."""
    x, mean = curve.positions, curve.mean
    slope = np.gradient(mean, x)
    # The trapezoid rule of these slopes misses the curve by a little; one correction step takes that away.
    missed = np.diff(mean) - (slope[1:] + slope[:-1]) / 2 * np.diff(x)
    slope += np.interp(x, (x[1:] + x[:-1]) / 2, missed / np.diff(x))
    x, slope = np.r_[x[0] - OUTSIDE, x, x[-1] + OUTSIDE], np.r_[0.0, slope, 0.0]
    return [f"{curve.axis} {p:.6f} {1.0 + s:.9f}\n" for p, s in zip(x.tolist(), slope.tolist(), strict=True)]


def _integrated(axis: str, rows: np.ndarray) -> Curve:
    x, extra = rows[:, 0], rows[:, 1] - 1.0
    expect(extra[0] == 0.0 == extra[-1], FILE, f"{axis} does not end with a correction of 0")
    sums = np.r_[0.0, np.cumsum((extra[1:] + extra[:-1]) / 2 * np.diff(x))]
    value = sums - np.interp(0.0, x, sums)
    return Curve(axis, axis, x, value, value)
