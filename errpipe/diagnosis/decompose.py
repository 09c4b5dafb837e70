"""The simulated signal has no noise: taken apart into the effects it holds, it tells what a recalibration may change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import Noise, Nuisance, Scene
from errpipe.diagnosis.hypotheses import Hypothesis, Library

MOST_PARTS = 6
FAITHFUL = 0.012  # rms of what is left, relative to the signal, below which nothing more is looked for
WORTH = 6.0  # log Bayes factor a further part must bring


@dataclass(frozen=True)
class Part:
    """One effect found in the simulated signal: its contribution on the judged rows."""

    hypothesis: Hypothesis
    index: int
    contribution: np.ndarray
    certainty: float


@dataclass(frozen=True)
class Decomposition:
    """parts, and the share of the simulated signal's rms that they leave over."""

    parts: tuple[Part, ...]
    leftover: float


def decompose(simulated: np.ndarray, library: Library, run: np.ndarray) -> Decomposition:
    """Greedy with backward pruning; each part must be worth its columns on the noiseless signal."""
    spread = simulated.std()
    if spread <= 1e-12 * (1 + np.abs(simulated).max()):
        return Decomposition((), 0.0)
    chosen: list[int] = []
    # what textbook forms cannot reach counts as noise of a few per cent
    noise = Noise(0.02 * spread, 0.5)
    H = noise.whiten(library.columns, run)
    for _ in range(MOST_PARTS):
        scene = Scene(simulated, _nuisance(simulated, library, chosen, spread), noise, run)
        scores = scene.score_all(H, library.slices, library.freedom)
        taken = {library.hypotheses[i].key for i in chosen}
        kinds = {library.hypotheses[i].effect for i in chosen}
        order = sorted(range(len(scores)), key=lambda i: -scores[i].gain + (2.0 if library.hypotheses[i].effect in kinds else 0.0))
        best = next((i for i in order if library.hypotheses[i].key not in taken), None)
        if best is None or scores[best].gain < WORTH:
            break
        chosen.append(best)
        chosen = _polish(simulated, library, chosen, H, noise, run, spread)
        if _leftover(simulated, library, chosen, noise, run, spread) < FAITHFUL:
            break
    chosen = _prune(simulated, library, chosen, H, noise, run, spread)
    return _result(simulated, library, chosen, noise, run, spread)


def _nuisance(y: np.ndarray, library: Library, chosen: list[int], spread: float) -> Nuisance:
    base = Nuisance(np.ones((y.size, 1)), np.array([np.inf]), ["datum"])
    for i in chosen:
        columns, freedom = library.of(i)
        base = base.plus(columns, 2.0 * spread * freedom, [str(i)] * columns.shape[1])
    return base


def _polish(y, library, chosen, H, noise, run, spread) -> list[int]:
    """Each chosen part in turn moves to the best point of its own grid, the others held."""
    for _ in range(2):
        before = list(chosen)
        for place, i in enumerate(chosen):
            others = chosen[:place] + chosen[place + 1 :]
            same = [j for j, h in enumerate(library.hypotheses) if h.key == library.hypotheses[i].key]
            if len(same) > 1:
                chosen[place] = _best_of(y, library, others, same, H, noise, run, spread)[0]
        if chosen == before:
            break
    return chosen


def _best_of(y, library, others, candidates, H, noise, run, spread) -> tuple[int, float]:
    scene = Scene(y, _nuisance(y, library, others, spread), noise, run)
    at = [library.slices[j] for j in candidates]
    index = np.concatenate([np.arange(s.start, s.stop) for s in at])
    starts = np.cumsum([0, *[s.stop - s.start for s in at]])
    local = [slice(int(a), int(b)) for a, b in zip(starts[:-1], starts[1:], strict=True)]
    scores = scene.score_all(H[:, index], local, library.freedom[index])
    k = int(np.argmax([s.gain for s in scores]))
    return candidates[k], scores[k].gain


def _prune(y, library, chosen, H, noise, run, spread) -> list[int]:
    """Drop parts that the others make needless."""
    dropped = True
    while dropped and len(chosen) > 1:
        dropped = False
        worth = []
        for place, i in enumerate(chosen):
            others = chosen[:place] + chosen[place + 1 :]
            worth.append(_best_of(y, library, others, [i], H, noise, run, spread)[1])
        weakest = int(np.argmin(worth))
        if worth[weakest] < WORTH:
            chosen = chosen[:weakest] + chosen[weakest + 1 :]
            dropped = True
    return chosen


def _leftover(y, library, chosen, noise, run, spread) -> float:
    nuisance = _nuisance(y, library, chosen, spread)
    scene = Scene(y, nuisance, noise, run)
    return float(np.std(y - nuisance.columns @ scene.coefficients()) / spread)


def _result(y, library, chosen, noise, run, spread) -> Decomposition:
    nuisance = _nuisance(y, library, chosen, spread)
    scene = Scene(y, nuisance, noise, run)
    b = scene.coefficients()
    names = np.array(nuisance.names)
    H = noise.whiten(library.columns, run)
    parts = []
    for place, i in enumerate(chosen):
        at = names == str(i)
        contribution = nuisance.columns[:, at] @ b[at]
        others = chosen[:place] + chosen[place + 1 :]
        worth = _best_of(y, library, others, [i], H, noise, run, spread)[1]
        parts.append(Part(library.hypotheses[i], i, contribution - contribution.mean(), worth))
    left = float(np.std(y - nuisance.columns @ b) / spread)
    return Decomposition(tuple(parts), left)
