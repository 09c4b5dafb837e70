"""Effects that act only in some runs, on one stretch of an axis or for some time (partial effects).

Products of a hypothesis' columns are formed by group (a run, a stretch, an interval); every union of
neighbouring groups is then scored without another pass over the rows.
"""

from __future__ import annotations

import dataclasses
import itertools
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from errpipe.diagnosis.evidence import Scene, averaged
from errpipe.diagnosis.hypotheses import LEVEL, Hypothesis, Library, columns_of, has_level, scaled
from errpipe.diagnosis.search import Search
from errpipe.domain.recording import Recording
from errpipe.drivers.motion import axes, position, position_name
from errpipe.terms import NEVER

LEADERS = 24  # hypotheses tried as partial,
EACH, IN_FULL = 2, 8  # at most this many of each effect, out of this many scored with all their columns
ON_A_STRETCH = ("geometric", "reversal", "servo", "friction")
ELSEWHERE = 4.0  # log odds against an effect that is unlikely on a stretch: a bed warms in places
BINS = 14  # equal stretches of an axis or of time; unions of neighbours are tried as one part
FINER = 8  # subdivisions of a stretch, used to refine the ends of a part
MOST = 12  # parts that are refined and passed to the search
LEAST = 0.16  # smallest share of the rows in a part, and outside it, unless it is a run: fewer rows are events
BETTER = 7.0  # log Bayes factor by which a part must exceed its own effect on all rows,
MENDING = 0.05  # plus this share of its log Bayes factor: a part may only correct the textbook form,
DEPARTING = 0.02  # and share by which it must exceed any other effect, which may depart from its textbook form


@dataclass(frozen=True)
class Groups:
    """A partition of the selected rows: group of each row, and the names of unions of groups.

    values: of the column that the groups are ranges of, shape (rows,); evenly: ranges are of equal length, else hold
    equally many rows; finest: the number of ranges as narrow as the narrowest, for the penalty.
    """

    code: np.ndarray
    count: int
    kind: str  # "runs" or a column's name
    labels: tuple[str, ...] = ()
    edges: tuple[float, ...] = ()
    values: np.ndarray | None = None
    evenly: bool = True
    finest: int = 0

    @classmethod
    def along(cls, name: str, values: np.ndarray, edges: np.ndarray, evenly: bool, finest: int) -> Groups:
        """Ranges of a column between edges."""
        code = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, edges.size - 2)
        return cls(code, edges.size - 1, name, (), tuple(edges), values, evenly, finest)

    def finer(self, members: tuple[int, ...]) -> Groups:
        """Narrower ranges around both ends of a union."""
        assert self.values is not None
        cuts = [self.edges[0], self.edges[-1]]
        for end in (members[0], members[-1] + 1):
            low, high = self.edges[max(end - 1, 0)], self.edges[min(end + 1, self.count)]
            near = self.values[(self.values >= low) & (self.values <= high)]
            ends = [low, high] if self.evenly or not near.size else near
            cuts.extend(np.quantile(ends, np.linspace(0.0, 1.0, 2 * FINER + 1)))
        finest = min(FINER * self.finest, self.values.size)
        return Groups.along(self.kind, self.values, np.unique(cuts), self.evenly, finest)

    def mask(self, members: tuple[int, ...]) -> tuple:
        """The mask of a hypothesis that acts in these groups."""
        if self.kind == "runs":
            return ("runs", tuple(self.labels[m] for m in members))
        return ("range", self.kind, self.edges[members[0]], self.edges[members[-1] + 1])

    def choices(self) -> list[tuple[int, ...]]:
        """Unions tried: neighbours, with enough rows inside and outside unless they are runs; of runs also any two."""
        out = [tuple(range(a, b)) for a in range(self.count) for b in range(a + 1, self.count + 1)]
        if self.kind != "runs":
            share = [(self.rows[1][c[-1] + 1] - self.rows[1][c[0]]) / self.code.size for c in out]
            out = [c for c, inside in zip(out, share, strict=True) if LEAST <= inside <= 1.0 - LEAST]
        else:
            out += [(a, b) for a, b in itertools.combinations(range(self.count), 2) if b > a + 1]
        return [c for c in out if len(c) < self.count] or [tuple(range(self.count))]

    @cached_property
    def rows(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows, sorted by group, and the bounds of each group among them."""
        order = np.argsort(self.code, kind="stable")
        return order, np.searchsorted(self.code[order], np.arange(self.count + 1))

    @cached_property
    def priced(self) -> tuple[list[tuple[int, ...]], np.ndarray, np.ndarray]:
        """Unions tried, with the masks and penalties of `union_weights`."""
        return (choices := self.choices()), *self.union_weights(choices)

    def union_weights(self, choices: list[tuple[int, ...]]) -> tuple[np.ndarray, np.ndarray]:
        """1 where a group is in a union, shape (unions, groups), and the unions' penalties."""
        inside = [np.bincount(c, minlength=self.count) for c in choices]
        return np.array(inside, dtype=float), np.array([self.price(c) for c in choices])

    def by_rate(self, rate: np.ndarray) -> list[tuple[int, ...]]:
        """Unions of the runs in which an effect seems strongest, of either sign."""
        if self.kind != "runs":
            return []
        order = np.argsort(rate)
        ends = [order[:k] for k in range(3, self.count)] + [order[k:] for k in range(1, self.count - 2)]
        return [tuple(sorted(int(g) for g in end)) for end in ends]

    def price(self, members: tuple[int, ...]) -> float:
        """Log of the number of unions of this kind that could have been chosen."""
        if len(members) == 2 or members == tuple(range(members[0], members[-1] + 1)):
            return float(np.log(max((self.finest or self.count) ** 2 - 1, 1)))
        return float(self.count * np.log(2.0))


@dataclass(frozen=True)
class Part:
    """A hypothesis in a union of groups: log Bayes factor minus the penalty for choosing them, without prior odds."""

    gain: float
    index: int
    groups: Groups
    members: tuple[int, ...]
    price: float


def partitions(recording: Recording, rows: np.ndarray) -> list[Groups]:
    """Runs, stretches of each axis, and of time."""
    out = []
    run = recording.run_codes()[rows]
    codes = np.unique(run)
    if 2 <= codes.size <= 40:
        labels = tuple(recording.run_labels()[c] for c in codes)
        out.append(Groups(np.searchsorted(codes, run), codes.size, "runs", labels))
    along = {position_name(recording, axis): position(recording, axis)[rows] for axis in axes(recording)}
    clock = recording.name("time")
    if clock is not None and np.all(np.diff(recording.time()[rows]) >= 0):
        along[clock] = recording.time()[rows]
    for name, x in along.items():
        if np.unique(x).size >= BINS // 2 and x.max() > x.min():
            parts = np.linspace(0.0, 1.0, BINS + 1)  # for time, equal row counts: pauses are unknown
            edges = np.unique(np.quantile(x if name == clock else [x.min(), x.max()], parts))
            out.append(Groups.along(name, x, edges, name != clock, edges.size - 1))
    return out


def add_parts(search: Search, recording: Recording, rows: np.ndarray, alone: np.ndarray) -> bool:
    """Extend the library with partial hypotheses that exceed their own effect on all rows clearly, and all others.

    Every effect is also tried in place of the best one: within one run or stretch many effects are collinear.
    """
    library, clock = search.library, recording.name("time")
    possible = search.prior > 0.5 * NEVER
    everywhere = np.array([not h.terms[0].misread for h in library.hypotheses]) & possible
    whole = np.where(everywhere, alone - search.prior, 0.0)
    own = {library.hypotheses[i].effect: whole[i] for i in search.best_of_each(whole, whole.size, "effect")}
    shown = [h.terms[0].misread and h.terms[0].log_prior_odds() > 0 for h in library.hypotheses]  # by the readings
    seen = (alone - search.prior).max(initial=0.0, where=possible & shown)
    least = {e: max(12.0, (1 + DEPARTING) * whole.max(), (1 + MENDING) * max(g, seen) + BETTER) for e, g in own.items()}
    scene = search.scene([])
    basis = np.linalg.solve(
        scene.chol, library.table.whitened.T[scene.active.index]
    ).T.copy()  # (rows, m): projector's root
    parts: list[Part] = []
    for groups in partitions(recording, rows):
        gain = np.where(_possible(search, groups.kind, clock), alone, -np.inf)
        tried = [_best_part(search, scene, basis, i, groups, clock) for i in _best_few(search, gain, LEADERS)]
        parts += tried + _best_of_each_effect(search, scene, basis, tried, clock)
    for p in _best_parts(parts, search):
        for _ in range(2 if p.groups.kind != "runs" else 0):
            parts.append(p := _best_part(search, scene, basis, p.index, p.groups.finer(p.members), clock))
    best = _best_parts([p for p in parts if p.gain > least[library.hypotheses[p.index].effect]], search)
    best += _best_of_each_effect(search, scene, basis, best, clock)
    each = {(p.index, p.groups.mask(p.members)): p for p in best}
    return sum(_extend(library, search, recording, rows, p) for p in each.values()) > 0


def _best_parts(parts: list[Part], search: Search) -> list[Part]:
    """The best parts: one of each hypothesis along each input, a few of each effect."""
    out: dict[tuple[int, str], Part] = {}
    for p in sorted(parts, key=lambda p: -p.gain):
        effects = [search.library.hypotheses[i].effect for i, _ in out]
        if effects.count(search.library.hypotheses[p.index].effect) < EACH:
            out.setdefault((p.index, p.groups.kind), p)
    return list(out.values())[:MOST]


def _best_of_each_effect(search: Search, scene: Scene, basis, parts: list[Part], clock: str | None) -> list[Part]:
    """The best hypotheses of each effect where the best part acts: sensor or lag may differ from those on all rows."""
    if not parts:
        return []
    part, library = max(parts, key=lambda p: p.gain), search.library
    inside, kind = np.flatnonzero(np.isin(part.groups.code, part.members)), part.groups.kind
    y, N, tried = search.data.y[inside], basis[inside], np.flatnonzero(_possible(search, kind, clock)).tolist()
    for textbook, each in ((True, IN_FULL), (False, EACH)):
        gain = np.full(len(library.hypotheses), -np.inf)
        for i in tried:
            places, freedom = _places(library, i, kind, textbook)
            W = library.table.whitened.T[places].take(inside, axis=1)
            B = W @ N
            S, s = (W @ W.T - B @ B.T) * freedom * freedom[:, None], (W @ y - B @ scene.half) * freedom
            gain[i] = averaged(S[None], s[None, :, None], np.array([scene.Q]), scene.n)[0, 0] - part.price
        tried = _best_few(search, gain + search.prior, 0, each)
    return [dataclasses.replace(part, gain=float(gain[i]), index=i) for i in tried]


def _possible(search: Search, kind: str, clock: str | None) -> np.ndarray:
    """Which hypotheses may act only in some groups of this kind, shape (hypotheses,)."""
    may = [may_act_in_some_groups(h, kind, clock) and not h.mask for h in search.library.hypotheses]
    return np.array(may) & (search.prior > 0.5 * NEVER)


def _best_few(search: Search, gain: np.ndarray, leaders: int, each: int = EACH) -> list[int]:
    """The best `leaders` by gain, and the best few of each effect."""
    out: list[int] = []
    count = dict.fromkeys({h.effect for h in search.library.hypotheses}, 0)
    for index in search.best_of_each(gain, gain.size):
        effect = search.library.hypotheses[index].effect
        if np.isfinite(gain[index]) and (len(out) < leaders or count[effect] < each):
            out.append(index)
            count[effect] += 1
    return out


def may_act_in_some_groups(h: Hypothesis, kind: str, clock: str | None) -> bool:
    """Can this effect act in some groups of this kind and not in others?"""
    term = h.terms[0]
    if kind == "runs" or term.in_part != "anywhere":
        return kind == "runs" and term.in_part != "never"
    if getattr(term, "radial", False) and term.family == "reversal":
        return False  # a step close to a reversal is a spike
    return kind == clock or depends_on_position(h, kind) or term.family == "thermal"


def depends_on_position(h: Hypothesis, axis: str) -> bool:
    """Does this effect depend on the position along an axis?"""
    return axis in h.drivers or h.terms[0].family in ON_A_STRETCH or "axis" in type(h.terms[0]).model_fields


def _places(library: Library, index: int, kind: str, textbook: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Columns of a partial hypothesis in the table, and their freedoms; optionally of its textbook form only."""
    upto = library.cores[index] if textbook else None
    places, freedom = library.places[index][:upto], library.freedoms[index][:upto]
    if has_level(library.hypotheses[index], kind):
        return np.r_[places, library.datum], np.r_[freedom, LEVEL]
    return places, freedom


def _best_part(search: Search, scene: Scene, basis, index: int, groups: Groups, clock: str | None) -> Part:
    """The union of groups in which a hypothesis explains most."""
    library, y, (order, upto) = search.library, search.data.y, groups.rows
    places, freedom = _places(library, index, groups.kind)
    whole, cuts = library.table.whitened.T[places].take(order, axis=1), upto[1:-1]
    pieces = zip(np.split(whole, cuts, axis=1), np.split(basis[order], cuts), np.split(y[order], cuts), strict=True)
    products = [(W @ W.T, (W @ N).T, W @ v) for W, N, v in pieces]
    S, B, s = (np.array(of_each_group) for of_each_group in zip(*products, strict=True))
    S, B, s = S * freedom * freedom[:, None], B * freedom, s * freedom
    choices, member, price = groups.priced
    rate = (s[:, 0] - B[:, :, 0] @ scene.half) / np.maximum(S[:, 0, 0], 1e-300)
    if more := groups.by_rate(rate):
        choices, (others, prices) = choices + more, groups.union_weights(more)
        member, price = np.concatenate([member, others]), np.r_[price, prices]
    Bc = np.tensordot(member, B, 1)
    Sc = np.tensordot(member, S, 1) - Bc.transpose(0, 2, 1) @ Bc
    sc = member @ s - np.einsum("cmk,m->ck", Bc, scene.half)
    elsewhere = groups.kind not in ("runs", clock) and not depends_on_position(library.hypotheses[index], groups.kind)
    price = price + (ELSEWHERE if elsewhere else 0.0)
    gain = averaged(Sc, sc[:, :, None], np.array([scene.Q]), scene.n)[:, 0] - price
    best = int(np.argmax(gain))
    return Part(float(gain[best]), index, groups, choices[best], float(price[best]))


def _extend(library: Library, search: Search, recording: Recording, rows, part: Part) -> bool:
    whole = library.hypotheses[part.index]
    h = dataclasses.replace(whole, mask=part.groups.mask(part.members), prior=whole.prior - part.price)
    core, slack, rel = columns_of(h, recording)
    made = scaled(core[rows], slack[rows], rel)
    if made is not None:
        library.extend([(h, made, core.shape[1])])
        search.prior = np.r_[search.prior, search.prior[part.index] - part.price]
    return made is not None
