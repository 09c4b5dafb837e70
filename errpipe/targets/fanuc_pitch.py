"""Fanuc 0i / 16i / 18i / 30i stored pitch error compensation: incremental whole pulses and their parameters.

Value     pulses of one detection unit (1 um), INCREMENTAL: the running sum from the reference point is the correction
          added to the command. The sign is from experience: prove it on the machine before cutting.
Points    parameter 3620 is the number of the point at the reference position (machine coordinate 0 here). The value of
          a point belongs to the interval that ends there, so the lowest number is 3620 - (travel below 0) / interval
          + 1 and the highest 3620 + (travel above 0) / interval (B-63980EN p. 99: -400 to +400 mm in steps of 50 mm
          around point 40 begin at point 33). Of an axis that turns on, parameter 3625 is one turn, the lowest point is
          that of the reference position and holds the value of the highest, and the values behind it add up to
          nothing (same manual, p. 100: 45 deg apart from point 60 on, points 60 to 68, equal values at 60 and 68).
Rounding  the running sum is rounded, not each step, so errors do not add up.
Steps     a control that does not interpolate puts all pulses of a point out at once, so that as much is wrong between
          points: the interval is made so short that a point has one pulse, where the number of points and the rapid
          traverse allow it (shortest interval in mm: rapid traverse in mm/min / 7500, parameter 3624).
Limits    -7..+7 per point (16i, 0i), 1024 points in all; direction needs parameter 3605#0 and a second set.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError, VerifyError
from errpipe.targets import _sample
from errpipe.targets._base import (
    ANOTHER_FORMAT,
    CAUTION,
    TURN,
    ByHand,
    Curve,
    Points,
    ReadBack,
    expect,
    periodic_curve,
    too_many,
    unit_of,
)
from errpipe.targets._screw_map import ScrewMap

UNIT = 1e-3  # mm, one detection unit
MAX_PULSES, MAX_POINTS = 7, 1024  # pulses of one increment; points
TO_INTERVAL = 7500  # mm/min (deg/min) of rapid traverse per mm (deg) of the interval, parameter 3624
MIN_INTERVAL = {"mm": 4.0, "deg": 2.0}  # interval for 30 m/min and 42 rpm; shorter only where values need it
SPARE = 3  # points that a grid laid around the reference may need more than one laid from the end of travel
FILE = "PITCH.TXT"


class FanucPitch(ScrewMap):
    """Pitch data of each axis in both directions, with the parameters that go with them."""

    name = "fanuc_pitch"
    controller = "Fanuc 0i, 16i, 18i, 30i"
    confidence = "experimental"
    sign = "a running sum above zero moves the axis in plus (prove it on the machine)"
    limits = "whole micrometres; -7..+7 per point; 1024 points in all; the axis' own position; no temperature"
    unit = "pulses of 1 um: a metric machine (1001#0 INM = 0) with 1 um detection unit; any other does not take them"
    holds = ("screw", "both directions")
    keeps_level = False
    rounding_um = 1.0
    numbering = "A{1}"
    source = "B-63980EN, B-63950EN, A-77810E (parameters 3620 to 3627); pitch block from experience"
    activation = (
        "the reference position must lie at machine coordinate 0 (parameter 1240 = 0), where point 3620 is; where it "
        "lies elsewhere, this file would act shifted",
        "parameters 3620 to 3627 (3625: axes that turn on); 3605#0 = 1 for two directions; power off, on; reference",
        "3627 holds for an axis that is referenced in plus (1006#5 ZMI = 0); referenced in minus, its sign changes",
        "read the pitch screen back; compare the machine position at three points from both sides",
    )

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        return (*super().by_hand(table, read, others), *(ByHand(_steps(c)) for c in read.curves))

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        axes = cls.own_axes(table)
        limit = MAX_POINTS // (2 * len(axes))
        lines, first = ["%", f"({CAUTION.upper()})"], 0
        for number, axis in axes:
            points, error = _sample.uniform(table, axis, axis, limit - SPARE, 0.5)
            curve = _whole_steps(table, axis, points, limit, error)
            lines += _block(number, axis, first, curve)
            first += 2 * (curve.positions.size - 1 + _sample.turns(table, axis))
        return {FILE: "\n".join([*lines, "%", ""])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.startswith("%") and text.rstrip().endswith("%"), FILE, "is not framed by %")
        data = {int(n) - 10000: int(v) for n, v in re.findall(r"N(1\d{4})Q0P(-?\d+)", text)}
        facts: dict[tuple[int, int], int] = {
            (int(k), int(a)): int(v) for k, a, v in re.findall(r"N0(36\d\d)Q1A(\d+)P(-?\d+)", text)
        }
        axes = re.findall(r"\(A(\d+) (\w+)\)", text)
        return ReadBack(curves=tuple(_read(int(number), axis, facts, data) for number, axis in axes))


def _whole_steps(table: CompensationTable, axis: str, points: Points, limit: int, left: float) -> Curve:
    """A grid so fine that no point has more than one pulse, or as few as can be; one of it is the reference, 0."""
    low, high = _sample.span(table, axis)
    turns, count = _sample.turns(table, axis), points.count
    best, largest = None, MAX_PULSES + 1
    while True:
        if turns:  # points that divide a turn into whole micrometres, at least so many
            count = 1 + min((n for n in _sample.TURN_INTERVALS if n >= count - 1), default=_sample.TURN_INTERVALS[-1])
        x = _around_reference(low, high, count, turns)
        enough = best is not None and float(x[1] - x[0]) < MIN_INTERVAL[unit_of(axis)]
        if x.size > limit or enough:
            break
        curve = _sample.at_nodes(table, axis, axis, x)
        zero = int(np.abs(x).argmin())
        pulses = max(int(np.abs(np.diff(_pulses(v, zero))).max()) for v in (curve.up, curve.down))
        if pulses < largest:
            best, largest = curve, pulses
        if largest <= 1 or count >= limit - SPARE:
            break
        count = min(limit - SPARE, count + max(1, count // 4))
    if best is None and x.size <= limit:
        steep = f"{axis} changes by more than {MAX_PULSES} pulses from point to point of {limit}"
        raise GateError(f"fanuc_pitch: {steep}: {ANOTHER_FORMAT}")
    if best is None:
        raise too_many("fanuc_pitch", x.size, limit, left)
    return best


def _around_reference(low: float, high: float, count: int, turns: bool) -> np.ndarray:
    """Positions in whole intervals from the reference, which is one of them, mm (deg); at least so many over travel."""
    if turns:
        return TURN / (count - 1) * np.arange(count)
    step = float(np.ceil((high - low) / (count - 1) * 1e3) / 1e3)  # the interval is a whole number of micrometres
    # A reference outside the travel is reached by points that change nothing; one point lies below it always.
    return step * _sample.around_zero(low, high, step)


def _steps(curve: Curve) -> str:
    """How long the interval is, and how many pulses come at once, in words."""
    interval = float(curve.positions[1] - curve.positions[0])
    pulses = max(float(np.abs(np.diff(v)).max()) for v in (curve.up, curve.down)) / UNIT
    return (
        f"{curve.axis}: rapid traverse at most {interval * TO_INTERVAL:.0f} {unit_of(curve.axis)}/min (3624); "
        f"a point has at most {pulses:.0f} pulses: so much more is left where the control does not interpolate"
    )


def _pulses(correction: np.ndarray, reference: int) -> np.ndarray:
    """Running sums: the correction relative to the point at the reference position, in whole pulses."""
    return np.round((correction - correction[reference]) / UNIT).astype(int)


def _block(number: int, axis: str, first: int, curve: Curve) -> list[str]:
    """Point numbers run from `first`; the negative-travel set follows; 3627 carries the offset between the sets.

    Every number belongs to an interval, so there is one fewer than there are positions.
    """
    turns = int(curve.turns)
    n = curve.positions.size - 1 + turns
    interval = round(float(curve.positions[1] - curve.positions[0]) * 1e3)
    reference = round(-float(curve.positions[0]) * 1e3 / interval)
    parameters = {
        3620: first + reference - 1 + turns,
        3621: first,
        3622: first + n - 1,
        3623: 1,
        3624: interval,
        **({3625: round(TURN * 1e3)} if turns else {}),
        3626: first + n,
        3627: round(float(curve.down[reference] - curve.up[reference]) / UNIT),
    }
    lines = [f"(A{number} {axis})"]
    lines += [f"N0{key}Q1A{number}P{value};" for key, value in parameters.items()]
    for offset, values in ((0, curve.up), (n, curve.down)):
        steps = np.diff(_pulses(values, reference))
        steps = np.r_[steps[-turns:], steps] if turns else steps
        lines += [f"N{10000 + first + offset + k}Q0P{step};" for k, step in enumerate(steps.tolist())]
    return lines


def _read(number: int, axis: str, facts: Mapping[tuple[int, int], int], data: Mapping[int, int]) -> Curve:
    needed = [facts.get((key, number)) for key in (3620, 3621, 3622, 3624, 3626, 3627)]
    if None in needed:
        raise VerifyError(f"{FILE}: A{number}: a parameter is missing")
    reference, lowest, highest, interval, negative, offset = (int(v) for v in needed if v is not None)
    n, turns = highest - lowest + 1, facts.get((3625, number), 0)
    at_reference = reference - lowest + 1  # as a position: the lowest point's interval begins one below it
    expect(0 <= at_reference <= n and interval > 0, FILE, f"A{number}: 3620 is not among 3621 to 3622")
    sides = []
    for first in (lowest, negative):
        steps = [data.get(first + k) for k in range(n)]
        sound = all(s is not None and abs(s) <= MAX_PULSES for s in steps)
        expect(sound, FILE, f"A{number}: a point is missing or too large")
        sums = np.concatenate(([0.0], np.cumsum(np.array(steps, dtype=float))))
        sides.append((sums - sums[at_reference]) * UNIT)
        closed = not turns or (lowest == reference and sums[-1] == sums[1] and steps[0] == steps[-1])
        expect(closed, FILE, f"A{number}: a turn does not close, each would add to the last")
    # The correction at the reference position is nothing; what the machine has there belongs to its datum.
    x = interval * 1e-3 * (np.arange(n + 1) - at_reference)
    curve = Curve(axis, axis, x, sides[0], sides[1] + offset * UNIT)
    if turns:
        expect(
            interval * (n - 1) == turns, FILE, f"A{number}: 3625 is not the way from the lowest point to the highest"
        )
        return periodic_curve(Curve(axis, axis, x[1:], curve.up[1:], curve.down[1:]))
    return curve
