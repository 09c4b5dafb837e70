"""One response from mismatch to verdict: the steps of this package in their order."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from errpipe.diagnosis import decompose as parts
from errpipe.diagnosis import hypotheses, search
from errpipe.diagnosis.evidence import Noise, Nuisance, Scene
from errpipe.diagnosis.prepare import Pair
from errpipe.domain.recording import Recording

GAIN_SD = 0.10  # how far a simulation's gains are usually off (0..15 %)
MISSING = 10.0  # log Bayes factor for the first finding
MORE = 10.0  # and for each further one
OFF = 3.0  # log Bayes factor for a recalibration

Progress = Callable[[float, str], None]


@dataclass
class Case:
    """All that is known about one response while it is judged."""

    recording: Recording  # conditioned
    pair: Pair
    library: hypotheses.Library
    decomposition: parts.Decomposition
    simulated: np.ndarray
    y: np.ndarray
    run: np.ndarray
    nuisance: Nuisance
    explanation: search.Explanation | None = None
    noise_floor: float = float("nan")
    notes: dict[str, Any] = field(default_factory=dict)


def judge(conditioned: Recording, pair: Pair, progress: Progress = lambda share, text: None) -> Case:
    """Explain one response."""
    rows = pair.rows
    run = conditioned.run_codes()[rows]
    progress(0.1, f"{pair.component}: listing what may be missing")
    library = hypotheses.build(conditioned, pair.component, rows, extra=True)
    simulated = conditioned.array(pair.simulated)[rows]
    progress(0.3, f"{pair.component}: taking the simulation apart")
    decomposition = parts.decompose(simulated, library, run)
    y = pair.mismatch
    nuisance = recalibration(simulated, decomposition, library, y.size)
    case = Case(conditioned, pair, library, decomposition, simulated, y, run, nuisance)
    progress(0.5, f"{pair.component}: looking for what is missing")
    prior = log_prior(library, decomposition)
    noise = Noise(first_noise(y, run))
    for _ in range(3):
        case.explanation = search.explain(y, nuisance, library, run, noise, prior, MISSING, MORE)
        left = residual(case, noise)
        sigma = float(np.sqrt(np.mean(left**2)))
        if abs(sigma / noise.sigma - 1) < 0.02:
            break
        noise = Noise(max(sigma, 1e-9))
    case.noise_floor = noise.sigma
    case.notes["noise"] = noise
    return case


def recalibration(simulated: np.ndarray, d: parts.Decomposition, library: hypotheses.Library, n: int) -> Nuisance:
    """Datum, gain of the whole simulated signal, gain of each of its parts."""
    nuisance = Nuisance(np.ones((n, 1)), np.array([np.inf]), ["datum"])
    nuisance = nuisance.plus((simulated - simulated.mean())[:, None], np.array([GAIN_SD]), ["simulation"])
    for part in d.parts:
        nuisance = nuisance.plus(part.contribution[:, None], np.array([GAIN_SD]), [part.hypothesis.effect])
    return nuisance


def log_prior(library: hypotheses.Library, d: parts.Decomposition) -> np.ndarray:
    """Log prior odds: what the simulation already holds is seldom what it lacks; fewer bindings, more each."""
    present = {p.hypothesis.effect for p in d.parts}
    prior = np.array([h.prior for h in library.hypotheses])
    for i, h in enumerate(library.hypotheses):
        if h.effect in present:
            prior[i] += search.PRESENT
        if h.effect == "moving_mass":
            prior[i] = -1e6
    return prior


def first_noise(y: np.ndarray, run: np.ndarray) -> float:
    """Noise from second differences between neighbours, robust; an upper bound where the mismatch is rough."""
    same = (run[2:] == run[1:-1]) & (run[1:-1] == run[:-2])
    bend = (y[2:] - 2 * y[1:-1] + y[:-2])[same]
    if bend.size < 10:
        return float(np.std(y)) or 1e-9
    return float(max(1.4826 * np.median(np.abs(bend)) / np.sqrt(6.0), 1e-6 * np.std(y), 1e-12))


def residual(case: Case, noise: Noise) -> np.ndarray:
    """What the explanation leaves, on the judged rows."""
    nuisance = full(case, noise)
    scene = Scene(case.y, nuisance, noise, case.run)
    return case.y - nuisance.columns @ scene.coefficients()


def full(case: Case, noise: Noise) -> Nuisance:
    """Nuisances and every accepted hypothesis."""
    nuisance = case.nuisance
    for f in case.explanation.found if case.explanation else ():
        nuisance = search._with(nuisance, case.library, noise, f.index, f.size)
    return nuisance


def needs_recalibration(case: Case, noise: Noise) -> bool:
    """Are datum or gains off beyond doubt?"""
    empty = Nuisance(np.zeros((case.y.size, 0)), np.zeros(0))
    for f in case.explanation.found if case.explanation else ():
        empty = search._with(empty, case.library, noise, f.index, f.size)
    scene = Scene(case.y, empty, noise, case.run)
    candidates = [np.ones((case.y.size, 1))]
    spread = case.simulated.std()
    centred = (case.simulated - case.simulated.mean())[:, None]
    if spread > 0:
        candidates += [centred / spread, np.column_stack([candidates[0], centred / spread])]
    for p in case.decomposition.parts:
        c = p.contribution[:, None] / max(p.contribution.std(), 1e-12)
        candidates += [np.column_stack([candidates[0], c])]
    if len(case.decomposition.parts) > 1:
        every = np.column_stack([p.contribution / max(p.contribution.std(), 1e-12) for p in case.decomposition.parts])
        candidates.append(np.column_stack([candidates[0], every]))
    best = -np.inf
    for c in candidates:
        H = noise.whiten(c, case.run)
        best = max(best, scene.score_all(H, [slice(0, c.shape[1])], np.ones(c.shape[1]))[0].gain)
    return best > OFF
