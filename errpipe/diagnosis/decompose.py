"""Decomposition of the noiseless simulated signal into its effects: each can have its own gain in a recalibration."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from errpipe.diagnosis.evidence import SIZES, ActiveSet, Data, Scene, textbook_penalty, textbook_share
from errpipe.diagnosis.hypotheses import Hypothesis, Library
from errpipe.domain.recording import Recording

MOST_PARTS = 5  # largest number of effects in a simulation; one response cannot distinguish more
BEAM = 6  # beam width: states kept at each step
ALTERNATIVES = 3  # decompositions returned
MOST_MOVES = 6  # effects tried as an addition to a state
MAX_BEHIND = 40.0  # log evidence below the best down to which a decomposition is returned
COARSE = (0.004, 0.08)  # misfit of textbook forms relative to the signal; used as the noise level
FINE = 0.03  # mean square of the misfit over that of COARSE, below which it is no evidence and the priors alone decide
MATTERS = 20.0  # log evidence: an unexplained part counts if a tenth of it exceeds the measurement noise over all rows
ROWS = (60.0, 0.025)  # effective number of rows (offset, per row): the residual is correlated misfit, not noise
DOUBTS = 2  # directions of largest posterior variance kept for each part
LEAST_PART = 0.01  # rms over the signal's below which an effect is taken to be absent from the signal
PRICE = 6.0  # log prior odds against each part
NO_SUM = 0.3  # residual rms over the signal's, from which the signal is no sum of effects: gains of
# such parts would imitate whatever is missing (of 59 generated simulations one exceeds 0.15)
EARNED = 5.0  # log Bayes factor of a part: with less, its gain and uncertain directions would imitate what is missing
Chosen = list[tuple[int, float]]  # hypotheses with their sizes, in units of COARSE


@dataclass(frozen=True)
class Part:
    """One effect in the simulated signal: contributions of its form (`core`) and departures on the selected rows.

    certainty: its log Bayes factor given the other parts; doubt: directions in which its contribution is uncertain
    because the other parts can compensate, shape (rows, directions), one standard deviation each; reference: what
    its form contains beyond the textbook's, such as a slope if a rise is counted from another value.
    """

    hypothesis: Hypothesis
    index: int
    core: np.ndarray
    slack: np.ndarray
    certainty: float
    doubt: np.ndarray
    reference: np.ndarray

    @property
    def contribution(self) -> np.ndarray:
        """Core and departures together."""
        return self.core + self.slack


@dataclass(frozen=True)
class Decomposition:
    """parts; residual rms relative to the simulated signal's; the residual, shape (rows,).

    worth: log evidence, comparable with other decompositions of the same signal; plain: the signal is a constant
    gain on each sensor, so that each of these gains may be off, gains near zero as much as the others.
    """

    parts: tuple[Part, ...]
    leftover: float
    rest: np.ndarray
    worth: float
    plain: bool = False


Held = Callable[[Decomposition, int], list[Decomposition]]


def decompose(
    simulated: np.ndarray, library: Library, recording: Recording, rows: np.ndarray, noise: float
) -> tuple[list[Decomposition], Held | None]:
    """Parts are added, exchanged and dropped while the evidence grows; returns the likeliest sets of effects first.

    noise: rms of the measurement noise, below which the decomposition stops. Also returned: a function that tests
    whether the signal may contain a certain effect, None if it contains no physics.
    """
    run = library.table.run
    if _one_level_per_run(simulated, run):
        return [Decomposition((), 1.0, simulated - simulated.mean(), 0.0)], None
    work = _Work(simulated, library, recording, rows, noise)
    return work.run(), work.holding if not work.constant else None


def _one_level_per_run(simulated: np.ndarray, run: np.ndarray) -> bool:
    """Is the signal constant within each of several runs? Such a table of levels is not decomposed."""
    _, inside, count = np.unique(run, return_inverse=True, return_counts=True)
    level = np.bincount(inside, simulated) / count
    return count.size > 1 and bool(np.std(simulated - level[inside]) <= PLAIN * np.std(simulated))


PLAIN = 1e-4  # residual rms over the signal's, up to which the signal is a sum of sensor readings


def static(
    simulated: np.ndarray, library: Library, raw: Recording, recording: Recording, rows: np.ndarray
) -> Decomposition | None:
    """Decomposition of a signal that is a constant gain on each of several sensors' readings, or None.

    A stepwise search would replace collinear sensors by fewer and wrong parts.
    raw: the recording as read, from which the simulation was made; recording: with sensors smoothed.
    """
    own = {h.drivers[0]: i for i, h in enumerate(library.hypotheses) if h.terms[0].one_sensor and not h.mask}
    read = {name: raw.array(name)[rows] for name in own}
    known = np.all([np.isfinite(v) for v in read.values()], axis=0) & np.ones(rows.size, dtype=bool)
    spread = float(np.std(simulated))
    if known.sum() < max(0.5 * rows.size, 10 * len(own)) or spread <= 0:
        return None
    for name in tuple(own):  # drop sensors without which the residual does not grow
        others = [read[n][known] for n in own if n != name]
        if others and _gains(others, simulated[known])[1] < PLAIN * spread:
            del own[name]
    if len(own) < 2:
        return None
    gains, residual_rms = _gains([read[n][known] for n in own], simulated[known])
    if residual_rms > PLAIN * spread:
        return None
    parts = []
    for (name, index), gain in zip(own.items(), gains, strict=True):
        reading = recording.array(name)[rows]
        without = _gains([read[n][known] for n in own if n != name], simulated[known])[1]
        certainty = 0.5 * rows.size * np.log(max(without, 1e-300) / max(residual_rms, 1e-6 * spread))
        core = gain * (reading - reading.mean())
        zeros, sure = np.zeros_like(core), np.zeros((core.size, 0))
        parts.append(Part(library.hypotheses[index], index, core, zeros, float(certainty), sure, zeros))
    unexplained = simulated - simulated.mean() - np.sum([p.core for p in parts], axis=0)
    return Decomposition(tuple(parts), residual_rms / spread, unexplained, 0.0, plain=True)


def _gains(columns: list[np.ndarray], values: np.ndarray) -> tuple[np.ndarray, float]:
    """Least-squares gains of centred columns, and the residual rms."""
    centred = np.column_stack([c - c.mean() for c in columns])
    target = values - values.mean()
    gains = np.linalg.lstsq(centred, target, rcond=None)[0]
    return gains, float(np.std(target - centred @ gains))


class _Work:
    def __init__(self, simulated: np.ndarray, library: Library, recording: Recording, rows: np.ndarray, noise: float):
        self.y, self.library = simulated - simulated.mean(), library
        self.recording, self.rows = recording, rows
        self.spread = float(self.y.std())
        coarse = MATTERS * noise / np.sqrt(rows.size)
        self.sigma = float(np.clip(coarse, COARSE[0] * self.spread, COARSE[1] * self.spread))
        self.constant = self.spread <= 1e-9 * (1 + np.abs(simulated).max())
        self.count = ROWS[0] + ROWS[1] * rows.size
        self.prior = np.array([h.terms[0].simulated_log_odds for h in library.hypotheses])
        self._promising: dict[tuple, Chosen] = {}
        self.freedom = [library.freedoms[k] for k in range(len(library.hypotheses))]

    def run(self) -> list[Decomposition]:
        if self.constant or not self.library.hypotheses:
            return [Decomposition((), 0.0, np.zeros_like(self.y), 0.0)]
        self.data = Data(self.library.table, self.y)
        beam: list[tuple[float, Chosen]] = [(self._worth([]), [])]
        visited: dict[tuple, float] = {(): beam[0][0]}
        done: set[tuple] = set()
        for _ in range(4 * MOST_PARTS):
            left = [state for _, state in beam if tuple(state) not in done]  # all moves from the others were evaluated
            done.update(tuple(state) for state in left)
            fresh = self._judged([move for state in left for move in self._moves(state)], visited)
            best = sorted([*beam, *fresh], key=lambda w: -w[0])[:BEAM]
            if [w for w, _ in best] == [w for w, _ in beam]:
                break
            beam = best
        made = [self._result(state, worth) for worth, state in self._different(beam)]
        made = [d for d in made if d.leftover < NO_SUM] or [Decomposition((), 1.0, self.y, 0.0)]
        return [d for d in made if all(p.certainty > EARNED for p in d.parts)] or made

    def holding(self, d: Decomposition, i: int) -> list[Decomposition]:
        """The likeliest decompositions that contain a hypothesis, at any of its parameters.

        It is added to the parts of a decomposition, or replaces one of them; empty if its share is zero,
        or if the signal is as likely without it.
        """
        own = self.library.family(i)
        ways = []
        for out in (None, *d.parts):
            kept = [(p.index, 1.0) for p in d.parts if p is not out and p.index not in own]
            if len(kept) < MOST_PARTS:
                states = [self._tuned([*kept, (k, 1.0)]) for k in own]
                ways.append(max(((self._worth(state), state) for state in states), key=lambda w: w[0]))
        matches = [self._result(state, worth) for worth, state in self._different(sorted(ways, key=lambda w: -w[0]))]
        sums = [(d, [p for p in d.parts if p.index in own and p.certainty > EARNED]) for d in matches]
        return [d for d, h in sums if d.leftover < NO_SUM and any(np.std(p.core) > LEAST_PART * self.spread for p in h)]

    def _different(self, beam: list[tuple[float, Chosen]]) -> list[tuple[float, Chosen]]:
        """The best state of each set of effects that is not far below the best."""
        out: dict[tuple, tuple[float, Chosen]] = {}
        for worth, state in beam:
            effects = tuple(sorted(self.library.hypotheses[i].effect for i, _ in state))
            if effects not in out and worth > beam[0][0] - MAX_BEHIND:
                out[effects] = (worth, state)
        return list(out.values())[:ALTERNATIVES]

    def _moves(self, chosen: Chosen) -> list[Chosen]:
        """States one step away: a part added, exchanged, or dropped."""
        moves: list[Chosen] = [chosen[:p] + chosen[p + 1 :] for p in range(len(chosen))]
        if len(chosen) < MOST_PARTS:
            moves += [[*chosen, k] for k in self._candidates(chosen, MOST_MOVES)]
        for p in range(len(chosen)):
            others = chosen[:p] + chosen[p + 1 :]
            moves += [[*others[:p], k, *others[p:]] for k in self._candidates(others, 5) if k[0] != chosen[p][0]]
        return moves

    def _judged(self, moves: list[Chosen], seen: dict[tuple, float]) -> list[tuple[float, Chosen]]:
        """States that were not evaluated before, with their evidence; their products are formed in one batch."""
        out = []
        together = [np.zeros(0, dtype=int), *(self.library.places[i] for move in moves for i, _ in move)]
        self.data.table.form_products(np.concatenate(together))
        for move in moves:
            name = tuple(sorted(i for i, _ in move))
            if name not in seen:
                tuned = self._tuned(move)
                seen[name] = self._worth(tuned)
                out.append((seen[name], tuned))
        return out

    def _tuned(self, chosen: Chosen) -> Chosen:
        """Sizes set to the fitted rms of each part."""
        for _ in range(2):
            b = self._scene(chosen).coefficients()[1:]
            out, start = [], 0
            for i, _size in chosen:
                core = b[start : start + self.library.cores[i]]
                start += self.freedom[i].size
                out.append((i, float(np.clip(np.sqrt(np.mean(core**2)) / self.sigma, SIZES[0], SIZES[-1]))))
            chosen = out
        return chosen

    def _candidates(self, others: Chosen, most: int) -> Chosen:
        """The most promising hypotheses given others, each effect once."""
        name = tuple(others)
        if name not in self._promising:
            self._promising[name] = self._listed(others)
        return self._promising[name][:most]

    def _listed(self, others: Chosen) -> Chosen:
        gain, size, core = self._scene(others).scores(self.library.listed, rows=self.count)
        gain = gain - textbook_penalty(core) + self.prior
        effects = {self.library.hypotheses[i].effect for i, _ in others}
        out: Chosen = []
        for k in np.argsort(-gain):
            effect = self.library.hypotheses[k].effect
            if effect not in effects:
                effects.add(effect)
                out.append((int(k), float(size[k])))
            if len(out) == MOST_MOVES:
                break
        return out

    def _scene(self, chosen: Chosen) -> Scene:
        index = [np.array([self.library.datum]), *(self.library.places[i] for i, _ in chosen)]
        sd = [np.array([np.inf]), *(size * self.sigma * self.freedom[i] for i, size in chosen)]
        return Scene(self.data, ActiveSet(np.concatenate(index), np.concatenate(sd)), self.sigma)

    def _worth(self, chosen: Chosen) -> float:
        scene = self._scene(chosen)
        b, start, price = scene.coefficients()[1:], 0, 0.0
        for i, _ in chosen:
            width = self.freedom[i].size
            share = textbook_share(b[start : start + width], self.library.cores[i])
            price += PRICE - self.prior[i] + textbook_penalty(share)
            start += width
        expected = FINE * self.y.size * self.sigma**2
        return scene.evidence(self.count) - 0.5 * self.count * np.log1p(expected / scene.Q) - price

    def _result(self, chosen: Chosen, total_worth: float) -> Decomposition:
        scene = self._scene(chosen)
        b = scene.coefficients()
        whole = self._worth(chosen)
        worth = [whole - self._worth(chosen[:p] + chosen[p + 1 :]) for p in range(len(chosen))]
        spread = scene.covariance() * self.y.size / self.count  # the residual is correlated: fewer effective rows
        parts, start, total = [], 1, np.full_like(self.y, b[0])
        for (i, _), certainty in zip(chosen, worth, strict=True):
            columns = self.library.block(i, self.recording, self.rows)
            own_columns = slice(start, start + columns.shape[1])
            weights, start = b[own_columns], own_columns.stop
            counted = self.library.hypotheses[i].terms[0].counts_from_any_reference()
            form = min((1 + counted) * self.library.cores[i], columns.shape[1])
            core, slack = columns[:, :form] @ weights[:form], columns[:, form:] @ weights[form:]
            total = total + core + slack
            doubt = _uncertain_directions(columns, spread[own_columns, own_columns])
            centred = core - core.mean(), slack - slack.mean()
            textbook = columns[:, : self.library.cores[i]] @ weights[: self.library.cores[i]]
            parts.append(Part(self.library.hypotheses[i], i, *centred, certainty, doubt, core - textbook))
        unexplained = self.y - total
        return Decomposition(tuple(parts), float(np.std(unexplained) / self.spread), unexplained, total_worth)


def _uncertain_directions(columns: np.ndarray, spread: np.ndarray) -> np.ndarray:
    """The few directions in which a part's contribution is most uncertain, shape (rows, directions)."""
    lam, U = np.linalg.eigh(0.5 * (spread + spread.T))
    ways = columns @ (U * np.sqrt(np.maximum(lam, 0.0)))
    ways = ways - ways.mean(axis=0)
    return ways[:, np.argsort(-ways.std(axis=0))[:DOUBTS]]
