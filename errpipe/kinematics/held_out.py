"""Leave-one-group-out cross-validation of an identification.

A group is a line, diagonal, circle, plate or socket with all its repeats: runs through the same places are
held out together. A held-out group keeps its own set-up (position of the socket, pose of the plate), fitted to its
rows alone, both without and with compensation, so that neither has an advantage.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.kinematics import residual_error, synthesis
from errpipe.kinematics.chain import Chain
from errpipe.kinematics.identify import Parametrisation, bending_of_lengths, identify
from errpipe.kinematics.observations import Observations

CELLS = 50  # of the travel: positions in one cell of this lattice are the same place
SAME = 0.5  # share of its places that a run has in common with another run of the same line, circle or plate
MAX_GROUPS = 6  # repeated identifications; more groups are held out several at a time
FEATURE_GROUPS, FEWEST_FEATURES = 5, 30  # of a part: at least six test features each time, for six set-up parameters
MIN_READINGS = 8  # readings of an identification


@dataclass(frozen=True)
class HeldOutGroup:
    """One held-out group: its label, its rows, and the readings without its set-up before and after, um (n,).

    If readings differ in uncertainty, each is weighted relative to the median uncertainty.
    """

    label: str
    rows: np.ndarray
    before: np.ndarray
    after: np.ndarray


def groups(chain: Chain, obs: Observations) -> tuple[np.ndarray, tuple[str, ...]]:
    """Group of each row (n,), and the groups' labels; with one group nothing can be held out.

    Runs that share most of their places are one group. If that gives a single one (a cloud measured with three tools),
    each run is its own group. Of a single run (a part) every fifth place, a feature with all its readings, is held out
    in turn.
    """
    labels, run = np.unique(obs.label.astype(str), return_inverse=True)
    low, high = chain.travel.T
    cell = np.round((obs.q - low) / (high - low) * CELLS).astype(int)
    if len(labels) == 1:
        _, place = np.unique(cell, axis=0, return_inverse=True)
        place = place.reshape(-1)
        turns = FEATURE_GROUPS if place.max() + 1 >= FEWEST_FEATURES else 1
        return place % turns, tuple(f"places {k + 1}, {k + 1 + turns} ..." for k in range(turns))
    seen = [set(map(tuple, cell[run == r])) for r in range(len(labels))]
    number = np.arange(len(labels))
    for i, own in enumerate(seen):
        for j in range(i):
            if len(own & seen[j]) > SAME * min(len(own), len(seen[j])):
                number[number == number[i]] = number[j]
    if len(set(number)) == 1:
        number = np.arange(len(labels))
    _, number = np.unique(number, return_inverse=True)
    number %= MAX_GROUPS
    names = tuple(", ".join(labels[number == g]) for g in range(number.max() + 1))
    return number[run], names


def cross_validate(
    model: Parametrisation,
    obs: Observations,
    group: np.ndarray,
    names: Sequence[str],
    progress: Callable[[float, str], None] = lambda share, text: None,
    factors: Mapping[str, float] | None = None,
) -> list[HeldOutGroup]:
    """Identify without each group and validate on it; an empty list if there is only one.

    group (n,): number of each row's group, -1 for rows that are never held out. factors: of the components that are
    compensated (default: 1 for all).
    """
    share = np.array([1.0 if factors is None else factors.get(c, 0.0) for c in model.chain.components])
    out = []
    for number, name in enumerate(names if len(names) > 1 else ()):
        rest = np.flatnonzero(group != number)
        if len(rest) < MIN_READINGS:
            return []
        progress(number / len(names), f"without {name}")
        fitted = identify(model, obs.take(rest))
        rows = np.flatnonzero(group == number)
        held_out = obs.take(rows)
        before = _without_setup(model, held_out, np.zeros(len(fitted.mean)), fitted.noise)
        after = _without_setup(model, held_out, share[model.prior.component] * fitted.mean, fitted.noise)
        certain = np.median(held_out.noise) / held_out.noise
        out.append(HeldOutGroup(name, rows, before * certain, after * certain))
    return out


def _without_setup(model: Parametrisation, obs: Observations, mean: np.ndarray, noise: float) -> np.ndarray:
    """Readings minus those predicted from the parameters and minus their own best set-up, um (n,)."""
    machine = model.design(obs)
    own = np.flatnonzero(obs.nuisance.any(axis=0))
    scaled = obs.nuisance[:, own] * (obs.nuisance_spread[own] / (noise * obs.noise[:, None]))
    normal = scaled.T @ scaled + np.eye(scaled.shape[1])
    setup, bent = np.zeros(obs.nuisance.shape[1]), np.zeros(len(obs))
    for _ in range(2):  # a bar's length is bent by the set-up itself
        left = (obs.value - bent - machine @ mean) / (noise * obs.noise)
        setup[own] = np.linalg.solve(normal, scaled.T @ left) * obs.nuisance_spread[own]
        full = np.hstack([machine, obs.nuisance])
        bent = bending_of_lengths(model.chain, model, obs, full, np.r_[mean, setup])
    return obs.value - bent - machine @ mean - obs.nuisance @ setup


def shares(chain: Chain, obs: Observations) -> np.ndarray:
    """Share of each linear axis' deviation in the square of each reading, shape (n, linear axes).

    An angle is weighted by its arms in the volume.
    """
    ways = synthesis.linear_motion(chain, obs.q, obs.tip)
    places = synthesis.ideal_pose(chain, residual_error.places(chain))[:, 0] * 1e-3
    x, y, z = np.var(places, axis=0)
    moved = np.array([[0.0, z, y], [z, 0.0, x], [y, x, 0.0]])  # um2 per urad2: square of what a turn does to a place
    along = np.einsum("nk,nka->na", obs.weights[:, :3], ways) ** 2
    return along + np.einsum("nk,nka->na", obs.weights[:, 3:] ** 2 @ moved, ways**2)
