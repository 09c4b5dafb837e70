"""Klipper `printer.cfg` sections: bed mesh, skew and Z thermal adjustment.

Mesh      the bed's height in mm: Z + mesh(x, y), so the correction of Z (minus its deviation), with the plane's mean.
Skew      tangents: x' = x - y*xy - z*(xz - xy*yz), y' = y - z*yz; a tangent is the deviation per length.
Thermal   z' = z - temp_coeff * (T - T_ref): a coefficient is the deviation of Z per kelvin, at most 1 mm/K.
          Homing Z sets T_ref anew; an adjustment waits until it is larger than a step of Z, and for a move in X or Y.
Limits    no direction, no lag; mesh rows are Y ascending, columns X ascending.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from errpipe.domain.table import CompensationTable, Output
from errpipe.errors import GateError
from errpipe.targets import _sample
from errpipe.targets._base import Curve, Line, Plane, ReadBack, Target, expect

FILE = "errpipe.cfg"
MESH = 21  # points along each axis
MIN_EFFECT_UM = 0.05  # a smaller influence is not written
SKEWS = {"xy_skew": ("X", "Y"), "xz_skew": ("X", "Z"), "yz_skew": ("Y", "Z")}


class KlipperSections(Target):
    """Z over the bed, squareness of the axes and Z per kelvin, as sections to include."""

    name = "klipper_sections"
    controller = "Klipper"
    confidence = "verified"
    sign = "a mesh value above zero lifts Z; a skew above zero moves X in minus as Y grows"
    limits = "Z over X and Y, straight squareness, one sensor for Z; no screw errors, no direction, no lag"
    unit = "mm, as everywhere in its configuration"
    holds = ("bed",)
    remark = {"": "# {}"}
    source = "Klipper: docs/Config_Reference.md; klippy/extras bed_mesh, skew_correction, z_thermal_adjust"
    activation = (
        "[include errpipe.cfg]; BED_MESH_PROFILE LOAD=errpipe; SKEW_PROFILE LOAD=errpipe; no fade_end in [bed_mesh] of "
        "printer.cfg, which lets the mesh fade out with height",
        "[z_thermal_adjust] of printer.cfg names the sensor and its limits; SET_Z_THERMAL_ADJUST REF_TEMP=<the file's "
        "reference>: homing Z sets it to the temperature of that moment",
        "G1 to three points and GET_POSITION: toolhead against commanded",
    )

    @classmethod
    def write(cls, table: CompensationTable) -> dict[str, str]:
        axes = _sample.positions_of(table)
        corrected = _sample.outputs_by_axis(table)
        text = ""
        if (bed := _sample.height_map(table, MESH)) is not None:
            text += _mesh(bed)
        text += _skew(table, axes, corrected)
        if "Z" in corrected:
            text += _thermal(table)
        if not text:
            raise GateError("klipper_sections: nothing of the table is a bed, a squareness or a Z drift")
        return {FILE: text}

    @classmethod
    def read_back(cls, files: Mapping[str, str]) -> ReadBack:
        text = files[FILE]
        planes = (_read_mesh(text),) if "[bed_mesh errpipe]" in text else ()
        skews = {k: float(v) for k, v in re.findall(r"(x[yz]_skew|yz_skew) = (\S+)", text)}
        travel = {a: np.array([float(lo), float(hi)]) for a, lo, hi in re.findall(r"# travel (\w+) (\S+) (\S+)", text)}
        expect(all(over in travel for key, (_, over) in SKEWS.items() if skews.get(key)), FILE, "a travel is missing")
        curves = tuple(
            Curve(axis, over, travel[over], *(-skews[key] * travel[over],) * 2)
            for key, (axis, over) in SKEWS.items()
            if skews.get(key)
        )
        lines = tuple(
            Line("Z", sensor, float(reference), -float(coefficient), 0.0)
            for sensor, reference, coefficient in re.findall(
                r"# sensor (.+) reference (\S+)\n\[z_thermal_adjust\]\ntemp_coeff: (\S+)", text
            )
        )
        return ReadBack(curves=curves, planes=planes, lines=lines)


def _mesh(plane: Plane) -> str:
    rows = [", ".join(f"{v + 0.0:.6f}" for v in plane.values[:, j]) for j in range(plane.second.size)]
    facts = {
        "version": 1,
        "min_x": plane.first[0],
        "max_x": plane.first[-1],
        "min_y": plane.second[0],
        "max_y": plane.second[-1],
        "x_count": plane.first.size,
        "y_count": plane.second.size,
        "mesh_x_pps": 0,
        "mesh_y_pps": 0,
        "algo": "lagrange",
        "tension": 0.2,
    }
    lines = ["[bed_mesh errpipe]", *(f"{k} = {v}" for k, v in facts.items()), "points =", *(f"    {r}" for r in rows)]
    return "\n".join(lines) + "\n\n"


def _read_mesh(text: str) -> Plane:
    part = text.split("[bed_mesh errpipe]")[1].split("\n\n")[0]
    facts = dict(re.findall(r"(\w+) = (\S+)", part))
    rows = [[float(v) for v in line.split(",")] for line in part.split("points =\n")[1].splitlines()]
    expect(len(rows) == int(facts["y_count"]), FILE, "the mesh has not y_count rows")
    expect(all(len(r) == int(facts["x_count"]) for r in rows), FILE, "a mesh row has not x_count values")
    x = np.linspace(float(facts["min_x"]), float(facts["max_x"]), int(facts["x_count"]))
    y = np.linspace(float(facts["min_y"]), float(facts["max_y"]), int(facts["y_count"]))
    return Plane("Z", ("X", "Y"), x, y, np.array(rows).T)


def _skew(table: CompensationTable, axes: Mapping[str, str], corrected: Mapping[str, Sequence[Output]]) -> str:
    """Straight part of X over Y, X over Z and Y over Z."""
    skew = {}
    for key, (axis, over) in SKEWS.items():
        if axis in corrected and over in axes and _sample.changes_along(table, axis, over, MIN_EFFECT_UM):
            x = np.linspace(*_sample.span(table, over), 41)
            curve = _sample.curve(table, axis, over, x, relative=True)
            skew[key] = -float(np.polyfit(x, curve.mean, 1)[0])
    if not skew:
        return ""
    # Klipper has no end of a skew; the travel is the validity range of the table, where it is checked.
    ends = {over: _sample.span(table, over) for key, (_, over) in SKEWS.items() if key in skew}
    lines = [f"# travel {over} {low:.6f} {high:.6f}" for over, (low, high) in ends.items()]
    lines += ["[skew_correction errpipe]", *(f"{k} = {skew.get(k, 0.0) + 0.0:.12f}" for k in SKEWS)]
    return "\n".join(lines) + "\n\n"


def _thermal(table: CompensationTable) -> str:
    lines = [_sample.line(table, "Z", sensor) for sensor in _sample.sensors_of(table)]
    lines = [line for line in lines if abs(line.level) * 1e3 >= MIN_EFFECT_UM]
    if not lines:
        return ""
    steepest = max(lines, key=lambda line: abs(line.level))
    expect(abs(steepest.level) <= 1.0, FILE, "more than 1 mm/K")
    return (
        "# the sensor itself (sensor_type, sensor_pin, min_temp, max_temp) is in the same section of printer.cfg\n"
        f"# sensor {steepest.sensor} reference {steepest.reference:.4f}\n"
        f"[z_thermal_adjust]\ntemp_coeff: {-steepest.level:.9f}\nmax_z_adjustment: 1.0\n\n"
    )
