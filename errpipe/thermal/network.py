"""Gains of physical causes: non-negative least squares by the sign of each cause, averaged over networks.

A gain that physics allows is positive (or negative) and a few um/K; a gain of the wrong sign fits its own
season 2 um better and the next 50 um worse. The sign alone removes most of that freedom
(non-negative least squares selects few causes), a small penalty in um/K the rest. Several networks
that differ in unmeasured states are averaged, because a choice among collinear ones is noise.

Groups of rows (runs) are reduced once to a triangle each; any hold-out then costs a stack of triangles.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.optimize import nnls

from errpipe.fitting.solve import one_thread

LEAST_MISFIT = 0.3  # um: below it a run is fitted to its measurement noise


def triangles(
    design: np.ndarray, response: np.ndarray, groups: np.ndarray, share: float = 0.0
) -> dict[int, np.ndarray]:
    """R of the QR of [design, response] per group, rows scaled so that every group counts by its rows.

    design: (n, p) in K; response: (n,) in um; groups: (n,) integers; share: of its mean removed from each group,
    0 to 1 (quasi-demeaning, Fuller and Battese 1974). -> group -> (<= p+1, p+1).
    """
    both = np.column_stack([design, response])
    parts = ((g, both[groups == g]) for g in np.unique(groups))
    with one_thread():
        return {int(g): _triangle(own - share * own.mean(axis=0)) for g, own in parts}


def stack(parts: Mapping[int, np.ndarray], keep: Sequence[int]) -> np.ndarray:
    """One triangle for the groups in `keep`, shape (<= p+1, p+1)."""
    with one_thread():
        return _triangle(np.vstack([parts[g] for g in keep]))


def _triangle(rows: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.qr(rows, mode="r"))


def signed_gains(
    triangle: np.ndarray, rows: int, members: Sequence[np.ndarray], signs: np.ndarray, penalty: float
) -> np.ndarray:
    """Mean gains over networks, shape (p,), um/K; each solves for its own causes with fixed signs.

    triangle: from `stack`; members: indices of each network's causes; signs: (p,) of +1 and -1;
    penalty: K2, added to each cause's mean square: a cause whose rms is below its root is shrunk by more than half.
    """
    total = np.zeros(signs.size)
    root = np.sqrt(penalty * rows)
    height, signed = len(triangle), triangle[:, :-1] * signs
    for member in members:
        size = member.size
        system, right = np.zeros((height + size, size)), np.zeros(height + size)
        system[:height], right[:height] = signed[:, member], triangle[:, -1]
        np.fill_diagonal(system[height:], root)
        magnitudes, _ = nnls(system, right)
        total[member] += magnitudes * signs[member]
    return total / max(len(members), 1)


def reweighted(
    weight: Mapping[int, float], parts: Mapping[int, np.ndarray], rows: Mapping[int, int], gains: np.ndarray
) -> dict[int, float]:
    """Weights of groups multiplied by the root of their misfit, mean square over rows one: half-way to minimax.

    A mean over days is dominated by the many similar ones; the next season resembles the outlying ones.
    parts: group -> triangle of [columns of the gains, ..., response]; rows: group -> rows it stands for.
    """
    width = gains.size
    new = {}
    for g, w in weight.items():
        residual = parts[g][:, -1] - parts[g][:, :width] @ gains
        new[g] = w * max(float(np.sqrt(residual @ residual / rows[g])), LEAST_MISFIT) ** 0.5
    total = sum(rows[g] for g in new)
    scale = np.sqrt(sum(rows[g] * w**2 for g, w in new.items()) / total)
    return {g: w / scale for g, w in new.items()}


def networks(kinds: Sequence[str], starts: Sequence[str]) -> list[np.ndarray]:
    """Index sets of the networks: all bodies, one path for the heat while running, one start of the hidden part.

    Which part absorbs the heat of running and how warm the hidden part starts are not measured: one network
    for each combination, and their gains are averaged.
    """
    kinds_, starts_ = np.asarray(kinds), np.asarray(starts)
    bodies = np.flatnonzero(kinds_ == "body")
    heat = [np.array([k]) for k in np.flatnonzero(kinds_ == "running")] or [np.empty(0, dtype=int)]
    follows = kinds_ == "follower"
    hidden = [np.flatnonzero(follows & (starts_ == s)) for s in dict.fromkeys(starts_[follows])]
    return [np.r_[bodies, run, pull] for run in heat for pull in (hidden or [np.empty(0, dtype=int)])]
