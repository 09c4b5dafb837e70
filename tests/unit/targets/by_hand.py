"""Machines whose screw files are read by the words of their manuals alone, and the formats that are read so."""

from __future__ import annotations

import functools

import numpy as np

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered
from errpipe.targets import TARGETS
from tests.unit.targets import manual_readers

PLACES = 23
# Formats of one curve over an axis' own position, or of its reversal; the others are read in test_targets.
READ = [t for t in TARGETS if hasattr(manual_readers, t.name)]


def of(*axes, **more):
    """A table of axes (letter, low, high, mean deviation, half of what it is more on the way up), um or 1e-6 rad."""
    parts, outputs, inputs = [], [], []
    for letter, low, high, mean, half in axes:
        unit = "urad" if letter in "ABC" else "um"
        pairs = (Lowered(d.ONE, letter, mean), Lowered(d.Direction(axis=letter), letter, half))
        parts.append(tables.ComponentSource(f"E{letter}{letter}", unit, pairs))
        inputs.append(
            TableInput(name=letter.lower(), kind="position", axis=letter, low=low - 50, high=high + 50, default=low)
        )
    outputs = tables.outputs_of(parts)
    travel = {letter: (low, high) for letter, low, high, _, _ in axes}
    return tables.compile_table(parts, outputs=outputs, inputs=inputs, travel=travel, error_bound=0.01, **more)


def even(value):
    return lambda x: np.full(np.shape(x), float(value))


LONG = ("X", 0.0, 500.0, lambda x: 10.0 * x / 500.0, even(-2))  # 10 um too long at +X, 4 um of lost motion
MACHINES = {
    "too long at +X": [LONG],
    "travel -300 to 0": [("Z", -300.0, 0.0, lambda z: 10.0 * (z + 300.0) / 300.0, even(-2))],
    "short, wavy, travel -700 to -9.5": [("Y", -700.0, -9.5, lambda y: 8.0 * np.sin(y / 70) - 0.02 * y, even(-1))],
    "travel 5000 to 5400": [("X", 5000.0, 5400.0, lambda x: 0.05 * (x - 5000.0), even(-2))],
    "reversal grows over the travel": [("X", -200.0, 300.0, lambda x: 10 * np.sin(x / 70), lambda x: -3 - x / 200)],
    "three axes": [
        LONG,
        ("Y", -200.0, 200.0, lambda y: 3.0 - 0.05 * y, even(-1)),
        ("Z", -400.0, -20.0, lambda z: 0.03 * z, even(-3)),
    ],
    "rotary axis 0 to 360": [("C", 0.0, 360.0, lambda c: 500.0 * np.sin(np.deg2rad(c)), even(-100))],
    "a rotary axis that turns on, and X": [
        ("A", -90.0, 270.0, lambda a: 300.0 * np.sin(np.deg2rad(a)), even(-40)),
        LONG,
    ],
    "tilting axis -120 to 30": [("A", -120.0, 30.0, lambda a: 400.0 * (a + 120.0) / 150.0, even(-50))],
}


@functools.cache
def table_of(machine):
    """The table of a machine: the same for every format."""
    return of(*MACHINES[machine])


@functools.cache
def turning(low, high):
    """The table of a rotary axis that turns on; its curve ends 180e-6 rad from where it began."""
    curve = lambda c: 500.0 * np.sin(np.deg2rad(c)) + 180.0 * (c - low) / 360.0  # noqa: E731
    return of(("C", low, high, curve, even(-100)), turning=("C",))


LINEAR = {"haas_pitch", "marlin_gcode", "mitsubishi_pitch", "reprap_heightmap", "smoothie_pitch"}  # no rotary axis


TURNS = {"0 to 360": (0.0, 360.0), "-180 to 180": (-180.0, 180.0), "0 to 330 of a turn": (0.0, 330.0)}


REPEAT = {
    "beckhoff_ssfk",
    "fagor_lscrw",
    "fanuc_pitch",
    "heidenhain_com",
    "pmac_comp",
    "sinumerik_cec",
    "sinumerik_lec",
    "twincat_nc_table",
}


def only_y():
    """The table reads X and Y and moves Y alone."""
    bow = Lowered(d.ONE, "X", lambda x: 4.0 * np.sin(np.pi * x / 500.0))
    own = (Lowered(d.ONE, "Y", lambda y: 0.02 * y), Lowered(d.Direction(axis="Y"), None, even(-3)))
    inputs = [TableInput(name=a.lower(), kind="position", axis=a, low=-50, high=550, default=0) for a in ("X", "Y")]
    sources = [tables.ComponentSource("EYX", "um", (bow,)), tables.ComponentSource("EYY", "um", own)]
    return tables.compile_table(sources, inputs=inputs, travel=dict.fromkeys("XY", (0, 500)))
