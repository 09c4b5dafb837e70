"""The largest size of an expansion over all positions, and a bound of it: branch and bound with interval arithmetic.

Between knots an expansion is linear in each position and in each unknown, so it is largest at knots with every unknown
at -1 or 1. Over one or two axes all knots are tried and the bound is reached. Over more, boxes of positions are bounded
(the lowest and highest value of each part over a box, for every choice of signs) and halved where the bound is largest.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from errpipe.tables.expansion import MISSED, Terms

MAX_SIGNED_UNKNOWNS = 8  # unknowns of which every choice of signs is tried; with more the sizes are added up
MAX_CELLS = 4_000_000  # values of a surface over two axes that are held at once
MAX_BOXES = 40_000  # of one halving: about 0.2 s
CLOSE = 1.02  # bound over size that is good enough to stop
ROUNDING = 1e-9  # of the sum of all sizes: what floating point adds


@dataclass(frozen=True)
class Maximum:
    """bound: no state is beyond it; reached: the size at the worst state that was tried."""

    bound: float
    reached: float


class _Part:
    """Summands with the same unknowns over the same axes: one surface, or a sum of products where it would be large."""

    def __init__(self, axes: tuple[str, ...], terms: Terms, key: int, knots: Mapping[str, np.ndarray]):
        self.axes, self.key, self.terms = axes, key, terms
        self.levels: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.surface: np.ndarray | None = None
        shape = [knots[a].size for a in axes]
        if len(axes) <= 2 and math.prod(shape) <= MAX_CELLS:
            self.surface = np.zeros(shape)
            for x in terms:
                own = np.full((), x.factor)
                for axis in axes:
                    own = np.multiply.outer(own, x.curves[axis])
                self.surface = self.surface + own

    def at(self, index: np.ndarray, places: list[int]) -> np.ndarray:
        """Values at knots; index (boxes, axes of the expansion), places: columns of this part's axes."""
        if self.surface is not None:
            return self.surface[tuple(index[:, p] for p in places)] + np.zeros(len(index))
        total = np.zeros(len(index))
        for x in self.terms:
            values = [x.curves[a][index[:, p]] for a, p in zip(self.axes, places, strict=True)]
            total += x.factor * np.prod(values, axis=0)
        return total

    def over(self, level: int, box: np.ndarray, places: list[int]) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest value over boxes (boxes, axes of the expansion) of a level."""
        if self.surface is not None:
            if level not in self.levels:
                self.levels[level] = _ranges(self.surface, level)
            where = tuple(box[:, p] for p in places)
            low, high = self.levels[level]
            return low[where] + np.zeros(len(box)), high[where] + np.zeros(len(box))
        low, high = np.zeros(len(box)), np.zeros(len(box))
        for x in self.terms:
            a, b = np.full(len(box), x.factor), np.full(len(box), x.factor)
            for axis, p in zip(self.axes, places, strict=True):
                c, d = (v[box[:, p]] for v in _ranges(x.curves[axis], level))
                corners = (a * c, a * d, b * c, b * d)
                a, b = np.minimum.reduce(corners), np.maximum.reduce(corners)
            low, high = low + a, high + b
        return low, high


def _edges(knots: int, level: int) -> np.ndarray:
    """First knot of each of 2^level ranges, and the last knot."""
    return (np.arange(2**level + 1) * (knots - 1)) >> level


def _ranges(values: np.ndarray, level: int) -> tuple[np.ndarray, np.ndarray]:
    """Lowest and highest value over every box of a level: both ends of each range belong to it."""
    low = high = values
    for axis in range(values.ndim):
        edges = _edges(values.shape[axis], level)
        low = np.minimum(np.minimum.reduceat(low, edges[:-1], axis), np.take(low, edges[1:], axis))
        high = np.maximum(np.maximum.reduceat(high, edges[:-1], axis), np.take(high, edges[1:], axis))
    return low, high


class _Search:
    """An expansion, sorted: parts by unknowns and axes, signs of the unknowns."""

    def __init__(self, terms: Terms, knots: Mapping[str, np.ndarray]):
        self.axes = sorted({a for x in terms for a, v in x.curves.items()})
        self.knots = [knots[a].size for a in self.axes]
        keys = sorted({x.unknowns for x in terms} | {()})
        groups: dict[tuple[int, tuple[str, ...]], Terms] = {}
        for x in terms:
            groups.setdefault((keys.index(x.unknowns), tuple(sorted(x.curves))), []).append(x)
        self.parts = [_Part(axes, members, key, knots) for (key, axes), members in groups.items()]
        self.places = [[self.axes.index(a) for a in part.axes] for part in self.parts]
        known = sorted({u for key in keys for u in key if not u.startswith(MISSED)})
        signed = [not any(u.startswith(MISSED) for u in key) for key in keys]
        if len(known) > MAX_SIGNED_UNKNOWNS:
            known, signed = [], [key == () for key in keys]
        self.signed = np.array(signed)
        rows = [dict(zip(known, s, strict=True)) for s in product((1.0, -1.0), repeat=len(known))]
        main = [key for key, is_main in zip(keys, signed, strict=True) if is_main]
        self.signs = np.array([[math.prod(row[u] for u in key) for key in main] for row in rows])
        self.signs = np.unique(self.signs, axis=0)

    def size(self, index: np.ndarray) -> np.ndarray:
        """Largest size at knots over all unknowns; index (points, axes)."""
        values = np.zeros((len(self.signed), len(index)))
        for part, places in zip(self.parts, self.places, strict=True):
            values[part.key] += part.at(index, places)
        return np.abs(self.signs @ values[self.signed]).max(axis=0) + np.abs(values[~self.signed]).sum(axis=0)

    def bound(self, level: int, box: np.ndarray) -> np.ndarray:
        """A bound over each box of a level; box (boxes, axes)."""
        low, high = np.zeros((2, len(self.signed), len(box)))
        for part, places in zip(self.parts, self.places, strict=True):
            a, b = part.over(level, box, places)
            low[part.key] += a
            high[part.key] += b
        plus, minus = np.maximum(self.signs, 0), np.minimum(self.signs, 0)
        up = plus @ high[self.signed] + minus @ low[self.signed]
        down = plus @ low[self.signed] + minus @ high[self.signed]
        loose = np.maximum(np.abs(low[~self.signed]), np.abs(high[~self.signed])).sum(axis=0)
        return np.maximum(np.abs(up), np.abs(down)).max(axis=0) + loose


def largest(terms: Terms, knots: Mapping[str, np.ndarray]) -> Maximum:
    """Largest size of an expansion over the knots of its axes and all unknowns."""
    every = sum(abs(x.factor) * math.prod(float(np.abs(v).max()) for v in x.curves.values()) for x in terms)
    if every == 0.0:
        return Maximum(0.0, 0.0)
    search = _Search([x for x in terms if x.factor], knots)
    if math.prod(search.knots) * len(search.signed) <= MAX_CELLS:
        grid = np.meshgrid(*(np.arange(n) for n in search.knots), indexing="ij")
        index = np.stack([g.ravel() for g in grid], axis=1) if grid else np.zeros((1, 0), dtype=int)
        reached = float(search.size(index).max())
        return Maximum(reached + ROUNDING * every, reached)
    maximum = _branch(search)
    return Maximum(maximum.bound + ROUNDING * every, maximum.reached)


def _branch(search: _Search) -> Maximum:
    """Boxes are halved along every axis while some may hold more than what was reached."""
    axes, reached, kept = len(search.axes), 0.0, 0.0
    box = np.zeros((1, axes), dtype=np.int64)
    halves = np.array(list(product((0, 1), repeat=axes)))
    deepest = math.ceil(math.log2(max(search.knots)))
    for level in range(deepest + 1):
        edges = [_edges(n, level) for n in search.knots]
        corners = [np.stack([e[box[:, k] + end[k]] for k, e in enumerate(edges)], axis=1) for end in halves]
        sizes = np.stack([search.size(at) for at in corners])
        reached = max(reached, float(sizes.max()))
        # one cell is linear in each position, so its corners are its bound
        bound = sizes.max(axis=0) if level == deepest else search.bound(level, box)
        order = np.argsort(-bound, kind="stable")
        order = order[bound[order] > CLOSE * reached]
        if order.size == 0:
            return Maximum(max(kept, CLOSE * reached), reached)
        tracked = max(1, MAX_BOXES // 2**axes)
        kept = max(kept, float(bound[order[tracked:]].max(initial=0.0)))
        last = float(bound[order[0]])
        if kept >= last:
            break
        box = (2 * box[order[:tracked], None, :] + halves).reshape(-1, axes)
    return Maximum(max(kept, last, CLOSE * reached), reached)
