"""Every indirect protocol on a machine: the poses, tools, sockets and circles that a measuring team would use.

Each builder takes a chain and returns the runs that `metrology.record` simulates. Shares are of the travel.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from errpipe.errors import DataError
from errpipe.kinematics.chain import Chain, combinations
from errpipe.simulation import metrology
from errpipe.simulation.metrology import Run

# Length and offset in mm: rotations show only at different tools.
TOOLS = ((80.0, (0.0, 0.0, 0.0)), (200.0, (0.0, 0.0, 0.0)), (120.0, (60.0, 40.0, 0.0)))
POINTS = 150  # of a point cloud, each seen with three tools
MIN_POSES = 8  # within reach; a rotary test with fewer is omitted


def _linear(chain: Chain) -> list[int]:
    if len(chain.linear) != 3:
        raise DataError(f"this test needs three linear axes ({chain.machine.name} has {len(chain.linear)})")
    return chain.linear


def fractions(chain: Chain, *shares: float | np.ndarray) -> np.ndarray:
    """Poses at shares of the travel of the linear axes, (n, axes); arrays make a lattice; rotary in the middle."""
    low, high = chain.travel.T
    every: list[float | np.ndarray] = [0.5] * len(chain.axes)
    for i, share in zip(_linear(chain), shares, strict=True):
        every[i] = share
    grids = [lo + np.atleast_1d(s) * (hi - lo) for lo, hi, s in zip(low, high, every, strict=True)]
    return combinations(grids)


def scattered(chain: Chain, count: int, seed: int = 1) -> np.ndarray:
    """Poses over the whole volume, no two with equal coordinates: a lattice does not test between its points."""
    rng = np.random.default_rng(seed)
    low, high = chain.travel.T
    columns = [(rng.permutation(count) + 0.5) / count for _ in chain.axes]
    return low + np.column_stack(columns) * (high - low)


def circles(chain: Chain) -> list[Run]:
    """ISO 230-4: three planes, both senses, two tools, two centres."""
    low, high = chain.travel.T
    runs = []
    for share, length in ((0.4, 80.0), (0.6, 200.0)):
        radius = 0.3 * float((high - low)[_linear(chain)].min())
        runs += metrology.circles(chain, low + share * (high - low), radius, length, 48, f"{share:g} ")
    return runs


def telescoping(chain: Chain) -> list[Run]:
    """A telescoping bar from four sockets, with three tools."""
    return _from_sockets(chain, 100, 0.35)


def multilateration(chain: Chain) -> list[Run]:
    """Ranges from four stations well outside, with three tools."""
    return _from_sockets(chain, 150, 1.0)


def _from_sockets(chain: Chain, count: int, spread: float) -> list[Run]:
    q = scattered(chain, count)
    return [
        Run(f"{i} {length:g}", q, length, offset, socket=socket)
        for i, socket in enumerate(metrology.sockets(chain, spread))
        for length, offset in TOOLS
    ]


def cloud(chain: Chain, points: int = POINTS, seed: int = 1) -> list[Run]:
    """Points over the volume with three tools, as a tracker gives them."""
    q = scattered(chain, points, seed)
    return [Run(f"tool {i}", q, length, offset) for i, (length, offset) in enumerate(TOOLS)]


def diagonals(chain: Chain) -> list[Run]:
    """ISO 230-6: the four body diagonals."""
    _linear(chain)
    return metrology.diagonals(chain, 120.0)


def step_diagonals(chain: Chain) -> list[Run]:
    """The four body diagonals, one axis after the other at each step."""
    _linear(chain)
    return metrology.diagonals(chain, 120.0, step_diagonal=True)


def ball_plate(chain: Chain) -> list[Run]:
    """A plate of 9 by 9 balls in six places, with three styli."""
    spread, runs = np.linspace(0.02, 0.98, 9), []
    for share in (0.15, 0.85):
        for name, shares in (
            ("xy", (spread, spread, share)),
            ("xz", (spread, share, spread)),
            ("yz", (share, spread, spread)),
        ):
            for i, (length, offset) in enumerate(TOOLS):
                runs.append(Run(f"{name} {share:g} {i}", fractions(chain, *shares), length, offset))
    return runs


def ball_array(chain: Chain) -> list[Run]:
    """A row of balls along each axis at four places, with three styli."""
    along, runs = np.linspace(0.03, 0.97, 12), []
    for axis in range(3):
        for k, pair in enumerate(((0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9))):
            shares: list[float | np.ndarray] = list(pair)
            shares.insert(axis, along)
            for i, (length, offset) in enumerate(TOOLS):
                runs.append(Run(f"{axis} {k} {i}", fractions(chain, *shares), length, offset))
    return runs


def hole_pattern(chain: Chain) -> list[Run]:
    """Holes in one plane, 14 by 12."""
    q = fractions(chain, np.linspace(0.02, 0.98, 14), np.linspace(0.02, 0.98, 12), 0.4)
    return [Run("plate", q, 100.0)]


def part(chain: Chain) -> list[Run]:
    """A stepped block: bores in three steps, faces between them; `metrology.record` reads what each feature has."""
    spread = np.linspace(0.08, 0.92, 6)
    steps = [fractions(chain, spread, spread, share) for share in (0.2, 0.5, 0.8)]
    return [Run("part", np.concatenate(steps), 120.0)]


def table_poses(chain: Chain, ball: np.ndarray, length: float, count: int, seed: int) -> np.ndarray:
    """Rotary axes through their travel, the linear ones following a ball on the table; only poses within reach.

    Raises DataError for a machine without rotary axes, or one that cannot follow the ball.
    """
    rng = np.random.default_rng(seed)
    low, high = chain.travel.T
    rotary = [i for i in range(len(chain.axes)) if chain.axis_unit(chain.axes[i]) == "deg"]
    if not rotary:
        raise DataError(f"a test of rotary axes needs one ({chain.machine.name} has none)")
    _linear(chain)
    q = np.tile((low + high) / 2, (count * 4, 1))
    q[:, rotary] = rng.uniform(low[rotary], high[rotary], (len(q), len(rotary)))
    one = count * 2
    q[:one, rotary[0]] = np.where(np.arange(one) % 2, q[:one, rotary[0]], 0.0)
    q = metrology.follow(chain, q, ball, length)
    inside = ((q >= low) & (q <= high)).all(axis=1)
    if inside.sum() < MIN_POSES:
        place = ", ".join(f"{v:g}" for v in ball)
        raise DataError(f"{chain.machine.name} cannot follow a ball at {place} mm while its rotary axes turn")
    return q[inside][:count]


def r_test(chain: Chain) -> list[Run]:
    """ISO 230-7: the ball at four places and heights on the table, two tool lengths."""
    runs = []
    for k, ball in enumerate(((90.0, 0, 60), (-60, 80, 60), (40, -90, 120), (0, 0, 140))):
        for length in (120.0, 190.0):
            q = table_poses(chain, np.array(ball, dtype=float), length, 70, k)
            runs.append(Run(f"ball {k} {length:g}", q, length))
    return runs


def rotary_ballbar(chain: Chain) -> list[Run]:
    """ISO 230-7: a bar from a socket on the table to the spindle, the ball 100 mm away in three directions."""
    runs = []
    for k, (ball, socket) in enumerate(
        (
            ((90.0, 0, 60), (90.0, 0, -40)),
            ((90.0, 0, 60), (190.0, 0, 60)),
            ((-60.0, 80, 60), (-60.0, 180, 60)),
            ((40.0, -90, 120), (140.0, -90, 120)),
            ((40.0, -90, 120), (40.0, -90, 20)),
            ((0.0, 0, 140), (0.0, 100, 140)),
        )
    ):
        for length in (120.0, 190.0):
            q = table_poses(chain, np.array(ball), length, 70, k)
            runs.append(Run(f"bar {k} {length:g}", q, length, socket=np.array(socket)))
    return runs


PROTOCOLS: dict[str, Callable[[Chain], list[Run]]] = {
    "ballbar_circle": circles,
    "telescoping_bar": telescoping,
    "multilateration": multilateration,
    "point_cloud": cloud,
    "diagonal": diagonals,
    "step_diagonal": step_diagonals,
    "ball_plate": ball_plate,
    "ball_array": ball_array,
    "hole_pattern": hole_pattern,
    "part": part,
    "r_test": r_test,
    "rotary_ballbar": rotary_ballbar,
}
