"""How far apart the fits lie that each leave a group of runs out: a jackknife of the gains (Tukey 1958), as a driver.

With g_k the gains of a fit without group k and x the drivers of a row, the jackknife's variance of a prediction is

    spread(x)^2 = (n - 1) / n  x  sum over k of ((g_k - mean g) . x)^2

It is large where a row lies outside the fitted ones in a direction that the groups disagree on, and small where it lies
outside in one that they all show: the distance that matters to an interval. A turning centre's winter, predicted from
spring alone: 3.5 um of spread on the slow spindle's days, which are 10 um off, and 2 um on days that are 4 um off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.drivers.shared import drive_all
from errpipe.thermal.competition import Groups, Outcome

DIRECTIONS = 3  # principal ones that are kept: a table of fits without a run has few large ones (chosen, not measured)


def directions(
    outcome: Outcome, groups: Groups, folds: Sequence[Groups], recording: Recording, rows: np.ndarray
) -> tuple[d.Driver, ...]:
    """Sums of drivers, um, whose squares add up to the squared spread; none where too little is left out.

    folds: groups left out together, from those that fitted; rows: mask of the fitted rows.
    """
    if len(folds) < 2:
        return ()
    nodes: dict[str, d.Driver] = {}
    fits = []
    for fold in folds:
        gains: dict[str, float] = {}
        for entrant, weight in outcome.weights:
            for _, gain, node in (entrant.linear or entrant.parts)(tuple(g for g in groups if g not in fold)):
                key = node.model_dump_json()
                nodes[key] = node
                gains[key] = gains.get(key, 0.0) + weight * gain
        fits.append(gains)
    if not nodes:
        return ()
    table = np.array([[gains.get(key, 0.0) for key in nodes] for gains in fits])
    apart = (table - table.mean(axis=0)) * np.sqrt((len(fits) - 1) / len(fits))
    values = np.nan_to_num(drive_all(list(nodes.values()), recording)[rows])
    turned = np.linalg.svd(values @ apart.T, full_matrices=False)[2][:DIRECTIONS] @ apart
    return tuple(_sum(row, tuple(nodes.values())) for row in turned if row.any())


def _sum(gains: np.ndarray, nodes: Sequence[d.Driver]) -> d.Driver:
    kept = [(float(g), node) for g, node in zip(gains, nodes, strict=True) if g]
    return d.Affine(weights=tuple(g for g, _ in kept), of=tuple(node for _, node in kept))


def factor(spread: Sequence[d.Driver], floor: float) -> d.Driver:
    """sqrt(1 + (spread / floor)^2), 1; floor: um."""
    if not spread or floor <= 0.0:
        return d.Constant(value=1.0)
    squares = tuple(d.Product(of=(node, node)) for node in spread)
    return d.Power(of=d.Affine(offset=1.0, weights=(floor**-2,) * len(squares), of=squares), exponent=0.5)
