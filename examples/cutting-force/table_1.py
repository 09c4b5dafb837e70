"""Table 1 of Ni (1997) made again: what its printed diameters say, and its cuts turned on a simulated lathe.

python examples/cutting-force/table_1.py

The reductions come from the printed diameters. The cuts are simulated from the printed speeds, feeds and depths; length
and stiffness of workpiece and machine and the specific force are not in the paper. The lathe is that of `lathe.py`, the
specific radial force is chosen so that Type I shows its printed 33.0 um without compensation; nothing else is chosen.
The cutting parameters of Type III are not printed: it is turned at the feed of Type II and that constant depth at which
it shows its printed 27.9 um, so only its last column says something. No public recording of cutting force against part
size was found: this is a simulation until someone brings one.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import lathe

PRINTED = {  # mm, of D1, D2, D3: without compensation, then tests 1 to 3
    "I": (
        (39.3700, 39.3571, 39.3370),
        (39.3751, 39.3725, 39.3776),
        (39.3751, 39.3725, 39.3751),
        (39.3725, 39.3700, 39.3675),
    ),
    "II": (
        (38.8087, 38.8010, 38.7858),
        (38.8214, 38.8239, 38.8239),
        (38.8239, 38.8264, 38.8290),
        (38.8188, 38.8239, 38.8239),
    ),
    "III": (
        (39.3217, 39.3192, 39.2938),
        (39.3243, 39.3294, 39.3344),
        (39.3294, 39.3294, 39.3268),
        (39.3243, 39.3294, 39.3217),
    ),
}
TEXT = {"I": 85, "II": 78, "III": 67}
CUTS = {"I": (750.0, 190.5, (1.27, 1.27, 1.27)), "II": (750.0, 127.0, (1.524, 0.889, 0.254))}  # rpm, mm/min, depth mm
ASSUMED = "III"
PLACES = np.array([170.0, 120.0, 70.0])  # mm from the chuck: D1, D2, D3 (assumed)
NOISE = 0.02  # of the force reading


def spread(diameters) -> float:
    """Largest less smallest diameter, um."""
    return 1e3 * float(np.ptp(diameters))


def reduction(kind: str) -> float:
    """Per cent by which the worst of three tests is better than without compensation, from the printed diameters."""
    bare, *tests = PRINTED[kind]
    return 100 * (1 - max(map(spread, tests)) / spread(bare))


def forces(kind: str, specific: float) -> np.ndarray:
    """Radial force at D1 to D3: specific force x depth x feed per turn, N."""
    speed, feed, depths = CUTS[kind] if kind in CUTS else assumed_cut()
    return specific * np.array(depths) * feed / speed


def assumed_cut() -> tuple[float, float, tuple[float, ...]]:
    """Speed and feed of Type II; the depth that takes Type I's spread to the printed one of Type III."""
    (_, feed_1, depths), (speed, feed, _) = CUTS["I"], CUTS["II"]
    depth = depths[0] * feed_1 / feed * spread(PRINTED[ASSUMED][0]) / spread(PRINTED["I"][0])
    return speed, feed, (depth, depth, depth)


def specific_force() -> float:
    """N/mm2, from Type I without compensation: radius grows by force x compliance."""
    gives = np.array([lathe.gives(z, lathe.WORK) for z in PLACES])
    return spread(PRINTED["I"][0]) / (2 * float(np.ptp(forces("I", 1.0) * gives)))


def turned(kind: str, table, specific: float, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Deviations of D1 to D3 without and with the table, um: twice the radius."""
    from errpipe.tables import batch

    force = forces(kind, specific)
    true = force * np.array([lathe.gives(z, lathe.WORK) for z in PLACES])
    read = force * (1 + np.random.default_rng(seed).normal(0, NOISE, force.size))
    said = [batch.position(table, np.array([[z]]), ("Z",), {"F": f})[0, 0] for z, f in zip(PLACES, read, strict=True)]
    return 2 * true, 2 * (true - np.array(said))


def exported(folder: Path):
    """The table of the pipeline beside this file."""
    from errpipe.cli.app import main
    from errpipe.tables import ect

    pipeline = Path(__file__).with_name("pipeline.yaml")
    if main(["run", str(pipeline), "--out", str(folder), "--to", "export"]) != 0:
        raise SystemExit("the pipeline did not export a table")
    return ect.read(folder / "export" / "table.ect")


def main() -> None:
    """Print both."""
    print("type  reduction from the printed diameters, %   the text says, %")
    for kind in PRINTED:
        print(f"{kind:4}  {reduction(kind):.1f}   {TEXT[kind]}")
    with tempfile.TemporaryDirectory() as folder:
        table = exported(Path(folder))
    specific = specific_force()
    print(f"\nsimulated, specific radial force {specific:.0f} N/mm2 (from Type I); spread of D1 to D3, um")
    print("type  force, N  printed without  simulated without  simulated with")
    for kind in PRINTED:
        before, after = turned(kind, table, specific)
        force = forces(kind, specific)
        span = f"{force.min():.0f}..{force.max():.0f}"
        print(f"{kind:4}  {span}  {spread(PRINTED[kind][0]):.1f}  {np.ptp(before):.1f}  {np.ptp(after):.1f}")
    print(f"{ASSUMED}: cut assumed, {assumed_cut()[2][0]:.2f} mm deep at the feed of Type II; the paper prints none")


if __name__ == "__main__":
    main()
