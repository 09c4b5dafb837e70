"""Sparse regression beside nuisances: orthogonal matching pursuit, held out by folds, parameters of columns fitted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain.driver import inputs
from errpipe.drivers.library import Candidate

DISTINCT = 0.2  # least share of a column's rms beyond the recalibration, by judgement
ALTERNATIVES = 8  # columns tried in place of a selected one, with their parameters fitted
SWEEPS = 3  # over the parameters of an equation, each fitted with the others held
SIMPLER = 0.01  # share that a parameter of 0, or a whole or half number, may leave in addition
REFINED = 0.05  # least share of the residual's variance that another parameter, or a further term, must explain


@dataclass(frozen=True)
class NuisanceColumns:
    """Nuisances estimated together: columns (rows, k), and noise over the prior standard deviation of each (k,)."""

    columns: np.ndarray
    penalty: np.ndarray


class Pursuit:
    """Products of the library's columns next to nuisances, over all rows and by fold, for repeated pursuits.

    A nuisance with a prior has one more row, which no fold holds out.
    """

    def __init__(self, library: list[Candidate], fold: np.ndarray, nuisances: NuisanceColumns):
        both = np.vstack([nuisances.columns, np.diag(nuisances.penalty)])
        u, s, _ = np.linalg.svd(both / np.linalg.norm(both, axis=0), full_matrices=False)
        self.known, self.extra = u[:, s > 1e-8 * s[0]], nuisances.penalty.size
        columns = np.column_stack([c.values - c.values.mean() for c in library])
        made = self.projected(columns)
        left, gain = np.linalg.norm(made, axis=0), np.linalg.lstsq(nuisances.columns, columns, rcond=None)[0]
        beyond = np.linalg.norm(columns - nuisances.columns @ gain, axis=0)
        kept = np.flatnonzero(beyond > DISTINCT * np.linalg.norm(columns, axis=0))
        self.library = [library[k] for k in kept]
        self.columns = made[:, kept] / left[kept] * np.array([c.weight for c in self.library])
        self.rows = [np.flatnonzero(fold == f) for f in np.unique(fold)]
        self.whole = self.columns.T @ self.columns
        self.grams = [self.whole - self.columns[r].T @ self.columns[r] for r in self.rows]

    def projected(self, values: np.ndarray) -> np.ndarray:
        """What nuisances leave of values (rows,) or (rows, k), with a row more for each nuisance."""
        longer = np.concatenate([values, np.zeros((self.extra, *values.shape[1:]))])
        return longer - self.known @ (self.known.T @ longer)

    def chosen(self, y: np.ndarray, count: int, without: int | None = None) -> list[int]:
        """Indices of the selected columns, in the order of the pursuit; y: projected; without: a fold to hold out."""
        from sklearn.linear_model import orthogonal_mp_gram

        gram, xy = self.whole, self.columns.T @ y
        if without is not None:
            gram = self.grams[without]
            xy = xy - self.columns[self.rows[without]].T @ y[self.rows[without]]
        count = min(count, xy.size)
        if count == 0:
            return []
        path = orthogonal_mp_gram(gram, xy, n_nonzero_coefs=count, return_path=True, copy_Gram=True, copy_Xy=True)
        path = np.asarray(path).reshape(xy.size, -1)
        order: list[int] = []
        for k in range(path.shape[1]):
            order += [int(j) for j in np.flatnonzero(path[:, k]) if j not in order]
        return order

    def held_out(self, y: np.ndarray, most: int) -> tuple[np.ndarray, np.ndarray]:
        """Share of the held-out variance predicted with 0 to `most` terms, and its standard error over folds."""
        squares, y = np.zeros((len(self.rows), most + 1)), self.projected(y)
        for f, test in enumerate(self.rows):
            train = np.ones(y.size, dtype=bool)
            train[test] = False
            order = self.chosen(y, most, f)
            for k in range(most + 1):
                own = np.column_stack([np.ones(y.size), self.columns[:, order[:k]]])
                b = np.linalg.lstsq(own[train], y[train], rcond=None)[0]
                squares[f, k] = float(np.sum((y[test] - own[test] @ b) ** 2))
        gained = (squares[:, :1] - squares) / max(float(squares[:, 0].mean()), 1e-300)
        return gained.mean(axis=0), gained.std(axis=0, ddof=1) / np.sqrt(len(self.rows))

    def refined(self, y: np.ndarray, count: int) -> list[Candidate]:
        """The selected columns with fitted parameters, without those that the others then replace."""
        y = self.projected(y)
        made = self._fewest(self._fitted([self.library[j] for j in self.chosen(y, count)], y), y)
        for k in range(len(made)):
            made = self._exchanged(made, k, y)
        return self._fewest(made, y)

    def _fewest(self, made: list[Candidate], y: np.ndarray) -> list[Candidate]:
        """Columns without those that the others, fitted again, replace."""
        while len(made) > 1:
            fewer = [self._fitted([*made[:k], *made[k + 1 :]], y) for k in range(len(made))]
            best = min(fewer, key=lambda columns: self._left(columns, y))
            if self._left(best, y) > (1.0 + REFINED) * self._left(made, y):
                break
            made = best
        return made

    def _exchanged(self, columns: list[Candidate], k: int, y: np.ndarray) -> list[Candidate]:
        """The columns with the k-th replaced by the best of its alternatives, if that leaves less.

        A threshold, for instance, is recognised only once it is fitted. Columns that differ in a parameter are one.
        """
        held = [c.values for c in [*columns[:k], *columns[k + 1 :]]]
        others = np.linalg.qr(self.projected(np.column_stack(held)))[0] if held else np.zeros((y.size, 0))
        own = self.columns - others @ (others.T @ self.columns)
        gained = (own.T @ y) ** 2 / np.maximum(np.sum(own**2, axis=0), 1e-300)
        kinds: dict[tuple[tuple[str, ...], str], Candidate] = {}
        for c in (self.library[j] for j in np.argsort(-gained)):
            kinds.setdefault((inputs(c.driver), re.sub(r"[-+\d.e]+", "", c.name)), c)
        put = [[*columns[:k], c, *columns[k + 1 :]] for c in list(kinds.values())[:ALTERNATIVES]]
        best = min((self._fitted(one, y) for one in put), key=lambda one: self._left(one, y))
        return best if self._left(best, y) < (1.0 - REFINED) * self._left(columns, y) else columns

    def tangents(self, columns: Sequence[Candidate]) -> np.ndarray:
        """Derivatives of columns by their fitted parameters, shape (rows, k): what is 0 or a half number is known."""
        out = [np.zeros((columns[0].values.size, 0))]
        for c in columns:
            for j, (value, (low, high)) in enumerate(zip(c.free, c.spans, strict=True)):
                if c.at is not None and value != round(2.0 * value) / 2.0:
                    step = 1e-3 * (high - low) * (1.0 if value < high - 1e-3 * (high - low) else -1.0)
                    moved = c.at(*c.free[:j], value + step, *c.free[j + 1 :])
                    out.append(((moved.values - c.values) / step)[:, None])
        return np.column_stack(out)

    def _fitted(self, columns: list[Candidate], y: np.ndarray) -> list[Candidate]:
        """The columns with their parameters fitted, from their values and from no lag, if that leaves less."""
        ends = [[0.0 if low == 0.0 else v for v, (low, _) in zip(c.free, c.spans, strict=True)] for c in columns]
        plain = [c.at(*free) if c.at else c for c, free in zip(columns, ends, strict=True)]
        best = min((self._swept(one, y) for one in (columns, plain)), key=lambda one: self._left(one, y))
        return best if self._left(best, y) < (1.0 - REFINED) * self._left(columns, y) else columns

    def _swept(self, columns: list[Candidate], y: np.ndarray) -> list[Candidate]:
        """The columns with their parameters fitted one by one."""
        for _ in range(SWEEPS):
            for k, j in [(k, j) for k, one in enumerate(columns) for j in reversed(range(len(one.free)))]:
                columns = self._at_best(columns, k, j, y)
        return columns

    def _at_best(self, columns: list[Candidate], k: int, j: int, y: np.ndarray) -> list[Candidate]:
        """The columns with the best value of the j-th parameter of the k-th one, or a plain one that is as good."""
        from scipy.optimize import minimize_scalar

        one, (low, high) = columns[k], columns[k].spans[j]
        at = one.at
        assert at is not None

        def put(value: float) -> list[Candidate]:
            return [*columns[:k], at(*one.free[:j], value, *one.free[j + 1 :]), *columns[k + 1 :]]

        def left(value: float) -> float:
            return self._left(put(value), y)

        best = minimize_scalar(left, bounds=(low, high), method="bounded", options={"xatol": 1e-3 * (high - low)})
        least = min(best.fun, self._left(columns, y))
        value = float(best.x) if best.fun == least else one.free[j]
        plain = [v for v in (0.0, round(2.0 * value) / 2.0) if low <= v <= high]
        return put(next((v for v in plain if left(v) < (1.0 + SIMPLER) * least), value))

    def _left(self, columns: Sequence[Candidate], y: np.ndarray) -> float:
        """Sum of squares that columns leave of a projected response."""
        own = self.projected(np.column_stack([c.values for c in columns]))
        return float(np.sum((y - own @ np.linalg.lstsq(own, y, rcond=None)[0]) ** 2))
