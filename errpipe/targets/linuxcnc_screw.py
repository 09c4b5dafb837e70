"""LinuxCNC screw compensation file, one per joint, `COMP_FILE_TYPE = 1`.

Value     correction in machine units, ADDED to the command (minus the deviation): motor = command + value.
Order     position ascending, value going up, value going down; at most 256 rows.
Traps     no header, no comment, no comma, no empty line: the reader stops at the first odd line WITHOUT a message.
          A compensation file switches BACKLASH of that joint off. Held beyond both ends. motmod smooths the value: a
          step just above a quarter of the joint's acceleration x period^2 waits until the value itself has come closer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import Curve, ReadBack, Target, expect

MOST = 256
ERROR_UM = 0.05  # of interpolation; finer than any screw repeats


class LinuxcncScrew(Target):
    """Screw map of each linear axis, both directions, for LinuxCNC 2.8 and newer."""

    name = "linuxcnc_screw"
    controller = "LinuxCNC"
    confidence = "verified"
    sign = "a positive value moves the joint further in plus"
    limits = "256 rows per joint; the joint's own position only; no temperature"
    source = "LinuxCNC: src/emc/motion/usrmotintf.cc (usrmotLoadComp), docs ini-config COMP_FILE"
    activation = (
        "[JOINT_n] COMP_FILE = <axis>.comp",
        "[JOINT_n] COMP_FILE_TYPE = 1",
        "read back joint.n.backlash-filt after each move: it is the value of the file",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        files = {}
        for axis in _sample.outputs_by_axis(table):
            if axis not in _sample.positions_of(table):
                continue
            points, _ = _sample.uniform(table, axis, axis, MOST, ERROR_UM)
            curve = _sample.curve(table, axis, axis, points.positions())
            rows = zip(curve.positions, curve.up, curve.down, strict=True)
            files[f"{axis.lower()}.comp"] = "".join(f"{x:.6f} {up:.9f} {down:.9f}\n" for x, up, down in rows)
        if not files:
            raise GateError("linuxcnc_screw: no axis of the table is corrected over its own position")
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        return ReadBack(curves=tuple(_read(name, text) for name, text in sorted(files.items())))


def _read(name: str, text: str) -> Curve:
    """As usrmotLoadComp does: three numbers a line, stop at the first line that has not."""
    rows: list[list[float]] = []
    for line in text.split("\n"):
        words = line.split()
        try:
            values = [float(w) for w in words[:3]]
        except ValueError:
            break
        if len(values) < 3:
            break
        expect(not rows or values[0] > rows[-1][0], name, "positions are not ascending")
        rows.append(values)
    expect(2 <= len(rows) <= MOST, name, f"{len(rows)} rows (2 to {MOST} are taken)")
    x, up, down = np.array(rows).T
    axis = name.split(".")[0].upper()
    return Curve(axis, axis, x, up, down)
