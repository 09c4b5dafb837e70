"""Every protocol on a ready machine, as a list of runs: what the tests identify from."""

from __future__ import annotations

import numpy as np

from errpipe.kinematics import synthesis
from errpipe.simulation import metrology as m

TOOLS = ((80.0, (0.0, 0.0, 0.0)), (200.0, (0.0, 0.0, 0.0)), (120.0, (60.0, 40.0, 0.0)))


def _fractions(chain, *shares):
    """Poses at shares of the travel, one per axis; arrays are spread as a lattice."""
    low, high = chain.travel.T
    grids = [lo + np.atleast_1d(s) * (hi - lo) for lo, hi, s in zip(low, high, shares, strict=True)]
    return np.stack([g.ravel() for g in np.meshgrid(*grids, indexing="ij")], axis=1)


def _scattered(chain, count, seed=1):
    """Poses over the whole volume, no two at one coordinate: a lattice leaves open what lies between."""
    rng = np.random.default_rng(seed)
    low, high = chain.travel.T
    columns = [(rng.permutation(count) + 0.5) / count for _ in chain.axes]
    return low + np.column_stack(columns) * (high - low)


def circles(chain):
    """ISO 230-4: three planes, both senses, two tools, two centres."""
    low, high = chain.travel.T
    runs = []
    for share, length in ((0.4, 80.0), (0.6, 200.0)):
        radius = 0.3 * float((high - low).min())
        runs += m.circles(chain, low + share * (high - low), radius, length, 48, f"{share:g} ")
    return "ballbar_circle", runs


def telescoping(chain):
    q = _scattered(chain, 100)
    return "telescoping_bar", [
        m.Run(f"{i} {length:g}", q, length, offset, socket=socket)
        for i, socket in enumerate(m.sockets(chain)) for length, offset in TOOLS
    ]  # fmt: skip


def multilateration(chain):
    q = _scattered(chain, 150)
    return "multilateration", [
        m.Run(f"{i} {length:g}", q, length, offset, socket=socket)
        for i, socket in enumerate(m.sockets(chain, 1.0)) for length, offset in TOOLS
    ]  # fmt: skip


def cloud(chain):
    q = _scattered(chain, 150)
    return "point_cloud", [m.Run(f"tool {i}", q, length, offset) for i, (length, offset) in enumerate(TOOLS)]


def diagonals(chain):
    return "diagonal", m.diagonals(chain, 120.0)


def step_diagonals(chain):
    return "step_diagonal", m.diagonals(chain, 120.0, step_diagonal=True)


def ball_plate(chain):
    spread, runs = np.linspace(0.02, 0.98, 9), []
    for share in (0.15, 0.85):
        for name, shares in (
            ("xy", (spread, spread, share)),
            ("xz", (spread, share, spread)),
            ("yz", (share, spread, spread)),
        ):
            for i, (length, offset) in enumerate(TOOLS):
                runs.append(m.Run(f"{name} {share:g} {i}", _fractions(chain, *shares), length, offset))
    return "ball_plate", runs


def ball_array(chain):
    """A row of balls along each axis at four places, with three styli."""
    along, runs = np.linspace(0.03, 0.97, 12), []
    for axis in range(3):
        for k, pair in enumerate(((0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9))):
            shares = list(pair)
            shares.insert(axis, along)
            for i, (length, offset) in enumerate(TOOLS):
                runs.append(m.Run(f"{axis} {k} {i}", _fractions(chain, *shares), length, offset))
    return "ball_array", runs


def hole_pattern(chain):
    q = _fractions(chain, np.linspace(0.02, 0.98, 14), np.linspace(0.02, 0.98, 12), 0.4)
    return "hole_pattern", [m.Run("plate", q, 100.0)]


THREE_AXES = (
    circles,
    telescoping,
    multilateration,
    cloud,
    diagonals,
    step_diagonals,
    ball_plate,
    ball_array,
    hole_pattern,
)


def _table_poses(chain, ball, length, count=60, seed=2):
    """Rotary axes through their travel, the linear ones following a ball on the table; poses in reach only."""
    rng = np.random.default_rng(seed)
    low, high = chain.travel.T
    q = np.tile((low + high) / 2, (count * 4, 1))
    rotary = [i for i, a in enumerate(chain.axes) if chain.machine.axes[a].kind == "rotary"]
    q[:, rotary] = rng.uniform(low[rotary], high[rotary], (len(q), len(rotary)))
    one = count * 2
    q[:one, rotary[0]] = np.where(np.arange(one) % 2, q[:one, rotary[0]], 0.0)
    q = m.follow(chain, q, ball, length)
    inside = ((q >= low) & (q <= high)).all(axis=1)
    return q[inside][:count]


def r_test(chain):
    """ISO 230-7: the ball at four places and heights on the table, two tool lengths."""
    runs = []
    for k, ball in enumerate(((90.0, 0, 60), (-60, 80, 60), (40, -90, 120), (0, 0, 140))):
        for length in (120.0, 190.0):
            q = _table_poses(chain, np.array(ball, dtype=float), length, 70, k)
            runs.append(m.Run(f"ball {k} {length:g}", q, length))
    return "r_test", runs


def rotary_ballbar(chain):
    """ISO 230-7: a bar from a socket on the table to the spindle, the ball 100 mm away in three directions."""
    runs = []
    for k, (ball, socket) in enumerate((
        ((90.0, 0, 60), (90.0, 0, -40)), ((90.0, 0, 60), (190.0, 0, 60)), ((-60.0, 80, 60), (-60.0, 180, 60)),
        ((40.0, -90, 120), (140.0, -90, 120)), ((40.0, -90, 120), (40.0, -90, 20)), ((0.0, 0, 140), (0.0, 100, 140)),
    )):  # fmt: skip
        for length in (120.0, 190.0):
            q = _table_poses(chain, np.array(ball), length, 70, k)
            runs.append(m.Run(f"bar {k} {length:g}", q, length, socket=np.array(socket)))
    return "rotary_ballbar", runs


FIVE_AXES = (r_test, rotary_ballbar)


def unseen_places(protocol, chain, runs, count=60, seed=99):
    """Places the test did not measure but is asked about: between its poses, same tool."""
    rng = np.random.default_rng(seed)
    if protocol in ("r_test", "rotary_ballbar"):
        return _table_poses(chain, np.array([30.0, 50.0, 90.0]), 150.0, count, 77), chain.tip(150.0)
    low, high = chain.travel.T
    q = rng.uniform(low + 0.02 * (high - low), high - 0.02 * (high - low), (count, len(chain.axes)))
    if protocol == "hole_pattern":
        q[:, 2] = runs[0].q[0, 2]
    return q, chain.tip(runs[0].length if protocol == "hole_pattern" else 120.0)


def rigid_free(chain, q, tip):
    """Projector (3 n, 3 n) that takes the best rigid motion out of a field of deviations."""
    p = synthesis.ideal_pose(chain, q, tip)[:, 0]
    p = (p - p.mean(axis=0)) * 1e-3
    rows = np.zeros((len(p), 3, 6))
    rows[:, :, :3] = np.eye(3)
    for k in range(3):
        rows[:, :, 3 + k] = np.cross(np.eye(3)[k], p)
    basis, _ = np.linalg.qr(rows.reshape(-1, 6))
    return np.eye(3 * len(p)) - basis @ basis.T
