"""The simulated signal has no noise: taken apart into its effects, it tells what a recalibration may change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import Active, Data, Scene
from errpipe.diagnosis.hypotheses import Hypothesis, Library

MOST_PARTS = 7
FAITHFUL = 0.012  # rms of what is left, relative to the signal, below which nothing more is looked for
WORTH = 8.0  # log Bayes factor a further part must bring
COARSE = 0.02  # what textbook forms cannot reach, relative to the signal: taken for noise
NEVER = ("clock_offset", "sensor_fault")  # faults of recordings, not parts of simulations
STRANGE = {"thermal_interaction": -25.0, "sensor_drift": -10.0, "local_wear": -5.0, "gradient_bending": -5.0}


@dataclass(frozen=True)
class Part:
    """One effect found in the simulated signal: what its core and its slack contribute on the judged rows.

    certainty: log Bayes factor that it brings beside the other parts.
    """

    hypothesis: Hypothesis
    index: int
    core: np.ndarray
    slack: np.ndarray
    certainty: float

    @property
    def contribution(self) -> np.ndarray:
        """All of it."""
        return self.core + self.slack


@dataclass(frozen=True)
class Decomposition:
    """parts; the rms they leave over relative to the simulated signal's; what they leave over, shape (rows,)."""

    parts: tuple[Part, ...]
    leftover: float
    rest: np.ndarray


def decompose(simulated: np.ndarray, library: Library) -> Decomposition:
    """Greedy with backward pruning; each part must be worth its columns on the noiseless signal."""
    return _Work(simulated, library).run()


class _Work:
    def __init__(self, simulated: np.ndarray, library: Library):
        self.y, self.library = simulated - simulated.mean(), library
        self.spread = float(self.y.std())
        self.sigma = COARSE * self.spread
        self.still = self.spread <= 1e-9 * (1 + np.abs(simulated).max())
        self.prior = np.array(
            [-1e9 if h.effect in NEVER else STRANGE.get(h.effect, 0.0) for h in library.hypotheses]
        )

    def run(self) -> Decomposition:
        if self.still or not self.library.hypotheses:
            return Decomposition((), 0.0, np.zeros_like(self.y))
        self.data = Data.of(self.library.table, self.y)
        chosen: list[int] = []
        for _ in range(MOST_PARTS):
            gain = self._gains(chosen, list(range(len(self.library.hypotheses))))
            taken = {self.library.hypotheses[i].key for i in chosen}
            kinds = {self.library.hypotheses[i].effect for i in chosen}
            for k, h in enumerate(self.library.hypotheses):
                if h.key in taken:
                    gain[k] = -np.inf
                elif h.effect in kinds:
                    gain[k] -= 10.0
            best = int(np.argmax(gain))
            if gain[best] < WORTH:
                break
            chosen = self._polish([*chosen, best])
            if self._scene(chosen).rms() / self.spread < FAITHFUL:
                break
        return self._result(self._prune(chosen))

    def _active(self, chosen: list[int]) -> Active:
        active = Active(np.array([self.library.datum]), np.array([np.inf]))
        for i in chosen:
            active = active.plus(self.library.indices(i), 2.0 * self.spread * self.library.freedom_of(i))
        return active

    def _scene(self, chosen: list[int]) -> Scene:
        return Scene(self.data, self._active(chosen), self.sigma)

    def _gains(self, chosen: list[int], candidates: list[int]) -> np.ndarray:
        scored = self._scene(chosen).score(
            [self.library.slices[k] for k in candidates], [self.library.freedom_of(k) for k in candidates]
        )
        return np.array([s.gain for s in scored]) + self.prior[candidates]

    def _polish(self, chosen: list[int]) -> list[int]:
        """Each part in turn moves to the best point of its own grid, the others held."""
        chosen = list(chosen)
        for _ in range(2):
            before = list(chosen)
            for place, i in enumerate(chosen):
                same = self.library.family(i)
                if len(same) > 1:
                    chosen[place] = same[int(np.argmax(self._gains(chosen[:place] + chosen[place + 1 :], same)))]
            if chosen == before:
                break
        return chosen

    def _certainty(self, chosen: list[int]) -> list[float]:
        return [float(self._gains(chosen[:p] + chosen[p + 1 :], [i])[0]) for p, i in enumerate(chosen)]

    def _prune(self, chosen: list[int]) -> list[int]:
        while len(chosen) > 1:
            worth = self._certainty(chosen)
            weakest = int(np.argmin(worth))
            if worth[weakest] >= WORTH:
                break
            chosen = chosen[:weakest] + chosen[weakest + 1 :]
        return chosen

    def _result(self, chosen: list[int]) -> Decomposition:
        scene = self._scene(chosen)
        b = scene.coefficients()
        worth = self._certainty(chosen)
        parts, start, total = [], 1, np.full_like(self.y, b[0])
        for i, certainty in zip(chosen, worth, strict=True):
            columns = self.library.columns[:, self.library.slices[i]]
            weights = b[start : start + columns.shape[1]]
            start += columns.shape[1]
            cores = self.library.cores[i]
            core, slack = columns[:, :cores] @ weights[:cores], columns[:, cores:] @ weights[cores:]
            total = total + core + slack
            parts.append(Part(self.library.hypotheses[i], i, core - core.mean(), slack - slack.mean(), certainty))
        rest = self.y - total
        return Decomposition(tuple(parts), float(np.std(rest) / self.spread), rest)
