"""The simulated signal has no noise: taken apart into its effects, it tells what a recalibration may change."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import Active, Data, Scene
from errpipe.diagnosis.hypotheses import Hypothesis, Library
from errpipe.domain.recording import Recording

MOST_PARTS = 6
COARSE = 0.01  # what textbook forms cannot reach, relative to the signal: taken for noise
ROWS = 300.0  # what is left is no noise: it counts as this many rows
PRICE = 6.0  # log prior odds against each part
NEVER = ("clock_offset", "sensor_fault")  # faults of recordings, not parts of simulations
STRANGE = {"thermal_interaction": -6.0, "sensor_drift": -4.0, "local_wear": -3.0, "gradient_bending": -2.0}


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


def decompose(simulated: np.ndarray, library: Library, recording: Recording, rows: np.ndarray) -> Decomposition:
    """Parts added, exchanged and dropped while the evidence grows; each must be worth its columns."""
    return _Work(simulated, library, recording, rows).run()


class _Work:
    def __init__(self, simulated: np.ndarray, library: Library, recording: Recording, rows: np.ndarray):
        self.y, self.library = simulated - simulated.mean(), library
        self.recording, self.rows = recording, rows
        self.spread = float(self.y.std())
        self.sigma = COARSE * self.spread
        self.still = self.spread <= 1e-9 * (1 + np.abs(simulated).max())
        self.prior = np.array(
            [-1e9 if h.effect in NEVER else STRANGE.get(h.effect, 0.0) for h in library.hypotheses]
        )

    def run(self) -> Decomposition:
        if self.still or not self.library.hypotheses:
            return Decomposition((), 0.0, np.zeros_like(self.y))
        self.data = Data(self.library.table, self.y)
        chosen, worth = [], self._worth([])
        for _ in range(4 * MOST_PARTS):
            chosen, better = self._best_move(chosen, worth)
            if better <= worth + 1e-6:
                break
            worth = better
        return self._result(chosen)

    def _best_move(self, chosen: list[int], worth: float) -> tuple[list[int], float]:
        """The best of adding a part, exchanging one, or dropping one."""
        moves: list[list[int]] = [chosen[:p] + chosen[p + 1 :] for p in range(len(chosen))]
        if len(chosen) < MOST_PARTS:
            moves += [[*chosen, k] for k in self._candidates(chosen, 4)]
        for p in range(len(chosen)):
            others = chosen[:p] + chosen[p + 1 :]
            moves += [[*others[:p], k, *others[p:]] for k in self._candidates(others, 3) if k != chosen[p]]
        best, best_worth = chosen, worth
        for move in moves:
            value = self._worth(move)
            if value > best_worth + 1e-6:
                best, best_worth = move, value
        return best, best_worth

    def _candidates(self, others: list[int], most: int) -> list[int]:
        """The most promising hypotheses beside others, each effect once."""
        gain = self._gains(others)
        taken = {self.library.hypotheses[i].key for i in others}
        out, seen = [], set()
        for k in np.argsort(-gain):
            h = self.library.hypotheses[k]
            if h.key not in taken and h.effect not in seen:
                seen.add(h.effect)
                out.append(int(k))
            if len(out) == most:
                break
        return out

    def _active(self, chosen: list[int]) -> Active:
        active = Active(np.array([self.library.datum]), np.array([np.inf]))
        for i in chosen:
            active = active.plus(self.library.indices(i), 2.0 * self.spread * self.library.freedom_of(i))
        return active

    def _scene(self, chosen: list[int]) -> Scene:
        return Scene(self.data, self._active(chosen), self.sigma)

    def _worth(self, chosen: list[int]) -> float:
        kinds = [self.library.hypotheses[i].effect for i in chosen]
        twice = 6.0 * (len(kinds) - len(set(kinds)))
        return self._scene(chosen).evidence(ROWS) + sum(self.prior[i] - PRICE for i in chosen) - twice

    def _gains(self, chosen: list[int]) -> np.ndarray:
        everything = range(len(self.library.hypotheses))
        scored = self._scene(chosen).score(self.library.places, [self.library.freedom_of(k) for k in everything], ROWS)
        return np.array([s.gain for s in scored]) + self.prior

    def _certainty(self, chosen: list[int]) -> list[float]:
        worth = self._worth(chosen)
        return [worth - self._worth(chosen[:p] + chosen[p + 1 :]) for p in range(len(chosen))]

    def _result(self, chosen: list[int]) -> Decomposition:
        scene = self._scene(chosen)
        b = scene.coefficients()
        worth = self._certainty(chosen)
        parts, start, total = [], 1, np.full_like(self.y, b[0])
        for i, certainty in zip(chosen, worth, strict=True):
            columns = self.library.block(i, self.recording, self.rows)
            weights = b[start : start + columns.shape[1]]
            start += columns.shape[1]
            cores = self.library.cores[i]
            core, slack = columns[:, :cores] @ weights[:cores], columns[:, cores:] @ weights[cores:]
            total = total + core + slack
            parts.append(Part(self.library.hypotheses[i], i, core - core.mean(), slack - slack.mean(), certainty))
        rest = self.y - total
        return Decomposition(tuple(parts), float(np.std(rest) / self.spread), rest)
