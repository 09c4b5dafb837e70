"""Both programs through LinuxCNC's own interpreter: the machine that runs the corrected one cuts the wanted path."""

import itertools
import math
import re
import shutil
import subprocess

import numpy as np
import pytest

from errpipe.ncprogram.modal import Setup
from tests.nc import CUTS, bent, correct

pytestmark = [
    pytest.mark.toolchain,
    pytest.mark.skipif(shutil.which("rs274") is None, reason="LinuxCNC's interpreter rs274 is not installed"),
]

SETUP = Setup(
    offsets={"G54": (100.0, 50.0, -200.0), "G55": (300.0, 50.0, -200.0)}, tools={1: 80.0}, start=(100.0, 50.0, -200.0)
)
PROGRAM = f"G17 G21 G90 G54 G94\n{CUTS}"
INCH = 25.4


def interpret(program, folder):
    """Path of the controlled point in machine coordinates (with tool length), as vertices (n, 4): x, y, z, tool."""
    variables = {k: 0.0 for base in range(5221, 5401, 20) for k in range(base, base + 10)}
    variables |= dict.fromkeys((5161, 5162, 5163, 5181, 5182, 5183, 5210, 5211, 5212, 5213), 0.0) | {5220: 1.0}
    # Without an INI file the interpreter takes its parameter and tool files to be in inches.
    for n, name in enumerate(("G54", "G55")):
        variables |= {5221 + 20 * n + k: v / INCH for k, v in enumerate(SETUP.offsets[name])}
    (folder / "p.var").write_text("".join(f"{k}\t{v:.9f}\n" for k, v in sorted(variables.items())))
    (folder / "t.tbl").write_text(f"T1 P1 Z{80.0 / INCH:.9f} D0 ;\n")
    (folder / "p.ngc").write_text(program)
    run = subprocess.run(
        ["rs274", "-g", "-v", "p.var", "-t", "t.tbl", "p.ngc"], cwd=folder, capture_output=True, text=True, timeout=60
    )
    assert "PROGRAM_END" in run.stdout, run.stdout + run.stderr
    return canonical(run.stdout)


def canonical(text):
    at, offset, tool, unit, plane = np.zeros(3), np.zeros(3), 0.0, 1.0, "XY"
    out = []
    for name, arguments in re.findall(r"N[\d.]+ *([A-Z_0-9]+)\((.*)\)", text):
        value = [] if name == "COMMENT" else re.findall(r"-?\d+\.\d+|-?\d+(?=[,)]|$)", arguments)
        values = [float(v) for v in value]
        if name == "USE_LENGTH_UNITS":
            unit = INCH if "INCH" in arguments else 1.0
        elif name == "SELECT_PLANE":
            plane = arguments[-2:]
        elif name == "SET_G5X_OFFSET":
            offset = np.array(values[1:4]) * unit
        elif name == "USE_TOOL_LENGTH_OFFSET":
            tool = values[2] * unit
        elif name in ("STRAIGHT_FEED", "STRAIGHT_TRAVERSE"):
            at = np.array(values[:3]) * unit
            out.append([*(at + offset + [0, 0, tool]), tool])
        elif name == "ARC_FEED":
            for point in arc(at, values, plane, unit):
                out.append([*(point + offset + [0, 0, tool]), tool])
            at = point
    return np.array(out)


def arc(start, values, plane, unit):
    first, second = {"XY": (0, 1), "XZ": (2, 0), "YZ": (1, 2)}[plane]
    end = np.array(values[:2]) * unit
    centre, turns = np.array(values[2:4]) * unit, values[4]
    a = math.atan2(start[second] - centre[1], start[first] - centre[0])
    b = math.atan2(end[1] - centre[1], end[0] - centre[0])
    sweep = (b - a) % (2 * math.pi) if turns > 0 else -((a - b) % (2 * math.pi))
    radius = math.hypot(*(end - centre))
    for angle in a + np.linspace(0, sweep, 400)[1:]:
        point = start.copy()
        point[first], point[second] = centre + radius * np.array([math.cos(angle), math.sin(angle)])
        yield point


def distance_to_path(points, path):
    """Distance of each point to the polyline `path`, mm."""
    best = np.full(len(points), np.inf)
    for a, b in itertools.pairwise(path):
        along = b - a
        length = float(along @ along)
        share = np.clip((points - a) @ along / length, 0, 1) if length else np.zeros(len(points))
        best = np.minimum(best, np.linalg.norm(points - a - share[:, None] * along, axis=1))
    return best


def test_the_corrected_program_cuts_the_wanted_path(tmp_path):
    text, summary = correct(PROGRAM, bent, SETUP, chord_error=0.0005, longest=8.0)
    wanted, commanded = interpret(PROGRAM, tmp_path), interpret(text, tmp_path)
    actual = commanded[:, :3] + np.array([bent(p[None, :3], p[3])[0] for p in commanded])
    left = distance_to_path(actual, wanted[:, :3])
    uncorrected = wanted[:, :3] + np.array([bent(p[None, :3], p[3])[0] for p in wanted])
    before = np.linalg.norm(uncorrected - wanted[:, :3], axis=1)
    assert before.max() > 0.015
    # The interpreter prints 0.1 um in mm and 2.5 um in inches; half of that each way is all that may be left.
    assert np.median(left) < 1.5e-4
    assert left.max() < 2.5e-3
    assert actual[-1] == pytest.approx(wanted[-1, :3], abs=2.5e-4)
    assert summary.largest_chord_error <= 0.0005
