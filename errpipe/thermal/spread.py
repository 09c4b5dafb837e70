"""Spread of predictions that the fitted rows cannot distinguish: between fits without a run, and between families.

With g_k the gains of a fit without group k and x the drivers of a row, the jackknife's variance of a prediction is
(Tukey 1958)

    spread(x)^2 = (n - 1) / n  x  sum over k of ((g_k - mean g) . x)^2

and with p_k the prediction by the best setting of each of K families, the variance between models is (Buckland,
Burnham and Augustin 1997, Biometrics 53:603; equal weights)

    spread(x)^2 = 1 / K  x  sum over k of (p_k - mean p)^2

Both are large if a row lies outside the fitted ones in a direction in which these disagree, and small in one that they
all cover: the relevant distance for an interval. A turning centre's winter, predicted from
spring alone: 3.5 um between fits on the slow spindle's days, with an error of 10 um, and 2 um on days with 4 um.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.shared import drive_all
from errpipe.thermal.competition import Entrant, Groups, Outcome

DIRECTIONS = 3  # principal ones that are used: fits without a run differ mainly in few (by judgement)
# Shares of the residual variance beyond noise that follow the spread of fits and of families; the rest is constant.
# Chosen on 36 machines (seeds 43401 and 43411 of `trials.thermal`, g3 4341 to 4343 of a generator of columns, spindles,
# gantries and screws) with `calibration.SEASONS`: 85 to 95 % of the third season are covered on 31 of them.
FITS, FAMILIES = 0.25, 0.25

LARGEST = 1e6  # um, up to which the table of a magnitude is exact

Directions = tuple[d.Driver, ...]


def between_fits(
    outcome: Outcome, groups: Groups, folds: Sequence[Groups], recording: Recording, rows: np.ndarray
) -> Directions:
    """Sums of drivers, um, whose squares add up to the jackknife's variance; none if too few groups are held out.

    folds: groups held out together, from the fitted ones; rows: mask of the fitted rows.
    """
    fits = [
        [
            (weight * gain, node)
            for entrant, weight in outcome.weights
            for _, gain, node in (entrant.linear or entrant.parts)(tuple(g for g in groups if g not in fold))
        ]
        for fold in folds
    ]
    return _directions(fits, (len(fits) - 1) / max(len(fits), 1), recording, rows)


def between_families(entrants: Sequence[Entrant], groups: Groups, recording: Recording, rows: np.ndarray) -> Directions:
    """Likewise for the variance between the best settings of families, all fitted to every group."""
    fits = [[(gain, node) for _, gain, node in entrant.parts(groups)] for entrant in entrants]
    return _directions(fits, 1.0 / max(len(fits), 1), recording, rows)


def _directions(
    fits: Sequence[Iterable[tuple[float, d.Driver]]], share: float, recording: Recording, rows: np.ndarray
) -> Directions:
    """Principal directions of sums of gains times drivers about their mean, times the root of `share`."""
    nodes: dict[str, d.Driver] = {}
    sums: list[dict[str, float]] = []
    for fit in fits:
        sums.append({})
        for gain, node in fit:
            key = node.model_dump_json()
            nodes[key] = node
            sums[-1][key] = sums[-1].get(key, 0.0) + gain
    if len(sums) < 2 or not nodes:
        return ()
    table = np.array([[gains.get(key, 0.0) for key in nodes] for gains in sums])
    apart = (table - table.mean(axis=0)) * np.sqrt(share)
    values = np.nan_to_num(drive_all(list(nodes.values()), recording)[rows])
    turned = np.linalg.svd(values @ apart.T, full_matrices=False)[2][:DIRECTIONS] @ apart
    return tuple(_sum(row, tuple(nodes.values())) for row in turned if row.any())


def _sum(gains: np.ndarray, nodes: Sequence[d.Driver]) -> d.Driver:
    kept = [(float(g), node) for g, node in zip(gains, nodes, strict=True) if g]
    return d.Affine(weights=tuple(g for g, _ in kept), of=tuple(node for _, node in kept))


def squared(spread: Directions, recording: Recording) -> np.ndarray:
    """Variance of each row, um2, (rows,); zero without a direction."""
    return np.sum(drive_all(list(spread), recording) ** 2, axis=1) if spread else np.zeros(len(recording))


def root(offset: float, variances: Sequence[tuple[float, Directions]]) -> d.Driver:
    """sqrt(offset + sum of weights (1/um2) times variances), 1."""
    squares = [(weight, _square(node)) for weight, spread in variances for node in spread]
    if not squares:
        return d.Constant(value=float(np.sqrt(offset)))
    total = d.Affine(offset=offset, weights=tuple(w for w, _ in squares), of=tuple(node for _, node in squares))
    return d.Power(of=total, exponent=0.5)


def _square(node: d.Driver) -> d.Driver:
    """The square of a driver that is referenced once: as a product of two it would double an error model's file."""
    size = d.Lookup(of=node, start=-LARGEST, step=LARGEST, values=(LARGEST, 0.0, LARGEST))
    return d.Power(of=size, exponent=2.0)
