"""Heidenhain axis-error compensation: one `.COM` per axis and a `config.CMA` that names them.

Value     the ERROR in mm along each compensated axis (MP720: positive when the travel is too long); the sense of the
          .COM columns and the text frame are from experience: prove both on the control before use.
Columns   AXISPOS, BACKLASH, then one column per compensated axis. BACKLASH is taken to be what comes on top in negative
          traverse; the manual has "the compensation values measured in the negative direction", which may be the whole.
Turns     "with an axis of rotation, the system only recognizes corrections of entries from 0 to 360" (TNC 407 technical
          manual p. 156): the table of an axis that turns on begins at 0, and is taken to repeat.
Mark      the first line of each file says that it is experimental: it is to be taken out once the sense is proved.
Spacing   a power of two times 0.1 um, as TNC 407 to iTNC 530 ask for (TNC 407 technical manual p. 153: 7 mm wanted,
          2^16 x 0.1 um = 6.5536 mm taken); newer controls take any.
Limits    256 rows (TNC 407, iTNC); one line of config.CMA is ACTIVE.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, TURN, ByHand, Curve, Points, ReadBack, Target, expect, periodic_curve

MAX_POINTS = 256  # points of an axis' table
MARK = f"; {CAUTION}; then take this line out\n"
ERROR_UM = 0.1  # between points, at most
TENTH_UM = 1e-4  # mm (deg): unit of the spacing


class HeidenhainCom(Target):
    """Errors of every axis over each axis, with the reversal error of the axis itself."""

    name = "heidenhain_com"
    controller = "Heidenhain MANUALplus 620, iTNC 530, TNC 640"
    confidence = "experimental"
    sign = "a positive value means the travel is too long; the axis is moved in minus (prove it on the control)"
    limits = (
        "256 rows, spacing 2^n x 0.1 um; sums of curves over one axis each; one reversal per position; no temperature"
    )
    unit = "mm, as the word MM in the first line of each table says"
    holds = ("screw", "both directions", "cross")
    source = "MANUALplus 620 technical manual p. 716, 718; TNC 407 technical manual p. 153 to 156"
    activation = (
        "remove the first line of each file: it repeats these instructions",
        "copy the .COM files and config.CMA to the control's table folder; one line ACTIVE *",
        "MP730 axis error compensation active; compare the position display at three points with a gauge",
        "compare them from above too: if an axis that is right from below is off by its error there, the control takes "
        "BACKLASH as the whole value: put the sum of BACKLASH and the axis' own column in its place",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        axes = list(_sample.positions_of(table))
        corrected = list(_sample.outputs_by_axis(table))
        files, whole = {}, {}
        corrected_over = {over: [a for a in corrected if _sample.changes_along(table, a, over)] for over in axes}
        for axis in corrected:  # the constant part is in one curve of an axis only: its own, else the first
            whole[axis] = next((o for o in _sample.axes_own_first(table, axis) if axis in corrected_over[o]), "")
        for over, own in corrected_over.items():
            if own:
                files[f"{over}.COM"] = _com(table, over, own, whole)
        if not files:
            raise GateError("heidenhain_com: no axis of the table is corrected over a position")
        named = " ".join(["0", "*", *(letter if f"{letter}.COM" in files else "-" for letter in axes)])
        head = " ".join(["NR", "ACTIVE", *axes])
        files["CONFIG.CMA"] = "\n".join(["BEGIN CONFIG.CMA", head, named, "[END]", ""])
        return {name: MARK + text for name, text in files.items()}

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        parameter, held = "the control's own backlash (iTNC: MP710)", "= 0, else lost motion acts twice"
        own = dict.fromkeys(c.axis for c in read.curves if c.axis == c.over)
        out = [_sample.backlash_by_hand(table, a, f"{a}: {parameter}", None, held) for a in own]
        for over, (low, high) in read.spans().items():
            if is_rotary(over) and not _sample.turns(table, over) and (low < 0.0 or high > TURN):
                out.append(
                    ByHand(
                        f"{over}: its table runs from {low:g} to {high:g} deg; a control that takes those of a rotary "
                        "axis from 0 to 360 deg only (TNC 407) leaves the rest uncorrected"
                    )
                )
        return tuple(out)

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        files = {name: text.removeprefix(MARK) for name, text in files.items()}
        active = [line.split() for line in files["CONFIG.CMA"].splitlines() if "*" in line.split()[1:2]]
        expect(len(active) == 1, "CONFIG.CMA", f"{len(active)} active lines (one is needed)")
        curves = []
        for name in (word for word in active[0][2:] if word != "-"):
            expect(f"{name}.COM" in files, "CONFIG.CMA", f"names {name}.COM, which does not exist")
            curves += _read(name, files[f"{name}.COM"])
        return ReadBack(curves=tuple(curves))


def _com(table: CompensationTable, over: str, own: list[str], whole: Mapping[str, str]) -> str:
    points = min((_sample.uniform(table, a, over, MAX_POINTS, ERROR_UM)[0] for a in own), key=lambda p: p.step)
    x = _power_of_two(replace(points, start=0.0) if _sample.turns(table, over) else points)
    count = x.size
    curves = {axis: _sample.at_nodes(table, axis, over, x, relative=whole[axis] != over) for axis in own}
    reversal = curves[over].up - curves[over].down if over in curves else np.zeros(count)
    lines = [f"BEGIN {over}.COM MM", " ".join(["NR", "AXISPOS", "BACKLASH", *own])]
    for n in range(count):
        errors = [-(c.up[n] if axis == over else c.mean[n]) + 0.0 for axis, c in curves.items()]
        lines.append(" ".join([str(n), f"{x[n]:+.6f}", f"{reversal[n] + 0.0:+.6f}", *(f"{e:+.6f}" for e in errors)]))
    return "\n".join([*lines, "[END]", ""])


def _power_of_two(points: Points) -> np.ndarray:
    """Positions from the first on in steps of 2^n x 0.1 um: the largest that is as fine, or fits the rows."""
    length = points.step * (points.count - 1)
    step = TENTH_UM * 2.0 ** math.floor(math.log2(points.step / TENTH_UM) + 1e-9)
    while math.ceil(length / step - 1e-9) + 1 > MAX_POINTS:
        step *= 2
    return points.start + step * np.arange(math.ceil(length / step - 1e-9) + 1)


def _read(over: str, text: str) -> list[Curve]:
    lines = text.splitlines()
    expect(lines[0] == f"BEGIN {over}.COM MM" and lines[-1] == "[END]", f"{over}.COM", "has no BEGIN ... [END] frame")
    names = lines[1].split()[3:]
    rows = np.array([line.split() for line in lines[2:-1]], dtype=float)
    expect(2 <= len(rows) <= MAX_POINTS, f"{over}.COM", f"{len(rows)} rows (2 to {MAX_POINTS} are taken)")
    steps = np.diff(rows[:, 1]) / TENTH_UM
    whole = np.abs(steps - 2.0 ** np.round(np.log2(steps))).max() < 0.1
    expect(bool(whole), f"{over}.COM", "its spacing is not a power of two times 0.1 um")
    curves = []
    for column, axis in enumerate(names, 3):
        up = -rows[:, column]
        curve = Curve(axis, over, rows[:, 1], up, up - rows[:, 2] if axis == over else up)
        turns = is_rotary(over) and rows[0, 1] == 0.0 and rows[-2, 1] < TURN <= rows[-1, 1]
        curves.append(periodic_curve(curve) if turns else curve)
    return curves
