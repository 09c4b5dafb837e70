"""RepRapFirmware (Duet): height map `heightmap.csv` and `M425` backlash.

Mesh      the bed's height in mm, rows of Y ascending with columns of X ascending: Z is lifted by it, so the
          correction of Z. A bare 0 means "not probed", so that every value has decimals.
Value     of M425: lost motion in mm, taken up at each reversal: the direction upwards is pushed by it against the
          other.
Limits    Z over X and Y on 21 x 21 points (441 fit every board), lost motion; no screw errors, no temperature.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from errpipe.domain.table import CompensationTable
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import CAUTION, Plane, ReadBack, Target, expect

MAP, MACRO = "heightmap.csv", "errpipe.g"
LETTERS = "XYZUVW"  # axes of M425
POINTS = 21  # of the grid, in each direction
LABELS = "axis0,axis1,min0,max0,min1,max1,radius,spacing0,spacing1,num0,num1"
TITLE = "RepRapFirmware height map file v2 generated at 2000-01-01 00:00"  # no clock: equal tables give equal bytes


class ReprapHeightmap(Target):
    """Z over the bed, and lost motion of each axis."""

    name = "reprap_heightmap"
    controller = "RepRapFirmware 3 (Duet)"
    confidence = "experimental"
    sign = (
        "a map value above zero lifts Z; a backlash value pushes the axis on after a reversal (prove it on the machine)"
    )
    limits = "Z over 21 x 21 points of X and Y, one lost motion an axis; no screw errors, no temperature"
    unit = "mm: the macro begins with G21, the map is always in mm"
    holds = ("bed", "reversal")
    source = "docs.duet3d.com: mesh bed compensation, G29, M425; RepRapFirmware Grid.cpp (height map file v2)"
    activation = (
        "copy the files to /sys; G29 S1 loads the map (M376 tapers it off with height: leave it unset)",
        'M98 P"errpipe.g" sets the lost motion (RepRapFirmware 3.5 and newer)',
        "home, then compare Z over three points of the bed with a gauge",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        files = {}
        if lost := _sample.backlash_if_any(table, cls.name, LETTERS):
            files[MACRO] = f"; {CAUTION}\nG21\nM425 " + " ".join(f"{a}{v:.6f}" for a, v in sorted(lost.items())) + "\n"
        if (bed := _sample.height_map(table, POINTS)) is not None:
            files[MAP] = _map(bed)
        if not files:
            others = _sample.of_other_axes(table, LETTERS)
            raise GateError(f"{cls.name}: nothing of the table is a bed or lost motion{others}")
        return files

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        match = re.search(r"^M425(.*)$", files.get(MACRO, ""), re.M)
        lost = re.findall(r" ([A-Z])([\d.]+)", match[1]) if match else []
        curves = _sample.lost_motions((axis, float(value)) for axis, value in lost)
        return ReadBack(curves=curves, planes=(_read_map(files[MAP]),) if MAP in files else ())


def _map(plane: Plane) -> str:
    x, y, v = plane.first, plane.second, plane.values
    error = f"min error {v.min():.3f}, max error {v.max():.3f}, mean {v.mean():.3f}, deviation {v.std():.3f}"
    ends = ",".join(f"{e:.6f}" for e in (x[0], x[-1], y[0], y[-1]))
    steps = f"{x[1] - x[0]:.6f},{y[1] - y[0]:.6f}"
    rows = [",".join(f"{z + 0.0:.6f}" for z in v[:, j]) for j in range(y.size)]
    return "\n".join([f"{TITLE}, {error}, {CAUTION}", LABELS, f"X,Y,{ends},-1.00,{steps},{x.size},{y.size}", *rows, ""])


def _read_map(text: str) -> Plane:
    lines = text.splitlines()
    expect(
        len(lines) > 3 and lines[0].startswith(TITLE[:38]) and lines[1] == LABELS, MAP, "has not the head of version 2"
    )
    facts = lines[2].split(",")
    counts = int(facts[9]), int(facts[10])
    rows = [line.split(",") for line in lines[3:]]
    expect(len(rows) == counts[1] and all(len(r) == counts[0] for r in rows), MAP, "has not the rows that it announces")
    expect(all("." in word for r in rows for word in r), MAP, "holds a point that counts as not probed")
    x, y = (float(a) + float(s) * np.arange(n) for a, s, n in zip(facts[2:6:2], facts[7:9], counts, strict=True))
    return Plane("Z", (facts[0], facts[1]), x, y, np.array(rows, dtype=float).T)
