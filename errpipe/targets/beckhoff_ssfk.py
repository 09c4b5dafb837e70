"""TwinCAT CNC (TF5200) / ISG kernel leadscrew compensation list, `kw.ssfk` in `achskw*.lis`.

Value     the ERROR (actual minus set point) in 0.1 um as a whole number: the manual's example 19856.5 where 19866.7 was
          wanted is -102.
Order     equidistant nodes from kw_startpos, the same for both directions; straight between, held at the ends.
Turns     for an axis that turns on `modulo` is 1; first and last entry stand for one position, and the list starts over
          where the axis does (P-COMP-00022): at its lower modulo limit (P-AXIS-00127), usually 0. A table from -180 on
          stays so, any other starts at 0.
Limits    1500 entries unless configured otherwise (P-COMP-00059); the reversal is spread over n_backlash_cyc cycles.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import TURN, ByHand, Curve, ReadBack, expect, periodic_curve, settings_in
from errpipe.targets._screw_map import ScrewMap

MAX_POINTS = 1500  # points of a TwinCAT position correction table
TENTH_UM = 1e-4  # mm
HALF_BELOW = -180.0  # deg: lower modulo limit of an axis that counts to +180


class BeckhoffSsfk(ScrewMap):
    """Screw map of each axis, both directions, in tenths of a micrometre."""

    name = "beckhoff_ssfk"
    controller = "TwinCAT CNC, ISG kernel"
    confidence = "documented"
    sign = "a positive value means the axis went too far; it is moved in minus"
    limits = "1500 equidistant nodes; whole tenths of a micrometre; the axis' own position; no temperature"
    unit = "0.1 um (0.0001 deg), whatever the program counts in"
    holds = ("screw", "both directions")
    rounding_um = 0.15
    numbering = "axis number {1}"
    source = "TF5200 axis compensation lists; ISG kernel parameters kw.ssfk"
    activation = (
        "announce the list in hochlauf.lis (zahl_kw, achs_kw[i], achs_kw_log_ax_nr[i])",
        "lr_param.ssfk 1; P-COMP-00059 at least the number of nodes",
        "read the active compensation value of the axis back at three points, from both sides",
    )
    goes_with = ("beckhoff_crosscomp", "beckhoff_temperature")

    max_points, error_um = MAX_POINTS, 0.1

    @classmethod
    def grid(cls, table: CompensationTable, axis: str) -> np.ndarray:
        """Node distance and start are whole tenths of a micrometre, so the grid is laid on them."""
        points, _ = _sample.uniform(table, axis, axis, cls.max_points, cls.error_um)
        first = points.start
        if _sample.turns(table, axis) and first != HALF_BELOW:
            first = 0.0
        start, step = round(first / TENTH_UM), max(1, int(np.ceil(points.step / TENTH_UM - 1e-6)))
        return (start + step * np.arange(points.count)) * TENTH_UM

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        starts = {a: cls.grid(table, a)[0] for _, a in cls.own_axes(table) if _sample.turns(table, a)}
        limits = "{0}: modulo limits of the axis P-AXIS-00127 = {1:.0f}, P-AXIS-00126 = {2:.0f} (0.0001 deg)"
        turns = (limits.format(a, x / TENTH_UM, (x + TURN) / TENTH_UM) for a, x in starts.items())
        return (*super().by_hand(table, read, others), *map(ByHand, turns))

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        start, second = (round(x / TENTH_UM) for x in curve.positions[:2].tolist())
        facts = {
            "kopf.achs_nr": number,
            "kopf.log_achs_name": curve.axis,
            "kw.ssfk.unit": 1,
            "kw.ssfk.interval": second - start,
            "kw.ssfk.kw_startpos": start,
            "kw.ssfk.kw_nr_max": curve.positions.size,
            "kw.ssfk.bilateral": 1,
            "kw.ssfk.modulo": int(curve.turns),
        }
        for side, correction in (("pos", curve.up), ("neg", curve.down)):
            facts |= {f"kw.ssfk.table[{n}].{side}": v for n, v in enumerate(tenths(correction))}
        return f"achskw{number}.lis", "".join(f"{key:<30}{value}\n" for key, value in facts.items())

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
        settings = settings_in(text)
        count, start, step = (int(settings[f"kw.ssfk.{k}"]) for k in ("kw_nr_max", "kw_startpos", "interval"))
        expect(2 <= count <= MAX_POINTS and step > 0, name, f"{count} nodes (2 to {MAX_POINTS} are taken)")
        tables = []
        for side in ("pos", "neg"):
            values = [settings.get(f"kw.ssfk.table[{n}].{side}") for n in range(count)]
            expect(
                all(v is not None and re.fullmatch(r"-?\d+", v) for v in values), name, f"a node of {side} is missing"
            )
            tables.append(-np.array([int(v) for v in values if v is not None]) * TENTH_UM)
        axis = settings["kopf.log_achs_name"]
        curve = Curve(axis, axis, (start + step * np.arange(count)) * TENTH_UM, tables[0], tables[1])
        if settings["kw.ssfk.modulo"] == "1":
            expect(all(t[0] == t[-1] for t in tables), name, "does not end on its first values, and repeats")
            return periodic_curve(curve)
        return curve


def tenths(correction: np.ndarray) -> list[int]:
    """Corrections in mm as errors in whole tenths of a micrometre; ties are rounded to the even number."""
    return [round(-v / TENTH_UM) for v in correction.tolist()]
