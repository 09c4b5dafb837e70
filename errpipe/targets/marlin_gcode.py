"""Marlin: bed mesh (`M421`) and backlash (`M425`) as a G-code file.

Mesh      the bed's height in mm at grid point I (X), J (Y): Z is lifted by it, so the correction of Z. The points lie
          where the firmware was built to have them: 5 x 5 (GRID_MAX_POINTS) over the range named in the file. Z0: at
          every height, else the firmware lets the mesh fade out over its first 10 mm (DEFAULT_LEVELING_FADE_HEIGHT).
Value     of M425: lost motion in mm; steps are added to the first segments after a reversal (feature/backlash.cpp),
          so against each other the direction upwards is pushed by it; F1 takes all of it.
Limits    Z over X and Y, lost motion; no screw errors, no temperature; a negative reversal error cannot be expressed.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Plane, ReadBack, Target, expect

FILE = "errpipe.gcode"
LETTERS = "XYZ"  # axes of M425
POINTS = 5  # along each axis: GRID_MAX_POINTS_X, _Y of most configurations


class MarlinGcode(Target):
    """Z over the bed, and lost motion of each axis."""

    name = "marlin_gcode"
    controller = "Marlin 2"
    confidence = "experimental"
    sign = "a mesh value above zero lifts Z; backlash pushes the axis on after a reversal (prove it on the machine)"
    limits = "Z over 5 x 5 points of X and Y, one lost motion an axis; no screw errors, no temperature"
    unit = "mm: the file begins with G21"
    holds = ("bed", "reversal")
    remark = {"": "; {}"}
    source = "Marlin: feature/backlash.cpp (add_correction_steps), docs M421, M425, M420"
    activation = (
        "MESH_BED_LEVELING or AUTO_BED_LEVELING_UBL with 5 x 5 points over the range that the file names; "
        "BACKLASH_GCODE for M425",
        "run the file, M420 V: the mesh must be the one of the file; M500 keeps it",
        "home, M420 S1 (homing switches the mesh off, without RESTORE_LEVELING_AFTER_G28), then compare Z over "
        "three points of the bed with a gauge, low and 50 mm higher",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        head = [f"; {CAUTION}", "G21"]
        backlash = _sample.backlash_if_any(table, cls.name, LETTERS)
        lines = [
            *head,
            *(["M425 F1 " + " ".join(f"{a}{v:.6f}" for a, v in sorted(backlash.items()))] if backlash else []),
        ]
        if (bed := _sample.height_map(table, POINTS)) is not None:
            lines += _mesh(bed)
        if lines == head:
            others = _sample.of_other_axes(table, LETTERS)
            raise GateError(f"{cls.name}: nothing of the table is a bed or lost motion{others}")
        return {FILE: "\n".join([*lines, "; end", ""])}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        expect(text.rstrip().endswith("; end"), FILE, "is cut off")
        match = re.search(r"^M425 F1(.*)$", text, re.M)
        lost = re.findall(r" ([A-Z])([\d.]+)", match[1]) if match else []
        curves = _sample.lost_motions((axis, float(value)) for axis, value in lost)
        return ReadBack(curves=curves, planes=_read_mesh(text))


def _mesh(plane: Plane) -> list[str]:
    x, y = plane.first, plane.second
    lines = [f"; mesh of {x.size} x {y.size}: X {x[0]:.6f} to {x[-1]:.6f}, Y {y[0]:.6f} to {y[-1]:.6f}", "M420 S0"]
    lines += [f"M421 I{i} J{j} Z{v + 0.0:.6f}" for (i, j), v in np.ndenumerate(plane.values)]
    return [*lines, "M420 S1 Z0"]


def _read_mesh(text: str) -> tuple[Plane, ...]:
    head = re.search(r"^; mesh of (\d+) x (\d+): X (\S+) to (\S+), Y (\S+) to (\S+)$", text, re.M)
    if head is None:
        return ()
    counts = int(head[1]), int(head[2])
    fades = r"^M420 S1(?! Z0$)"
    expect(re.search(fades, text, re.M) is None, FILE, "fades out the mesh with height (M420 S1 without Z0)")
    rows = re.findall(r"^M421 I(\d+) J(\d+) Z(-?[\d.]+)$", text, re.M)
    expect(len(rows) == counts[0] * counts[1], FILE, f"{len(rows)} points in a mesh of {counts[0]} x {counts[1]}")
    values = np.full(counts, np.nan)
    for i, j, v in rows:
        values[int(i), int(j)] = float(v)
    x, y = (
        np.linspace(float(a), float(b), n)
        for a, b, n in zip(head.groups()[2::2], head.groups()[3::2], counts, strict=True)
    )
    return (Plane("Z", ("X", "Y"), x, y, values),)
