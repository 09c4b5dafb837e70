"""LinuxCNC screw compensation file, one per joint, `COMP_FILE_TYPE = 1`.

Value     correction in machine units, ADDED to the command (minus the deviation): motor = command + value.
Order     position ascending, value going up, value going down; at most 256 rows.
Traps     no header, no comment, no comma, no empty line: the reader stops at the first invalid line WITHOUT a message.
          A compensation file switches BACKLASH of that joint off. Held beyond both ends. motmod smooths the value: a
          step just above a quarter of the joint's acceleration x period^2 waits until the value itself has come closer.
Inches    a screw file cannot name its unit: errpipe-mm.hal keeps LinuxCNC from starting unless LINEAR_UNITS = mm.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.targets import _sample
from errpipe.targets._base import HOMED_AT_ONCE, ByHand, Curve, ReadBack, expect
from errpipe.targets._screw_map import ScrewMap

GUARD = "errpipe-mm.hal"
ONLY_IN_MM = """\
# The screw files beside this one are in mm. A machine in inches would be moved by 25.4 times its correction: here it
# does not start ("program 'expr' failed").
loadusr -w expr [TRAJ]LINEAR_UNITS : m
"""
MAX_POINTS = 256  # points that the motion module keeps of a joint (EMCMOT_COMP_SIZE)


class LinuxcncScrew(ScrewMap):
    """Screw map of each linear axis, both directions, for LinuxCNC 2.8 and newer."""

    name = "linuxcnc_screw"
    controller = "LinuxCNC"
    confidence = "verified"
    sign = "a positive value moves the joint further in plus"
    limits = "256 rows per joint; the joint's own position only; no temperature"
    unit = "machine units: [TRAJ] LINEAR_UNITS must be mm (ANGULAR_UNITS degree); in inches it would act 25.4 times"
    holds = ("screw", "both directions")
    source = "LinuxCNC: src/emc/motion/usrmotintf.cc (usrmotLoadComp), docs ini-config COMP_FILE"
    activation = (
        f"[HAL] HALFILE = {GUARD}: with LINEAR_UNITS = inch, where a file acts 25.4 times, LinuxCNC does not start",
        "[JOINT_n] COMP_FILE = <axis>.comp",
        "[JOINT_n] COMP_FILE_TYPE = 1",
        "read back joint.n.backlash-filt after each move: it is the value of the file",
        HOMED_AT_ONCE,
    )

    @classmethod
    def by_hand(cls, table: CompensationTable, read: ReadBack, others: Sequence[str]) -> tuple[ByHand, ...]:
        remedy = {
            True: "no BACKLASH (the file holds both directions)",
            False: "BACKLASH has no effect with a COMP_FILE, and the table has no lost motion: measure both directions",
        }
        out = [
            ByHand(f"[JOINT_n] of {c.axis}: {remedy[_sample.depends_on_direction(table, c.axis)]}") for c in read.curves
        ]
        out += [
            ByHand(f"{c.axis}: with WRAPPED_ROTARY the joint counts on: unwind it, or take the HAL component")
            for c in read.curves
            if _sample.turns(table, c.axis)
        ]
        return tuple(out)

    max_points = MAX_POINTS
    error_um = 0.05  # finer than any screw repeats

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        return {**super().write(table), GUARD: ONLY_IN_MM}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        expect(files.get(GUARD, ONLY_IN_MM) == ONLY_IN_MM, GUARD, "keeps no machine in inches from these files")
        return super().read_back({name: text for name, text in files.items() if name != GUARD})

    @classmethod
    def file_of(cls, number: int, curve: Curve) -> tuple[str, str]:
        rows = zip(curve.positions, curve.up, curve.down, strict=True)
        return f"{curve.axis.lower()}.comp", "".join(f"{x:.6f} {up:.9f} {down:.9f}\n" for x, up, down in rows)

    @classmethod
    def curve_of(cls, name: str, text: str) -> Curve:
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
        expect(2 <= len(rows) <= MAX_POINTS, name, f"{len(rows)} rows (2 to {MAX_POINTS} are taken)")
        x, up, down = np.array(rows).T
        axis = name.split(".")[0].upper()
        return Curve(axis, axis, x, up, down)
