"""TwinCAT CNC (TF5200) / ISG kernel cross compensation, `kw.crosscomp`: one axis corrected over another.

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
from errpipe.targets._base import CAUTION, Curve, NothingToAddError, ReadBack, Target, expect

MOST = 1001
ERROR_UM = 0.1
TENTH_UM = 1e-4  # mm


class BeckhoffCrosscomp(Target):
    """Each axis over every other axis that bends it: straightness, squareness, sag."""

    name = "beckhoff_crosscomp"
    controller = "TwinCAT CNC, ISG kernel"
    confidence = "experimental"
    sign = "a positive value moves the slave axis in plus (prove it on the machine)"
    limits = "1001 nodes per table; one curve per pair of axes; mean of both directions; no temperature"
    unit = "0.1 um (0.0001 deg), whatever the program counts in"
    holds = ("cross",)
    rounding_um = 0.2
    remark = {"": "# {}"}
    source = "TF5200 axis compensation, cross compensation; ISG kernel parameters kw.crosscomp"
    activation = ("lr_param.crosscomp 1 of the slave axis", "compare the slave's offset at three master positions")
    goes_with = ("beckhoff_ssfk", "beckhoff_temperature")

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return cls.write_beside(table, ())

    @classmethod
    def write_beside(cls, table: CompensationTable, others: Sequence[str]) -> dict[str, str]:
        axes, files = _sample.axes_of(table), {}
        for axis in _sample.outputs_by_axis(table):
            # Whether another curve holds what stands still: only one of an axis' curves may.
            rest = "beckhoff_ssfk" in others and axis in _sample.positions_of(table)
            for over in _sample.positions_of(table):
                if over == axis or not _sample.moves_with(table, axis, over):
                    continue
                points, _ = _sample.uniform(table, axis, over, MOST, ERROR_UM)
                curve = _sample.curve(table, axis, over, points.positions(), relative=rest)
                rest = True
                files[f"cross_{axis}_over_{over}.lis"] = _text(axes, axis, over, curve)
        if not files and others:
            raise NothingToAddError(f"beckhoff_crosscomp: {' and '.join(others)} say all that it could")
        if not files:
            raise GateError("beckhoff_crosscomp: no axis of the table is corrected over another one")
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return ReadBack(curves=tuple(_read(name, text) for name, text in sorted(files.items())))


def _text(axes: list[str], axis: str, over: str, curve: Curve) -> str:
    lines = [f"# {CAUTION}", f"kopf.achs_nr {axes.index(over) + 1}", f"kopf.log_achs_name {over}"]
    lines += [f"kw.crosscomp.slave_ax_nr {axes.index(axis) + 1}", f"kw.crosscomp.last_index {curve.positions.size - 1}"]
    mean = (curve.up + curve.down) / 2
    for n, (x, v) in enumerate(zip(curve.positions.tolist(), mean.tolist(), strict=True)):
        lines.append(f"kw.crosscomp.table[{n}].setpoint {round(x / TENTH_UM)}")
        lines.append(f"kw.crosscomp.table[{n}].correction {round(v / TENTH_UM)}")
    return "\n".join(lines) + "\n"


def _read(name: str, text: str) -> Curve:
    settings = dict(line.split("#")[0].split() for line in text.splitlines() if line.split("#")[0].strip())
    count = int(settings["kw.crosscomp.last_index"]) + 1
    expect(2 <= count <= MOST, name, f"{count} nodes (2 to {MOST} are taken)")
    column = {
        key: np.array([int(settings[f"kw.crosscomp.table[{n}].{key}"]) for n in range(count)]) * TENTH_UM
        for key in ("setpoint", "correction")
    }
    expect(bool(np.all(np.diff(column["setpoint"]) > 0)), name, "set points are not ascending")
    _, axis, _, over = name.split(".")[0].split("_")
    return Curve(axis, over, column["setpoint"], column["correction"], column["correction"])
