"""Fanuc 0i / 16i / 18i / 30i stored pitch error compensation: incremental whole pulses and their parameters.

Value     pulses of one detection unit (1 um), INCREMENTAL: the running sum from the reference point is the correction
          added to the command. The sign is from experience: prove it on the machine before cutting.
Rounding  the running sum is rounded, not each step, so errors do not add up.
Limits    -7..+7 per point (16i, 0i), 1024 points in all; direction needs parameter 3605#0 and a second set.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Curve, Points, ReadBack, expect, too_many
from errpipe.targets._screw_map import ScrewMap

UNIT = 1e-3  # mm, one detection unit
LARGEST, MOST = 7, 1024
FILE = "PITCH.TXT"


class FanucPitch(ScrewMap):
    """Pitch data of each axis in both directions, with the parameters that go with them."""

    name = "fanuc_pitch"
    controller = "Fanuc 0i, 16i, 18i, 30i"
    confidence = "experimental"
    sign = "a running sum above zero moves the axis in plus (prove it on the machine)"
    limits = "whole micrometres; -7..+7 per point; 1024 points in all; the axis' own position; no temperature"
    holds = ("screw", "both directions")
    rounding_um = 1.0
    source = "B-63980EN, B-63950EN, A-77810E (parameters 3620 to 3627); pitch block from experience"
    activation = (
        "parameters 3620 to 3624, 3626, 3627; 3605#0 = 1 for two directions; power off and on; reference again",
        "read the pitch screen back; compare the machine position at three points from both sides",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        axes = [axis for _, axis in cls.own_axes(table)]
        most = MOST // (2 * len(axes))
        lines, first = ["%", f"({CAUTION.upper()})"], 0
        for number, axis in enumerate(axes, 1):
            points, left = _sample.uniform(table, axis, axis, most, 0.5)
            curve = _whole_steps(table, axis, points, most, left)
            lines += _block(number, axis, first, curve)
            first += 2 * curve.positions.size
        return {FILE: "\n".join([*lines, "%", ""])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.startswith("%") and text.rstrip().endswith("%"), FILE, "is not framed by %")
        data = {int(n) - 10000: int(v) for n, v in re.findall(r"N(1\d{4})Q0P(-?\d+)", text)}
        facts: dict[tuple[int, int], float] = {
            (int(k), int(a)): float(v) for k, a, v in re.findall(r"N0(36\d\d)Q1A(\d+)P(-?[\d.]+)", text)
        }
        curves = []
        for number, axis, start in re.findall(r"\(A(\d+) (\w) FROM (-?[\d.]+)\)", text):
            curves.append(_read(int(number), axis, float(start), facts, data))
        return ReadBack(curves=tuple(curves))


def _whole_steps(table: CompensationTable, axis: str, points: Points, most: int, left: float) -> Curve:
    """A grid so fine that no step between points exceeds the format's largest."""
    low, high = _sample.span(table, axis)
    count = points.count
    while True:
        step = np.ceil((high - low) / (count - 1) * 1e3) / 1e3  # the interval is a whole number of micrometres
        curve = _sample.curve(table, axis, axis, low + step * np.arange(count))
        if max(np.abs(np.diff(_pulses(v))).max() for v in (curve.up, curve.down)) <= LARGEST:
            return curve
        if count >= most:
            raise too_many("fanuc_pitch", count + 1, most, left)
        count = min(most, count + max(1, count // 4))


def _pulses(correction: np.ndarray) -> np.ndarray:
    """Running sums: the correction relative to the first point, in whole pulses."""
    return np.round((correction - correction[0]) / UNIT).astype(int)


def _block(number: int, axis: str, first: int, curve: Curve) -> list[str]:
    """Point numbers run from `first`; the negative-travel set follows; 3627 carries the offset between the sets."""
    n = curve.positions.size
    interval = round(float(curve.positions[1] - curve.positions[0]) * 1e3)
    at_start = {side: round(float(v[0]) / UNIT) for side, v in (("up", curve.up), ("down", curve.down))}
    parameters = {
        3620: first,
        3621: first,
        3622: first + n - 1,
        3623: 1,
        3624: interval,
        3626: first + n,
        3627: at_start["down"] - at_start["up"],
    }
    lines = [f"(A{number} {axis} FROM {curve.positions[0]:.6f})", f"(A{number} OFFSET {at_start['up']})"]
    lines += [f"N0{key}Q1A{number}P{value};" for key, value in parameters.items()]
    for offset, values in ((0, curve.up), (n, curve.down)):
        sums = _pulses(values)
        steps = np.diff(sums, prepend=0)
        lines += [f"N{10000 + first + offset + k}Q0P{step};" for k, step in enumerate(steps.tolist())]
    return lines


def _read(number: int, axis: str, start: float, facts: dict, data: dict[int, int]) -> Curve:
    lowest, highest, interval = (facts[key, number] for key in (3621, 3622, 3624))
    n = int(highest - lowest) + 1
    sides = []
    for first in (int(lowest), int(facts[3626, number])):
        steps = [data.get(first + k) for k in range(n)]
        sound = all(s is not None and abs(s) <= LARGEST for s in steps)
        expect(sound, FILE, f"A{number}: a point is missing or too large")
        sides.append(np.cumsum(np.array(steps, dtype=float)) * UNIT)
    # The table starts at the reference point with nothing; what the machine has there belongs to its datum.
    down = sides[1] + facts[3627, number] * UNIT
    return Curve(axis, axis, start + interval * 1e-3 * np.arange(n), sides[0], down)
