"""A simulated lathe that gives way to the cutting force: push tests on it, and parts turned on it.

Its truth uses no beam elements: bending and shear of the stepped workpiece are integrated (unit load), the spindle is a
rigid body on springs, the tool a cantilever in closed form.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from errpipe.domain.recording import Column, Constant, Manifest, Recording

YOUNG, POISSON = 210e3, 0.3  # N/mm2, 1
POST = 0.012  # um/N: tool post
SPINDLE, TILT = 0.008, 0.9  # um/N at the chuck's face, um/N per m2 of lever
MANDREL = ((220.0, 70.0),)  # (length, diameter) mm: stiff, for the push tests
WORK = ((60.0, 45.0), (120.0, 39.4))  # the part that is cut
TOOL = (45.0, 25.0, 25.0)  # overhang, width, height, mm


def shaft(sections: tuple[tuple[float, float], ...], at: float, steps: int = 20000) -> float:
    """Deflection per force at a place of a stepped cantilever, um/N: moment and shear integrated."""
    x = (np.arange(steps) + 0.5) * at / steps
    ends = np.cumsum([length for length, _ in sections])
    diameter = np.array([d for _, d in sections])[np.minimum(np.searchsorted(ends, x), len(sections) - 1)]
    inertia, area = np.pi * diameter**4 / 64, np.pi * diameter**2 / 4
    factor = 6 * (1 + POISSON) / (7 + 6 * POISSON)
    shear = factor * YOUNG / (2 * (1 + POISSON)) * area
    return float(np.sum((at - x) ** 2 / (YOUNG * inertia) + 1 / shear) * at / steps * 1e3)


def tool() -> float:
    """The tool's own, um/N."""
    overhang, width, height = TOOL
    area, factor = width * height, 10 * (1 + POISSON) / (12 + 11 * POISSON)
    bend = overhang**3 / (3 * YOUNG * width * height**3 / 12)
    return (bend + overhang / (factor * YOUNG / (2 * (1 + POISSON)) * area)) * 1e3


def gives(at: float, sections: tuple[tuple[float, float], ...]) -> float:
    """Tool against workpiece at a distance from the chuck, um/N."""
    return POST + SPINDLE + TILT * (at * 1e-3) ** 2 + shaft(sections, at) + tool()


def push_tests(seed: int = 1, noise: float = 0.15) -> Recording:
    """Six places on the mandrel, 0 to 500 N and back; deviation between tool and work, um."""
    rng = np.random.default_rng(seed)
    force = np.r_[np.arange(0, 501, 100), np.arange(400, -1, -100)].astype(float)
    rows = []
    for place in (20.0, 60.0, 100.0, 140.0, 180.0, 210.0):
        zero = rng.normal(0, 3.0)
        read = force * gives(place, MANDREL) + zero + rng.normal(0, noise, len(force))
        rows.append(pd.DataFrame({"run": f"Z{place:g}", "Z": place, "F": force, "E_X": read}))
    columns = {
        "run": Column(role="run"),
        "Z": Column(role="position", axis="Z", unit="mm"),
        "F": Column(role="force", unit="N"),
        "E_X": Column(role="error", component="E_X", unit="um"),
    }
    constants = {"Z": Constant(role="axis", kind="linear", travel=(0.0, 220.0), unit="mm")}
    manifest = Manifest(
        recording=1,
        title="static push tests on a simulated lathe",
        machine="simulated lathe",
        tables=("recording.csv",),
        constants=constants,
        columns=columns,
    )
    return Recording(manifest, pd.concat(rows, ignore_index=True))
