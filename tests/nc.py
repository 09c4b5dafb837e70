"""An NC program in one text, corrected: what `errpipe correct` does with a file, piece by piece."""

from __future__ import annotations

from typing import Any

import numpy as np

from errpipe.ncprogram.correct import Summary, rewrite
from errpipe.ncprogram.modal import Setup
from errpipe.ncprogram.writer import Deviation

# A tool with its length, lines, arcs in two planes, a relative part, inches, another work offset.
CUTS = """N20 G43 H1
N30 G0 X0 Y0 Z20
N40 G1 Z-2 F200
N50 G1 X80 Y10 F800 (first cut)
N60 G3 X80 Y50 I0 J20
N70 G2 X60 Y70 R20
G91 G1 X-10 Y-5
X-10
G90 G18 G2 X20 Z-2 I-10 K0
G17 G20 G1 X2 Y1 F30
G21 G55 G1 X10 Y10
G49 G0 Z150
M2
"""


def correct(text: str, deviation: Deviation, setup: Setup, **how: Any) -> tuple[str, Summary]:
    """The corrected program and what was done."""
    parts: list[bytes] = []
    done = rewrite([text.encode()], parts.append, deviation, setup, **how)
    return b"".join(parts).decode(), done


def too_long_at_plus_x(points: np.ndarray, tool_length: float) -> np.ndarray:
    """10 um too long at X = 500 of the machine, growing from zero at X = 0."""
    out = np.zeros_like(points)
    out[:, 0] = 0.010 * points[:, 0] / 500.0
    return out


def bent(points: np.ndarray, tool_length: float) -> np.ndarray:
    """A machine with squareness, scale, bow and an angular error that the tool's length magnifies; mm."""
    x, y, z = points.T
    return np.column_stack(
        [4e-5 * x + 3e-5 * y + 2e-5 * tool_length * x / 500, 5e-3 * np.sin(x / 150), -3e-5 * z + 1e-8 * x * y]
    )
