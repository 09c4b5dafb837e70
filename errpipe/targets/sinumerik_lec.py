"""SINUMERIK 840D sl / 828D / 808D leadscrew error compensation ($AA_ENC_COMP), one direction.

Value     the ERROR in mm: a positive value moves the axis in NEGATIVE direction (808D manual), so the deviation.
Order     equidistant from MIN to MAX in STEP, which are binary fractions, so that (MAX - MIN) / STEP is whole; straight
          between points; held outside (experience), or repeated with every turn of an axis that turns on: IS_MODULO
          (p. 241), which wants equal values at both ends.
Limits    one curve for both directions; the reversal error belongs to MD32450 BACKLASH or to two CEC tables.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import ByHand, Curve, ReadBack, expect, grid_stated, periodic_curve, points_in_file
from errpipe.targets._screw_map import ScrewMap


class SinumerikLec(ScrewMap):
    """Leadscrew error compensation of each axis: the mean of both directions."""

    name = "sinumerik_lec"
    controller = "Siemens SINUMERIK 840D sl, 828D, 808D"
    confidence = "documented"
    sign = "a positive value moves the axis in minus (it is the deviation)"
    limits = "equidistant; 200 points (808D; 840D sl: MD38000); one direction; the axis' own position"
    holds = ("screw",)
    remark = {"": "; {}"}
    numbering = "AX{1}"
    source = "Function Manual Extended Functions 6FC5397-1BP40-3BA1 (K3); 808D manual"
    activation = (
        "MD38000 MM_ENC_COMP_MAX_POINTS at least the number below, then power on",
        "MD32700 ENC_COMP_ENABLE = 0 while the file is loaded, then 1; reference the axis again",
        "MD32450 BACKLASH as below; read $AA_ENC_COMP back and compare three points from both sides",
    )
    goes_with = ("sinumerik_cec", "sinumerik_temperature")

    max_points, error_um = 200, 0.1  # 808D fixed; 840D sl by MD38000

    @classmethod
    def grid(cls, table: CompensationTable, axis: str) -> np.ndarray:
        return _sample.exact(_sample.uniform(table, axis, axis, cls.max_points, cls.error_um)[0]).positions()

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        lost, out = _sample.lost_motion(table), []
        for number, axis in cls.own_axes(table):
            curve = next(c for c in read.curves if c.axis == axis)
            out.append(ByHand(f"AX{number} ({axis}): MD38000 MM_ENC_COMP_MAX_POINTS = {points_in_file(curve)} or more"))
            value = 0.0 if "sinumerik_cec" in others else lost.get(axis, 0.0)  # its tables hold both directions
            side = "; above 0: the encoder runs ahead of the table" if value > 0 else ""
            parameter = f"AX{number} ({axis}): MD32450 BACKLASH"
            out.append(_sample.backlash_by_hand(table, axis, parameter, value, remark=side))
        return tuple(out)

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        x, ax = curve.positions, f"AX{number}"
        lines = [f"%_N_{ax}_EEC_INI", "CHANDATA(1)"]
        lines += [f"$AA_ENC_COMP[0,{n},{ax}]={v + 0.0:.6f}" for n, v in enumerate(-curve.mean)]
        facts = {"STEP": float(x[1] - x[0]), "MIN": float(x[0]), "MAX": float(x[-1])}
        lines += [f"$AA_ENC_COMP_{key}[0,{ax}]={_sample.decimal(value)}" for key, value in facts.items()]
        lines += [f"$AA_ENC_COMP_IS_MODULO[0,{ax}]={curve.turns:d}", "M17", ""]
        return f"{ax}_{curve.axis}_EEC.INI", "\n".join(lines)

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        points = {int(n): float(v) for n, v in re.findall(r"\$AA_ENC_COMP\[0,(\d+),\w+\]=(\S+)", text)}
        facts = {k: float(v) for k, v in re.findall(r"\$AA_ENC_COMP_(STEP|MIN|MAX)\[0,\w+\]=(\S+)", text)}
        expect(len(facts) == 3 and facts["STEP"] > 0, name, "STEP, MIN or MAX is missing")
        x = grid_stated(facts)
        count = x.size
        expect(sorted(points) == list(range(count)), name, f"{len(points)} points where MIN, MAX and STEP say {count}")
        expect(text.rstrip().endswith("M17"), name, "does not end with M17")
        value = -np.array([points[n] for n in range(count)])
        axis = name.split("_")[1]
        curve = Curve(axis, axis, x, value, value)
        if re.search(r"IS_MODULO\[0,\w+\]=1", text):
            expect(value[0] == value[-1], name, "does not end on its first value, and repeats")
            return periodic_curve(curve)
        return curve
