"""What is missing: the effects that explain the mismatch beyond what a recalibration can, alone and in pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import Noise, Nuisance, Scene
from errpipe.diagnosis.hypotheses import Hypothesis, Library

MOST = 3  # findings looked for
SHORTLIST = 10  # kinds tried jointly
PRESENT = -4.0  # log prior odds against an effect that the simulation already holds


@dataclass(frozen=True)
class Found:
    """One accepted hypothesis, and what its absence would cost beside the others."""

    index: int
    hypothesis: Hypothesis
    size: float
    gain: float


@dataclass(frozen=True)
class Explanation:
    """Accepted hypotheses; the rivals of the first (index, gain); the noise it leaves."""

    found: tuple[Found, ...]
    singles: tuple[tuple[int, float], ...]
    noise: Noise
    total: float


def explain(y: np.ndarray, nuisance: Nuisance, library: Library, run: np.ndarray, noise: Noise, prior: np.ndarray,
            threshold: float, threshold_more: float) -> Explanation:  # fmt: skip
    """Forward search with joint pairs and backward pruning. prior: log odds of each hypothesis."""
    H = noise.whiten(library.columns, run)
    base = Scene(y, nuisance, noise, run)
    scores = base.score_all(H, library.slices, library.freedom)
    gain = np.array([s.gain for s in scores]) + prior if scores else np.zeros(0)
    singles = tuple((int(i), float(gain[i])) for i in np.argsort(-gain))
    if not scores or gain.max() < threshold:
        return Explanation((), singles, noise, 0.0)
    chosen, total = _best_set(y, nuisance, library, run, noise, prior, H, scores, gain, threshold_more)
    found = _worth(y, nuisance, library, run, noise, prior, H, chosen)
    return Explanation(tuple(found), singles, noise, total)


def _leaders(library: Library, gain: np.ndarray, most: int) -> list[int]:
    """The best point of each key, best first."""
    out, seen = [], set()
    for i in np.argsort(-gain):
        key = library.hypotheses[i].key
        if key not in seen:
            seen.add(key)
            out.append(int(i))
        if len(out) == most:
            break
    return out


def _with(nuisance: Nuisance, library: Library, noise: Noise, index: int, size: float) -> Nuisance:
    columns, freedom = library.of(index)
    return nuisance.plus(columns, np.maximum(size, 3.0) * noise.sigma * freedom * 2, [f"h{index}"] * columns.shape[1])


def _best_set(y, nuisance, library, run, noise, prior, H, scores, gain, threshold_more):
    """Greedy from each of the best starts, keeping the best total; a further effect must be worth its place."""
    best_total, best_set = -np.inf, []
    starts = [i for i in _leaders(library, gain, SHORTLIST) if gain[i] > 0.3 * gain.max() - 5] or [int(np.argmax(gain))]
    for first in starts:
        chosen = [(first, scores[first].size)]
        total = gain[first]
        while len(chosen) < MOST:
            with_chosen = nuisance
            for i, size in chosen:
                with_chosen = _with(with_chosen, library, noise, i, size)
            scene = Scene(y, with_chosen, noise, run)
            more = scene.score_all(H, library.slices, library.freedom)
            taken = {library.hypotheses[i].effect for i, _ in chosen}
            extra = np.array([s.gain for s in more]) + prior
            extra[[h.effect in taken for h in library.hypotheses]] = -np.inf
            k = int(np.argmax(extra))
            if extra[k] < threshold_more:
                break
            chosen.append((k, more[k].size))
            total += extra[k] - threshold_more
        if total > best_total + 1e-9:
            best_total, best_set = total, chosen
    return best_set, float(best_total)


def _worth(y, nuisance, library, run, noise, prior, H, chosen) -> list[Found]:
    """Each member re-tuned on its own grid beside the others, with what it is worth there; strongest first."""
    for _ in range(2):
        for place, (i, _size) in enumerate(chosen):
            others = nuisance
            for j, size in chosen[:place] + chosen[place + 1 :]:
                others = _with(others, library, noise, j, size)
            same = [k for k, h in enumerate(library.hypotheses) if h.key == library.hypotheses[i].key]
            k, scored = _score_some(Scene(y, others, noise, run), library, H, same)
            chosen[place] = (k, scored.size)
    found = []
    for place, (i, _size) in enumerate(chosen):
        others = nuisance
        for j, size in chosen[:place] + chosen[place + 1 :]:
            others = _with(others, library, noise, j, size)
        _, scored = _score_some(Scene(y, others, noise, run), library, H, [i])
        found.append(Found(i, library.hypotheses[i], scored.size, scored.gain + prior[i]))
    return sorted(found, key=lambda f: -f.gain)


def _score_some(scene: Scene, library: Library, H: np.ndarray, indices: list[int]):
    """The best of some hypotheses, and its score."""
    at = [library.slices[k] for k in indices]
    index = np.concatenate([np.arange(s.start, s.stop) for s in at])
    starts = np.cumsum([0, *[s.stop - s.start for s in at]])
    local = [slice(int(a), int(b)) for a, b in zip(starts[:-1], starts[1:], strict=True)]
    scored = scene.score_all(H[:, index], local, library.freedom[index])
    k = int(np.argmax([s.gain for s in scored]))
    return indices[k], scored[k]
