"""TwinCAT CNC (TF5200) / ISG kernel cross compensation, `kw.crosscomp`: one axis corrected over another.

List      belongs to the SLAVE axis and names its master by `master_ax_nr` (P-AXIS-00047, P-COMP-00005; the page on the
          whole structure says "of the master axis", its parameters and its example of plane compensation the slave's);
          a slave has one master only, so the one with the largest curve is written.
Value     `.correction` in 0.1 um as a whole number, ADDED to the slave axis (its name says so; no example with a
          sign was found: prove it on the machine).
Order     `.setpoint` of the master ascending in 0.1 um; straight between, held at the ends; at most 1001 nodes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Curve, NothingToAddError, ReadBack, Target, expect, matched, settings_in

MAX_NODES = 1001  # nodes of a table
ERROR_UM = 0.1  # between points, at most
TENTH_UM = 1e-4  # mm


class BeckhoffCrosscomp(Target):
    """Each axis over every other axis that bends it: straightness, squareness, sag."""

    name = "beckhoff_crosscomp"
    controller = "TwinCAT CNC, ISG kernel"
    confidence = "experimental"
    sign = "a positive value moves the slave axis in plus (prove it on the machine)"
    limits = "1001 nodes per table; one master axis for each slave axis; mean of both directions; no temperature"
    unit = "0.1 um (0.0001 deg), whatever the program counts in"
    holds = ("cross",)
    rounding_um = 0.2
    remark = {"": "# {}"}
    numbering = "axis number {1}"
    source = "TF5200 axis compensation, cross compensation; ISG kernel parameters kw.crosscomp"
    activation = (
        "put the lines into the list (achskw) of the slave axis, beside its screw (the manual has: master, too)",
        "lr_param.crosscomp 1 of the slave axis",
        "compare the slave's offset at three master positions: it moves by the list below, and no other axis moves",
    )
    goes_with = ("beckhoff_ssfk", "beckhoff_temperature")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return cls.write_with(table, ())

    @classmethod
    def write_with(cls, table: CompensationTable, others: Sequence[str]) -> dict[str, str]:
        axes, files = _sample.axes_of(table), {}
        for axis in _sample.outputs_by_axis(table):
            # Whether another curve includes the constant part: only one curve of an axis may.
            rest = "beckhoff_ssfk" in others and axis in _sample.positions_of(table)
            masters = [o for o in _sample.positions_of(table) if o != axis and _sample.changes_along(table, axis, o)]
            grids = {o: _sample.uniform(table, axis, o, MAX_NODES, ERROR_UM)[0].positions() for o in masters}
            curves = [_sample.at_nodes(table, axis, over, x, relative=rest) for over, x in grids.items()]
            if curves:
                largest = max(curves, key=lambda c: float(np.ptp(c.up + c.down)))
                files[f"cross_{axis}_over_{largest.over}.lis"] = _text(axes, largest)
        if not files and others:
            raise NothingToAddError(f"beckhoff_crosscomp: {' and '.join(others)} say all that it could")
        if not files:
            raise GateError("beckhoff_crosscomp: no axis of the table is corrected over another one")
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return ReadBack(curves=tuple(_read(name, text) for name, text in sorted(files.items())))


def _text(axes: list[str], curve: Curve) -> str:
    lines = [f"# {CAUTION}", f"# {curve.axis} over {curve.over}"]
    lines += [f"kopf.achs_nr {axes.index(curve.axis) + 1}", f"kopf.log_achs_name {curve.axis}"]
    lines += ["kw.crosscomp.unit 1", f"kw.crosscomp.master_ax_nr {axes.index(curve.over) + 1}"]
    lines += [f"kw.crosscomp.last_index {curve.positions.size - 1}"]
    for n, (x, v) in enumerate(zip(curve.positions.tolist(), curve.mean.tolist(), strict=True)):
        lines.append(f"kw.crosscomp.table[{n}].setpoint {round(x / TENTH_UM)}")
        lines.append(f"kw.crosscomp.table[{n}].correction {round(v / TENTH_UM)}")
    return "\n".join(lines) + "\n"


def _read(name: str, text: str) -> Curve:
    settings = settings_in(text)
    count = int(settings["kw.crosscomp.last_index"]) + 1
    expect(2 <= count <= MAX_NODES, name, f"{count} nodes (2 to {MAX_NODES} are taken)")
    column = {
        key: np.array([int(settings[f"kw.crosscomp.table[{n}].{key}"]) for n in range(count)]) * TENTH_UM
        for key in ("setpoint", "correction")
    }
    expect(bool(np.all(np.diff(column["setpoint"]) > 0)), name, "set points are not ascending")
    axis, over = matched(r"^# (\w+) over (\w+)$", text, name, "is not the list of its slave axis").groups()
    expect(settings["kopf.log_achs_name"] == axis, name, "is not the list of its slave axis")
    expect(settings["kw.crosscomp.unit"] == "1", name, "counts in increments")
    return Curve(axis, over, column["setpoint"], column["correction"], column["correction"])
