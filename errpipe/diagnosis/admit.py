"""Test of the residual: does a smooth shape without a name explain more than the findings alone?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import ActiveSet, Scene, ScoredHypotheses
from errpipe.diagnosis.search import Search
from errpipe.diagnosis.shapes import Shape

ENOUGH = 8.0  # threshold: log Bayes factor from which a shape is accepted
MOST = 3  # shapes accepted in addition to the named effects


@dataclass(frozen=True)
class AdmittedShapes:
    """Shapes accepted in addition to the chosen hypotheses.

    shapes: the accepted ones with their gains; rms: of the residual with them; share: of the variance that findings and
    shapes explain beyond the recalibration, the part that only the shapes explain.
    """

    shapes: tuple[tuple[Shape, float], ...]
    rms: float
    share: float
    active: ActiveSet  # nuisances, hypotheses, shapes, in this order
    taken: tuple[int, ...]


def remainder(
    search: Search, chosen: list[tuple[int, float]], shapes: list[Shape], index: list[np.ndarray], inputs: bool = False
) -> AdmittedShapes:
    """Add shapes (inputs: over inputs only) greedily to the chosen hypotheses. index: their columns in the table."""
    named = scene = search.scene(chosen)
    taken: list[int] = []
    gains: list[float] = []
    active = search.active(chosen)
    listed = ScoredHypotheses(index, [s.freedom for s in shapes], [i.size for i in index])
    for _ in range(MOST):
        gain, size, _core = scene.scores(listed)
        gain[taken + [k for k, s in enumerate(shapes) if inputs and not s.of_inputs]] = -np.inf
        k = int(np.argmax(gain)) if gain.size else -1
        if k < 0 or gain[k] < ENOUGH:
            break
        taken.append(k)
        gains.append(float(gain[k]))
        active = active.plus(index[k], 2.0 * max(size[k], 1.0) * search.sigma * shapes[k].freedom)
        scene = Scene(search.data, active, search.noise)
    everything = max(search.scene([]).rms() ** 2 - scene.rms() ** 2, 1e-12)
    share = float(np.clip((named.rms() ** 2 - scene.rms() ** 2) / everything, 0, 1))
    accepted = tuple((shapes[k], g) for k, g in zip(taken, gains, strict=True))
    return AdmittedShapes(accepted, scene.rms(), share, active, tuple(taken))
