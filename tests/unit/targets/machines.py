"""Small tables whose right answer is known by hand; shared by the tests of targets and runtimes."""

import numpy as np

from errpipe import tables
from errpipe.domain import driver as d
from errpipe.domain.table import TableInput
from errpipe.drivers.lowered import Lowered

AXES = {"X": (0.0, 500.0), "Y": (0.0, 400.0), "Z": (-300.0, 0.0)}
INPUTS = [
    *(
        TableInput(name=a.lower(), kind="position", axis=a, low=lo - 50, high=hi + 50, default=lo)
        for a, (lo, hi) in AXES.items()
    ),
    TableInput(name="T", kind="sensor", unit="degC", low=-40, high=100, default=20, valid=(15, 30), margin=5),
]


def compile_(*components):
    return tables.compile_table(
        [tables.ComponentSource(name, "um", tuple(pairs)) for name, pairs in components],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )


def straight(axis, um, span=500.0, driver=d.ONE):
    """Deviation growing in a straight line to `um` at `span` mm."""
    return Lowered(driver, axis, lambda x: um * x / span)


def too_long_at_plus_x():
    """10 um too long at X = +500, nothing at X = 0: deviation +0.010 mm, correction -0.010 mm."""
    return compile_(("EXX", [straight("X", 10.0)]))


def wavy_both_directions():
    """A lead error with a wave, and 6 um of lost motion."""
    wave = Lowered(d.ONE, "X", lambda x: 12.0 * np.sin(x / 60.0) * x / 500.0)
    gap = Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -3.0))
    return compile_(("EXX", [straight("X", 10.0), wave, gap]))


def too_long_from_above():
    """Approached from below X is right; approached from above it is 10 um too long: 10 um of lost motion."""
    return compile_(
        (
            "EXX",
            [
                Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -5.0)),
                Lowered(d.ONE, None, lambda x: np.full(np.shape(x), 5.0)),
            ],
        )
    )


def long_with_lost_motion():
    """10 um too long at X = +500, and 6 um of lost motion."""
    gap = Lowered(d.Direction(axis="X"), None, lambda x: np.full(np.shape(x), -3.0))
    return compile_(("EXX", [straight("X", 10.0), gap]))


def sample(target):
    """A table of which a format can say something."""
    if {"screw", "cross", "bed"} & set(target.holds):
        return bent()
    return warm() if "temperature" in target.holds else too_long_from_above()


def bent():
    """Y over X (straightness), X over Y (squareness) and Z over X and Y (a bed)."""
    # A positive C0Y leans Y towards minus X: the tool is pushed by -C0Y * y.
    lean = tables.MonomialSource(-1e-3, "C0Y", (d.Input(name="y"),))
    return tables.compile_table(
        [
            tables.ComponentSource("EXX", "um", (straight("X", 10.0),)),
            tables.ComponentSource("EYX", "um", (Lowered(d.ONE, "X", lambda x: 8.0 * np.sin(np.pi * x / 500.0)),)),
            tables.ComponentSource("C0Y", "urad", (Lowered(d.Constant(value=25.0)),)),
            tables.ComponentSource("EZX", "um", (Lowered(d.ONE, "X", lambda x: 20.0 * (x / 500.0) ** 2),)),
        ],
        outputs=[
            tables.OutputSource("X", (tables.MonomialSource(1.0, "EXX"), lean), "X"),
            tables.OutputSource("Y", (tables.MonomialSource(1.0, "EYX"),), "Y"),
            tables.OutputSource("Z", (tables.MonomialSource(1.0, "EZX"),), "Z"),
        ],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )


def warm():
    """The scale grows 11 um/m/K over 20 degC, and Z drifts 2 um/K."""
    return tables.compile_table(
        [
            tables.ComponentSource("EXX", "um", (straight("X", 5.5, driver=d.above("T", 20.0)),)),
            tables.ComponentSource("EZZ", "um", (Lowered(d.Affine(weights=(2.0,), of=(d.above("T", 20.0),))),)),
        ],
        outputs=[
            tables.OutputSource("X", (tables.MonomialSource(1.0, "EXX"),), "X"),
            tables.OutputSource("Z", (tables.MonomialSource(1.0, "EZZ"),), "Z"),
        ],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )


def tilting():
    """X tilts along its way: EBX grows with x, the tool at height z is pushed by EBX(x) * z; a lead error besides.

    At X = 500, Z = -300: EBX = 40 urad there, -12 um; the sign of the lever is +1e-3 mm/m here.
    """
    lever = tables.MonomialSource(1e-3, "EBX", (d.Input(name="z"),))
    tilt = Lowered(d.ONE, "X", lambda x: 40.0 * np.sin(np.pi * x / 1000.0))
    return tables.compile_table(
        [tables.ComponentSource("EXX", "um", (straight("X", 10.0),)), tables.ComponentSource("EBX", "urad", (tilt,))],
        outputs=[tables.OutputSource("X", (tables.MonomialSource(1.0, "EXX"), lever), "X")],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )


def two_outputs():
    """X is moved by two outputs, 10 um and 4 um too long at X = +500: together 14 um."""
    return tables.compile_table(
        [
            tables.ComponentSource("EXX", "um", (straight("X", 10.0),)),
            tables.ComponentSource("EXT", "um", (straight("X", 4.0),)),
        ],
        outputs=[
            tables.OutputSource("X", (tables.MonomialSource(1.0, "EXX"),), "X"),
            tables.OutputSource("X warm", (tables.MonomialSource(1.0, "EXT"),), "X"),
        ],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )


def too_far(axis, driver=d.ONE):
    """`axis` goes 10 um too far in plus at X = +500 (in a driver's state), nothing at X = 0; Z bows over Y besides."""
    pairs = [straight("X", 10.0, driver=driver)]
    if axis == "Z":
        pairs.append(Lowered(d.ONE, "Y", lambda y: 2.0 * np.sin(np.pi * y / 400.0)))
    return tables.compile_table(
        [tables.ComponentSource(f"E{axis}X", "um", tuple(pairs))],
        outputs=[tables.OutputSource(axis, (tables.MonomialSource(1.0, f"E{axis}X"),), axis)],
        inputs=INPUTS,
        travel=AXES,
        error_bound=0.002,
        machine="test",
    )
