"""Effects that act only in some runs, on one stretch of an axis or for a while.

Products of a hypothesis' columns are formed group by group (a run, a stretch, a while); every union of
neighbouring groups is then scored without touching the rows again.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from errpipe.diagnosis.evidence import averaged
from errpipe.diagnosis.hypotheses import Hypothesis, Library, columns_of, scaled
from errpipe.diagnosis.search import Search
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, position, position_name
from errpipe.terms import NEVER

LEADERS = 24  # hypotheses tried in part,
EACH = 2  # and at most so many of each effect
ON_A_STRETCH = ("geometric", "reversal", "servo", "friction")
ELSEWHERE = 4.0  # log odds against any other on a stretch of an axis: a bed warms in places
BINS = 14  # equal stretches of an axis or of time, neighbours of which are tried as one part
FEW = 4  # columns up to which a part is tried with its slack columns
BETTER = 7.0  # log Bayes factor by which a part must beat every whole,
MENDING = 0.05  # plus this share of the best whole's log Bayes factor: a part may only correct the textbook form


@dataclass(frozen=True)
class Groups:
    """A partition of the judged rows: group of each row, and what a union of groups is called."""

    code: np.ndarray
    count: int
    kind: str  # "runs" or a column's name
    labels: tuple[str, ...] = ()
    edges: tuple[float, ...] = ()

    def mask(self, members: tuple[int, ...]) -> tuple:
        """The mask of a hypothesis that acts in these groups."""
        if self.kind == "runs":
            return ("runs", tuple(self.labels[m] for m in members))
        return ("range", self.kind, self.edges[members[0]], self.edges[members[-1] + 1])

    def choices(self) -> list[tuple[int, ...]]:
        """Unions tried: neighbours; of runs also any two."""
        out = [tuple(range(a, b)) for a in range(self.count) for b in range(a + 1, self.count + 1)]
        if self.kind == "runs":
            out += [(a, b) for a, b in itertools.combinations(range(self.count), 2) if b > a + 1]
        return [c for c in out if len(c) < self.count]

    @cached_property
    def priced(self) -> tuple[list[tuple[int, ...]], np.ndarray, np.ndarray]:
        """Unions tried, which groups are in each (unions, groups), and their prices."""
        choices = self.choices()
        return choices, self.members(choices), np.array([self.price(c) for c in choices])

    def members(self, choices: list[tuple[int, ...]]) -> np.ndarray:
        """1 where a group is in a union, shape (unions, groups)."""
        out = np.zeros((len(choices), self.count))
        for c, members in enumerate(choices):
            out[c, list(members)] = 1.0
        return out

    def by_rate(self, rate: np.ndarray) -> list[tuple[int, ...]]:
        """Unions of the runs in which an effect seems strongest, one way or the other."""
        if self.kind != "runs":
            return []
        order = np.argsort(rate)
        ends = [order[:k] for k in range(3, self.count)] + [order[k:] for k in range(1, self.count - 2)]
        return [tuple(sorted(int(g) for g in end)) for end in ends]

    def price(self, members: tuple[int, ...]) -> float:
        """Log of the number of unions of this kind that could have been chosen."""
        neighbours = members == tuple(range(members[0], members[-1] + 1))
        if neighbours or len(members) == 2:
            return float(np.log(self.count * (self.count + 1) - self.count - 1))
        return float(self.count * np.log(2.0))


def partitions(recording: Recording, rows: np.ndarray) -> list[Groups]:
    """Runs (three or more), stretches of each axis, and of time."""
    out = []
    run = recording.run_codes()[rows]
    codes = np.unique(run)
    if 3 <= codes.size <= 40:
        labels = tuple(recording.run_labels()[c] for c in codes)
        out.append(Groups(np.searchsorted(codes, run), codes.size, "runs", labels))
    along = {position_name(recording, axis): position(recording, axis)[rows] for axis in axes(recording)}
    clock = recording.name("time")
    if clock is not None and np.all(np.diff(recording.time()[rows]) >= 0):
        along[clock] = recording.time()[rows]
    for name, x in along.items():
        if np.unique(x).size >= BINS // 2 and x.max() > x.min():
            edges = np.linspace(x.min(), x.max(), BINS + 1)
            if name == clock:  # as many rows in each: nothing is known of pauses
                edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, BINS + 1)))
            code = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, edges.size - 2)
            out.append(Groups(code, edges.size - 1, name, (), tuple(edges)))
    return out


def add_parts(search: Search, recording: Recording, rows: np.ndarray, alone: np.ndarray) -> list[int]:
    """Extend the library with hypotheses in part that beat every whole; returns their indices.

    The other candidates are tried in the best one's place too: within one run or stretch many effects are collinear.
    """
    library, clock = search.library, recording.name("time")
    shortlist = candidates(search, alone)
    everywhere = np.array([not h.terms[0].misread for h in library.hypotheses]) & (search.prior > 0.5 * NEVER)
    whole = float(np.max(np.where(everywhere, alone - search.prior, 0.0)))
    parts: list[tuple[float, int, Groups, tuple[int, ...]]] = []
    scene = search.scene([])
    basis = np.linalg.solve(scene.chol, library.table.W[:, scene.active.index].T)  # (m, rows): projector's root
    y = search.data.y
    for groups in partitions(recording, rows):
        order = np.argsort(groups.code, kind="stable")
        edges = np.searchsorted(groups.code[order], np.arange(groups.count + 1))
        for index in shortlist:
            h = library.hypotheses[index]
            if not may_act_in_part(h, groups.kind, clock):
                continue
            W = library.table.W[:, library.places[index]] * library.freedom_of(index)
            W = W if W.shape[1] <= FEW else W[:, : library.cores[index]]
            odds = 0.0 if groups.kind in ("runs", clock) or on_a_stretch(h, groups.kind) else -ELSEWHERE
            gain, members = _best_part(scene, basis, y, W, groups, order, edges) or (-np.inf, ())
            if gain + odds > max(whole + BETTER + MENDING * whole, 12.0):
                parts.append((gain + odds, index, groups, members))
    parts.sort(key=lambda p: -p[0])
    fresh = dict.fromkeys((index, groups.mask(members)) for _gain, index, groups, members in parts[:8])
    for _gain, _index, groups, members in parts[:1]:
        tried = [i for i in shortlist if may_act_in_part(library.hypotheses[i], groups.kind, clock)]
        fresh |= dict.fromkeys((i, groups.mask(members)) for i in tried)
    made = [_extend(library, search, recording, rows, index, mask) for index, mask in fresh]
    return [i for i in made if i is not None]


def candidates(search: Search, alone: np.ndarray) -> list[int]:
    """Hypotheses tried in part: the best as a whole, and the best few of each effect."""
    library = search.library
    out: list[int] = []
    count = dict.fromkeys({h.effect for h in library.hypotheses}, 0)
    for index in search.best_of_each_key(alone, len(library.hypotheses)):
        h = library.hypotheses[index]
        if h.terms[0].in_part == "never" or h.mask or alone[index] < -1e5:
            continue
        if len(out) < LEADERS or count[h.effect] < EACH:
            out.append(index)
            count[h.effect] += 1
    return out


def may_act_in_part(h: Hypothesis, kind: str, clock: str | None) -> bool:
    """Can this effect act in some groups of this kind and not in others?"""
    if kind == "runs":
        return True
    term = h.terms[0]
    if term.in_part == "runs":
        return False
    if getattr(term, "radial", False) and term.family == "reversal":
        return False  # a step close to a reversal is a spike
    return kind == clock or on_a_stretch(h, kind) or term.family == "thermal"


def on_a_stretch(h: Hypothesis, axis: str) -> bool:
    """Has this effect to do with a place along an axis?"""
    term = h.terms[0]
    return axis in h.drivers or term.family in ON_A_STRETCH or "axis" in type(term).model_fields


def _best_part(scene, basis, y, W, groups: Groups, order, edges) -> tuple[float, tuple[int, ...]] | None:
    """The union of groups in which the core explains most, and its log Bayes factor less the price of choosing."""
    k = W.shape[1]
    S = np.zeros((groups.count, k, k))
    B = np.zeros((groups.count, basis.shape[0], k))
    s = np.zeros((groups.count, k))
    for g in range(groups.count):
        r = order[edges[g] : edges[g + 1]]
        S[g], B[g], s[g] = W[r].T @ W[r], basis[:, r] @ W[r], W[r].T @ y[r]
    choices, member, price = groups.priced
    if not choices:
        return None
    seen = s[:, 0] - np.einsum("gm,m->g", B[:, :, 0], scene.half)
    rate = seen / np.maximum(S[:, 0, 0], 1e-300)
    more = groups.by_rate(rate)
    if more:
        choices = choices + more
        member = np.concatenate([member, groups.members(more)])
        price = np.r_[price, [groups.price(c) for c in more]]
    Bc = np.tensordot(member, B, 1)
    Sc = np.tensordot(member, S, 1) - Bc.transpose(0, 2, 1) @ Bc
    sc = member @ s - np.einsum("cmk,m->ck", Bc, scene.half)
    gain = averaged(Sc, sc[:, :, None], np.array([scene.Q]), scene.n)[:, 0] - price
    best = int(np.argmax(gain))
    return float(gain[best]), choices[best]


def _extend(library: Library, search: Search, recording: Recording, rows, index: int, mask: tuple) -> int | None:
    h = dataclasses.replace(library.hypotheses[index], mask=mask, prior=library.hypotheses[index].prior - 5.0)
    core, slack, rel = columns_of(h, recording)
    made = scaled(core[rows], slack[rows], rel)
    if made is None:
        return None
    prior = search.prior[index] - 5.0
    library.extend([(h, made, core.shape[1])])
    search.prior = np.r_[search.prior, prior]
    return len(library.hypotheses) - 1
