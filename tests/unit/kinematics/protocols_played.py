"""Every protocol on a ready machine, as `simulation.measuring_runs` lays it out, and where it is judged."""

from __future__ import annotations

import numpy as np

from errpipe.kinematics import synthesis
from errpipe.simulation import measuring_runs as runs_of

TOOLS = runs_of.TOOLS


def _named(protocol):
    def build(chain):
        return protocol, runs_of.PROTOCOLS[protocol](chain)

    build.__name__ = runs_of.PROTOCOLS[protocol].__name__
    return build


(
    circles,
    telescoping,
    multilateration,
    cloud,
    diagonals,
    step_diagonals,
    ball_plate,
    ball_array,
    hole_pattern,
    part,
    r_test,
    rotary_ballbar,
) = EVERY = tuple(map(_named, runs_of.PROTOCOLS))
THREE_AXES = EVERY[: EVERY.index(part)]
FIVE_AXES = (r_test, rotary_ballbar)


def unseen_places(protocol, chain, runs, count=60, seed=99):
    """Places the test did not measure but is asked about: between its poses, same tool."""
    rng = np.random.default_rng(seed)
    if protocol in ("r_test", "rotary_ballbar"):
        return runs_of.table_poses(chain, np.array([30.0, 50.0, 90.0]), 150.0, count, 77), chain.tip(150.0)
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
