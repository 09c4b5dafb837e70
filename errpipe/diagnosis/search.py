"""Stepwise search for the effects that explain the mismatch beyond a recalibration, alone and in pairs."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from errpipe.diagnosis.evidence import ActiveSet, Data, Scene, textbook_penalty, textbook_share
from errpipe.diagnosis.hypotheses import Hypothesis, Library

MISSING = 10.0  # threshold: log Bayes factor of the first finding
MORE = 10.0  # and for each further finding
MOST = 2  # largest number of findings; a third would mostly correct the textbook form of the other two
SHARE_OF_FIRST = 0.03  # a further finding must reach this share of the first one's gain, for the same reason,
MOST_PRICE = 25.0  # but never more than this
SHORTLIST = 10  # first findings tried
BETTER = 6.0  # log Bayes factor given the others from which an effect replaces another
AS_LIKELY = 4.0  # log Bayes factor that a simpler effect may lose (generators, seeds 12201 to 14112), and
TIED = 2.0  # one with fewer inputs and as many parameters,
OWN_FORM = 0.5  # if its textbook form makes up this share of it (by judgement): departures are no simpler effect
MAX_EXCHANGES = 4  # effects tried in place of each finding
FINALISTS, MAX_LOSS = 4, 25.0  # explanations compared jointly at the end, and their largest log evidence below the best


@dataclass(frozen=True)
class Accepted:
    """One accepted hypothesis: size in noise rms, gain = its log Bayes factor given the others."""

    index: int
    hypothesis: Hypothesis
    size: float
    gain: float


class Scores(NamedTuple):
    """Log Bayes factors of candidates, and best-fitting sizes, shape (candidates,)."""

    gain: np.ndarray
    size: np.ndarray


@dataclass(frozen=True)
class Explanation:
    """Accepted hypotheses, strongest first; gain of every hypothesis alone, shape (hypotheses,)."""

    accepted: tuple[Accepted, ...]
    alone: np.ndarray

    def chosen(self) -> list[tuple[int, float]]:
        """Index and size of each accepted hypothesis."""
        return [(f.index, f.size) for f in self.accepted]


class Search:
    """The search on one response with its nuisances and a noise level."""

    def __init__(
        self,
        library: Library,
        data: Data,
        nuisance: ActiveSet,
        sigma: float,
        prior: np.ndarray,
        threshold: float,
        threshold_more: float,
        rows: float | None = None,
    ):
        self.library, self.data, self.nuisance, self.sigma, self.prior = library, data, nuisance, sigma, prior
        self.most = MOST
        self.weighed = True  # do priors limit the gains? Not those that held-out rows have confirmed
        self.rows = rows  # effective number of rows, if they are correlated
        self.threshold, self.threshold_more = threshold, threshold_more

    def explain(self, starts: int = SHORTLIST) -> Explanation:
        """Forward from each of the best starts, joint re-tuning, backward pruning."""
        scored = self.score([])
        alone = scored.gain + self.prior
        if not alone.size or alone.max() < self.threshold:
            return Explanation((), alone)
        tried: dict[tuple, tuple[float, list[tuple[int, float]]]] = {}
        firsts = [k for k in self.best_of_each(alone, starts) if alone[k] >= 0.3 * alone.max() - 5]
        self.data.table.form_products(np.concatenate([self.library.places[k] for k in firsts]))
        for first in firsts:
            chosen, total = self._forward([(first, float(scored.size[first]))], alone[first])
            keys = tuple(sorted((self.library.hypotheses[i].key for i, _ in chosen), key=str))
            if keys not in tried or total > tried[keys][0]:
                tried[keys] = (total, chosen)
        ranked = sorted(tried.values(), key=lambda t: -t[0])
        finalists = [self.tune(c) for total, c in ranked[:FINALISTS] if total > ranked[0][0] - MAX_LOSS]
        return Explanation(self.accepted(self.exchanged(max(finalists, key=self.joint))), alone)

    def exchanged(self, chosen: list[tuple[int, float]]) -> list[tuple[int, float]]:
        """Exchange step: replace each finding by another effect while the joint evidence grows."""
        worth = self.joint(chosen)
        for _ in range(2):
            before = worth
            for place in range(len(chosen)):
                others = chosen[:place] + chosen[place + 1 :]
                for i, size in self._instead(others, chosen[place][0]):
                    other = self.tune([*others[:place], (i, size), *others[place:]])
                    if self._improves(other, chosen, place, worth):
                        chosen, worth = other, self.joint(other)
            if worth == before:
                break
        return chosen

    def _improves(self, other: list[tuple[int, float]], chosen, place: int, worth: float) -> bool:
        """Is the exchange better: clearly so given the others, else in the joint evidence?"""
        more = self._with_candidate(other, place) - self._with_candidate(chosen, place)
        return more > 0 if abs(more) > BETTER else self.joint(other) > worth + 0.1

    def _with_candidate(self, chosen: list[tuple[int, float]], place: int) -> float:
        """Gain of one member given all the others."""
        i = chosen[place][0]
        return float(self.score(chosen[:place] + chosen[place + 1 :], [i]).gain[0] + self.prior[i])

    def _instead(self, others: list[tuple[int, float]], given_up: int) -> list[tuple[int, float]]:
        """The best hypotheses given the others, each effect once, except the dropped one."""
        scored, every = self.score(others), self.library.hypotheses
        taken = {every[i].effect for i, _ in others} | {every[given_up].effect}
        best = self.best_of_each(scored.gain + self.prior, MAX_EXCHANGES + len(taken), "effect")
        return [(i, float(scored.size[i])) for i in best if every[i].effect not in taken][:MAX_EXCHANGES]

    def accepted(self, chosen: list[tuple[int, float]]) -> tuple[Accepted, ...]:
        """The findings of a set of hypotheses, strongest first."""
        out = []
        for place, (i, _) in enumerate(chosen):
            s = self.score(chosen[:place] + chosen[place + 1 :], [i])
            out.append(Accepted(i, self.library.hypotheses[i], float(s.size[0]), float(s.gain[0] + self.prior[i])))
        return tuple(sorted(out, key=lambda f: -f.gain))

    def rivals(self, accepted: tuple[Accepted, ...], k: int) -> list[tuple[str, float, int]]:
        """Other effects in place of finding k: (effect, log Bayes factor by which it loses, hypothesis)."""
        others = [(f.index, f.size) for j, f in enumerate(accepted) if j != k]
        gain = self.score(others).gain + self.prior
        firsts = self.best_of_each(gain, gain.size, "effect")
        best = {self.library.hypotheses[i].effect: (float(gain[i]), i) for i in firsts}
        own = max(best.pop(accepted[k].hypothesis.effect)[0], accepted[k].gain)
        return [(e, own - g, i) for e, (g, i) in best.items()]

    def prefer_simpler(self, accepted: tuple[Accepted, ...]) -> tuple[Accepted, ...]:
        """The findings, each replaced by a simpler effect of the same inputs if that is as likely.

        Linear coefficients are integrated over; non-linear parameters are the best of many without penalty. With as
        many parameters, an effect of fewer inputs is simpler: a slope independent of temperature is no expansion.
        """
        for k, f in enumerate(accepted):
            taken, h = {g.hypothesis.effect for g in accepted}, f.hypothesis
            for effect, lost, i in self.rivals(accepted, k):
                other = self.library.hypotheses[i]
                inside, fewer = set(other.drivers) <= set(h.drivers), len(h.nonlinear[0]) - len(other.nonlinear[0])
                within = AS_LIKELY if fewer > 0 and len(other.drivers) == len(h.drivers) else TIED
                simpler = fewer > 0 or (fewer == 0 and len(other.drivers) < len(h.drivers))
                if effect not in taken and lost < within and other.mask == h.mask and inside and simpler:
                    chosen = [(g.index, g.size) for g in accepted]
                    tuned = self.tune([*chosen[:k], (i, f.size), *chosen[k + 1 :]])
                    if self.form_share(tuned, k) >= OWN_FORM:
                        return self.accepted(tuned)
        return accepted

    def form_share(self, chosen: list[tuple[int, float]], place: int) -> float:
        """Share of the textbook form in the contribution of one of the chosen hypotheses."""
        b, sizes = self.scene(chosen).coefficients(), [self.library.places[i].size for i, _ in chosen]
        first, index = self.nuisance.index.size + sum(sizes[:place]), chosen[place][0]
        return float(textbook_share(b[first : first + sizes[place]], self.library.cores[index]))

    def evidence(self, chosen: list[tuple[int, float]]) -> float:
        """Log evidence of the nuisances' priors with these hypotheses included, up to a constant."""
        return self.scene(chosen).evidence(self.rows) + sum(float(self.prior[i]) for i, _ in chosen)

    def joint(self, chosen: list[tuple[int, float]]) -> float:
        """Log Bayes factor of a whole explanation minus the cost of its findings, in the most favourable order."""
        orders = [chosen, chosen[::-1]] if len(chosen) > 1 else [chosen]
        return float(np.mean([self._in_order(order) for order in orders]))

    def _in_order(self, chosen: list[tuple[int, float]]) -> float:
        total = 0.0
        for place, (i, _) in enumerate(chosen):
            gain = float(self.score(chosen[:place], [i]).gain[0] + self.prior[i])
            total += gain - (self._price(total) if place else self.threshold)
        return total

    def _price(self, total: float) -> float:
        """Threshold on the log Bayes factor of a further finding, given findings that total `total`."""
        return min(self.threshold_more + SHARE_OF_FIRST * max(total, 0.0), MOST_PRICE)

    def active(self, chosen: list[tuple[int, float]]) -> ActiveSet:
        """Nuisances and chosen hypotheses with their sizes."""
        active = self.nuisance
        for i, size in chosen:
            active = active.plus(self.library.places[i], 2.0 * max(size, 3.0) * self.sigma * self.library.freedoms[i])
        return active

    @property
    def noise(self) -> float:
        """Noise rms for the priors, scaled up if the effective number of rows is smaller."""
        return self.sigma * float(np.sqrt(self.data.n / self.rows)) if self.rows and self.weighed else self.sigma

    def scene(self, chosen: list[tuple[int, float]]) -> Scene:
        """The response with these hypotheses included."""
        return Scene(self.data, self.active(chosen), self.noise)

    def score(self, chosen: list[tuple[int, float]], candidates: list[int] | None = None) -> Scores:
        """Gain and size of each candidate (None: every hypothesis) if added."""
        scene, listed = self.scene(chosen), self.library.listed
        which = listed.every if candidates is None else np.array(candidates)
        gain, size, core = scene.scores(listed, which, self.rows)
        gain = gain - textbook_penalty(core)
        known = np.flatnonzero(np.isfinite(self.library.gain_sd[which]))
        if known.size:
            at = np.array([self.library.places[k][0] for k in which[known]])
            unit = np.array([self.library.scales[k][0] for k in which[known]])
            gain[known] = scene.exactly(at, unit, self.library.gain_sd[which[known]] * unit, self.rows)
            size[known] = unit / self.sigma
        return Scores(gain, size)

    def best_of_each(self, gain: np.ndarray, most: int, what: Literal["key", "effect"] = "key") -> list[int]:
        """The best hypothesis of each key or effect, best first."""
        best: dict[Any, int] = {}
        for i in np.argsort(-gain):
            if len(best) == most:
                break
            best.setdefault(getattr(self.library.hypotheses[i], what), int(i))
        return list(best.values())

    def _forward(self, chosen, total):
        chosen = list(chosen)
        while len(chosen) < self.most:
            more = self.score(chosen)
            gain = more.gain + self.prior
            taken = {self.library.hypotheses[i].effect for i, _ in chosen}
            gain[[h.effect in taken for h in self.library.hypotheses]] = -np.inf
            k = int(np.argmax(gain))
            price = self._price(total)
            if gain[k] < price:
                break
            chosen.append((k, float(more.size[k])))
            total += gain[k] - price
        return chosen, total

    def tune(self, chosen: list[tuple[int, float]]) -> list[tuple[int, float]]:
        """Move each member to the best point of its own grid, given the others."""
        chosen = list(chosen)
        for _ in range(2):
            before = [i for i, _ in chosen]
            for place, (i, _) in enumerate(chosen):
                same = self.library.family(i)
                scored = self.score(chosen[:place] + chosen[place + 1 :], same)
                k = int(np.argmax(scored.gain))
                chosen[place] = (same[k], float(scored.size[k]))
            if [i for i, _ in chosen] == before:
                break
        return chosen


def converged(
    library, data, nuisance, prior, noise_estimate, rows=None, most=MOST, weighed=True
) -> tuple[Search, Explanation]:
    """Repeat the search until the noise level agrees with the residual rms."""
    sigma = noise_estimate
    for _ in range(4):
        search = Search(library, data, nuisance, sigma, prior, MISSING, MORE, rows)
        search.most, search.weighed = most, weighed
        explanation = search.explain()
        residual_rms = search.scene(explanation.chosen()).rms()
        if abs(residual_rms / sigma - 1) < 0.03:
            break
        sigma = max(residual_rms, 1e-9)
    return search, explanation
