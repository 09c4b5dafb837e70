"""Bayes factor of a hypothesis: ratio of marginal likelihoods with and without it, in coloured noise.

Model of a response on n rows:  y = N b + H w + e.  N holds the nuisance columns (datum, gains of what the simulation
already contains) with Gaussian priors, H a hypothesis' columns, w ~ Normal(0, (a s)^2), s the columns' relative
freedom (1 for the textbook form, less for departures from it), a its unknown size, averaged over
a grid. e is white noise with a small slowly varying share; an ARMA(1,1) filter makes it white. The noise
variance is profiled. Every column and every badly fitting size lowers the evidence.

Products of columns are formed once, on demand (`Table`): those of an active column with all others,
and those of a hypothesis' columns among themselves. Of thousands of columns a search activates a few hundred.
"""

from __future__ import annotations

import copy
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np

from errpipe.diagnosis.coloured import USUAL, Colour, recolour, whiten
from errpipe.fitting.parallel import parallel_map
from errpipe.kernels import evidence, noise

AT_ONCE = 64  # columns filtered together
WORTH = 2e-3  # s for one fold's products, from which those of the other folds are formed in two threads
MIN_TEXTBOOK_SHARE = 0.25  # threshold: below this share of its textbook form a hypothesis is penalised,
MAX_TEXTBOOK_PENALTY = 60.0  # up to this log Bayes factor at a share of 0
Copied = tuple[list[tuple[int, int]], np.ndarray]  # fingerprints of columns, and the whitened columns, shape (k, rows)
SIZES = np.geomspace(0.15, 600.0, 14)  # sizes tried, in units of the noise


def stretches(fold: np.ndarray) -> list[tuple[int, int, int]]:
    """Stretches of neighbouring rows of one fold: (first row, row after the last, fold)."""
    edges = np.r_[0, np.flatnonzero(np.diff(fold)) + 1, fold.size]
    return [(int(a), int(b), int(fold[a])) for a, b in itertools.pairwise(edges) if b > a]


class Table:
    """Whitened columns and their products, fold by fold; columns can be added, and are addressed by index.

    Blocks are read one at a time and need not exist at once; a column shared by several blocks is stored once.
    places[i] are the indices of block i's columns. Storage is allocated generously: untouched memory is free.
    """

    def __init__(self, run: np.ndarray, blocks: Iterable[np.ndarray | Copied], fold: np.ndarray, room: int = 4096):
        self.run, self.n, self.fold = run, run.size, fold
        self.colour = USUAL
        self.rows = [np.flatnonzero(fold == f) for f in range(int(fold.max()) + 1)]
        self.stretches = stretches(fold)
        self._store = np.zeros((run.size, room), order="F")
        self._seen: dict[tuple[int, int], int] = {}
        self.width = 0
        self._still = Lock()  # held while the columns change
        self._forget_products()
        self.places = [self._put(block) for block in blocks]
        self.names = list(self._seen)  # identity of each of these columns

    def _forget_products(self) -> None:
        self._at = np.full(self.width, -1)  # index among the known columns, -1: no products yet
        self._known = np.zeros(0, dtype=int)  # columns whose products with all others are known
        self._cross = np.zeros((len(self.rows) + 1, 0, self.width))  # their products, by fold, and over all rows
        self._among: dict[bytes, np.ndarray] = {}  # products of a few columns among themselves, in the same order

    def recolour(self, colour: Colour) -> None:
        """Whiten every column by another noise model, in place; signals (`Data`) must be created again."""
        with self._still:
            for k in range(0, self.width, AT_ONCE):
                columns = self._store[:, k : min(k + AT_ONCE, self.width)]
                columns[:] = recolour(columns, self.run, self.colour, colour)
            self.colour = colour
        self._forget_products()

    def truncate(self, width: int) -> None:
        """Return to the first `width` columns."""
        self.width = width
        self._forget_products()

    def form_products(self, index: np.ndarray) -> None:
        """Form the products of these columns with all others, if they do not exist yet."""
        done = self._cross.shape[2]
        if done < self.width:
            fresh = self._between(self._known, slice(done, self.width))
            self._cross = np.concatenate([self._cross, fresh], axis=2)
            self._at = np.r_[self._at, np.full(self.width - done, -1)]
        fresh = np.unique(index[self._at[index] < 0])
        if fresh.size:
            self._at[fresh] = self._known.size + np.arange(fresh.size)
            self._cross = np.concatenate([self._cross, self._between(fresh, slice(0, self.width))], axis=1)
            self._known = np.r_[self._known, fresh]

    def _between(self, index: np.ndarray, others: slice) -> np.ndarray:
        """Products of some columns with others, by fold and over all rows, shape (folds + 1, k, others)."""
        W, W_others = self.whitened, self.whitened[:, others]
        out = np.zeros((len(self.rows) + 1, index.size, W_others.shape[1]))

        def of_fold(f: int) -> None:
            for first, last in ((a, b) for a, b, of in self.stretches if of == f):
                out[f] += W[first:last, index].T @ W_others[first:last]

        parallel_map(of_fold, range(len(self.rows)), worth=WORTH)
        out[-1] = out[:-1].sum(axis=0)
        return out

    def products(self, index: np.ndarray, others: np.ndarray, without: int | None = None) -> np.ndarray:
        """Products of columns with others, shape (k, others), over all rows or those outside a fold."""
        self.form_products(index)
        at = self._at[index][:, None]
        whole = self._cross[-1][at, others]
        return whole if without is None else whole - self._cross[without][at, others]

    def products_among(self, index: np.ndarray, without: int | None = None) -> np.ndarray:
        """Products of columns among themselves, shape (k, k), over all rows or those outside a fold."""
        name = index.tobytes()
        if name not in self._among:
            W = self.whitened[:, index]
            out = np.zeros((len(self.rows) + 1, index.size, index.size))
            for first, last, f in self.stretches:
                out[f] += W[first:last].T @ W[first:last]
            out[-1] = out[:-1].sum(axis=0)
            self._among[name] = out
        parts = self._among[name]
        return parts[-1] if without is None else parts[-1] - parts[without]

    @property
    def whitened(self) -> np.ndarray:
        """Whitened columns, shape (rows, columns so far)."""
        return self._store[:, : self.width]

    def copied(self, index: np.ndarray) -> Copied | None:
        """Columns for another table of the same rows; None if these have since been whitened by another colour."""
        with self._still:
            return ([self.names[k] for k in index], self._store.T[index]) if self.colour == USUAL else None

    def _put(self, block: np.ndarray | Copied) -> np.ndarray:
        """Store a block's columns, shared ones once; return their indices."""
        copied = isinstance(block, tuple)
        names, each = block if isinstance(block, tuple) else (None, np.ascontiguousarray(block.T, dtype=float))
        where = [self._seen.setdefault(n, len(self._seen)) for n in names or map(noise.fingerprint, each)]
        fresh = [where.index(at) for at in range(self.width, len(self._seen))]
        self.add((each if len(fresh) == len(each) else each[fresh]).T, copied)
        return np.array(where, dtype=int)

    def add(self, columns: np.ndarray, whitened: bool = False) -> np.ndarray:
        """Append columns (rows, k); return their indices."""
        first, last = self.width, self.width + columns.shape[1]
        if last > self._store.shape[1]:
            grown = np.zeros((self.n, 2 * last), order="F")
            grown[:, :first] = self.whitened
            self._store = grown
        if whitened:
            self._store[:, first:last] = columns
        else:
            each = np.ascontiguousarray(columns.T, dtype=float)
            noise.whiten_each(self.run, each, self._store.T[first:last], *self.colour.filter())
        self.width = last
        return np.arange(first, last)


class Data:
    """A signal to be explained: its products with the table's columns and itself, by fold (without: one held out)."""

    def __init__(self, table: Table, values: np.ndarray):
        self.table, self.y = table, whiten(values, table.run, table.colour)
        self.squares = np.array([float(self.y[r] @ self.y[r]) for r in table.rows])
        self._known = np.zeros((len(table.rows), 0))
        self._total = np.zeros(0)
        self.without: int | None = None

    def hold_out(self, fold: int) -> Data:
        """The same signal with one fold held out."""
        other = copy.copy(self)
        other.without, other._total = fold, np.zeros(0)
        return other

    @property
    def n(self) -> int:
        """Rows used."""
        return self.table.n - (0 if self.without is None else self.table.rows[self.without].size)

    @property
    def sum_of_squares(self) -> float:
        """Sum of squares."""
        return float(self.squares.sum() - (0.0 if self.without is None else self.squares[self.without]))

    def products(self) -> np.ndarray:
        """Products with all columns of the table at present."""
        done = self._known.shape[1]
        if done < self.table.width:
            fresh = np.zeros((len(self.table.rows), self.table.width - done))
            for first, last, f in self.table.stretches:
                fresh[f] += self.table.whitened[first:last, done:].T @ self.y[first:last]
            self._known = np.column_stack([self._known, fresh])
        if self._total.size != self.table.width:
            total = self._known.sum(axis=0)
            self._total = total if self.without is None else total - self._known[self.without]
        return self._total


@dataclass(frozen=True)
class ActiveSet:
    """Columns in use: indices into the table and the prior standard deviation of each (inf: free)."""

    index: np.ndarray
    sd: np.ndarray

    def plus(self, index: np.ndarray, sd: np.ndarray) -> ActiveSet:
        """These and further columns."""
        return ActiveSet(np.concatenate([self.index, index]), np.concatenate([self.sd, sd]))


class ScoredHypotheses:
    """Hypotheses that are scored repeatedly: columns (indices into the table), their freedoms, and how many of the
    columns are the textbook form."""

    def __init__(self, index: Sequence[np.ndarray], freedom: Sequence[np.ndarray], cores: Sequence[int]):
        widths = np.array([i.size for i in index], dtype=np.int64)
        self.columns = np.concatenate([np.zeros(0, dtype=np.int64), *index])
        self.freedom = np.concatenate([np.zeros(0), *freedom])
        self.cores = np.array(cores, dtype=np.int64)
        self.starts = np.r_[0, np.cumsum(widths)]
        self.places = np.r_[0, np.cumsum(widths**2)]
        self.every = np.arange(widths.size)
        self._all: tuple[np.ndarray, np.ndarray] | None = None
        self._blocks: dict[int | None, np.ndarray] = {}

    def used(self, which: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns that some hypotheses use, each once, and the position of every entry of `columns` among them."""
        if which is self.every:
            self._all = self._all or np.unique(self.columns, return_inverse=True)
            return self._all
        inside = np.concatenate([np.arange(self.starts[k], self.starts[k + 1]) for k in which])
        used, at = np.unique(self.columns[inside], return_inverse=True)
        where = np.zeros(self.columns.size, dtype=np.int64)
        where[inside] = at
        return used, where

    def blocks(self, data: Data) -> np.ndarray:
        """Products of each hypothesis' columns among themselves, times their freedoms, flattened."""
        if data.without not in self._blocks:
            made = []
            for first, last in itertools.pairwise(self.starts):
                free = self.freedom[first:last]
                made.append(
                    (data.table.products_among(self.columns[first:last], data.without) * free[:, None] * free).ravel()
                )
            self._blocks[data.without] = np.concatenate([np.zeros(0), *made])
        return self._blocks[data.without]


class Scene:
    """A signal with some active columns: coefficients, residual, and log Bayes factors of further hypotheses."""

    def __init__(self, data: Data, active: ActiveSet, sigma: float):
        self.table, self.data, self.active, self.sigma = data.table, data, active, sigma
        self.n = data.n
        i = active.index
        self.Zy_all = data.products()
        self.M = self.with_active(i)
        prior = (sigma / np.maximum(active.sd, 1e-300)) ** 2  # zero for a free column, whose sd is infinite
        self.M.flat[:: i.size + 1] += prior + 1e-11 * np.diag(self.M) + 1e-300
        self.chol = np.linalg.cholesky(self.M)
        self.half = evidence.forward(self.chol, self.Zy_all[i])
        self.Q = max(data.sum_of_squares - float(self.half @ self.half), 1e-12 * data.sum_of_squares + 1e-300)

    def with_active(self, index: np.ndarray) -> np.ndarray:
        """Products of the active columns with others, shape (active, others)."""
        return self.table.products(self.active.index, index, self.data.without)

    def coefficients(self) -> np.ndarray:
        """Posterior mean of the active columns' coefficients."""
        return evidence.backward(self.chol, self.half)

    def residual(self) -> np.ndarray:
        """Whitened residual, shape (rows,)."""
        return self.data.y - self.table.whitened[:, self.active.index] @ self.coefficients()

    def covariance(self) -> np.ndarray:
        """Posterior covariance of the coefficients."""
        inverse = np.linalg.inv(self.chol)
        return self.sigma**2 * inverse.T @ inverse

    def freedom_used(self) -> float:
        """Effective number of coefficients."""
        return float(np.trace(np.linalg.solve(self.M, self.with_active(self.active.index))))

    def rms(self) -> float:
        """Whitened residual rms, corrected for the coefficients used."""
        return float(np.sqrt(self.Q / max(self.n - self.freedom_used(), 1.0)))

    def evidence(self, rows: float | None = None) -> float:
        """Log marginal likelihood up to a constant, noise variance profiled; `rows`: effective number of rows."""
        finite = np.isfinite(self.active.sd)
        logdet = 2 * np.log(np.diag(self.chol)).sum()
        prior = 2 * np.log(np.maximum(self.active.sd[finite], 1e-300) / self.sigma).sum()
        return -0.5 * (logdet + prior) - 0.5 * (rows or self.n) * np.log(self.Q)

    def exactly(self, index: np.ndarray, value: np.ndarray, sd: np.ndarray, rows: float | None = None) -> np.ndarray:
        """Log Bayes factors of columns, each alone, with a coefficient known to be `value` within `sd`."""
        cross = self.with_active(index)
        s = evidence.project_out(self.chol, cross, self.half, self.Zy_all[index])
        own = [self.table.products_among(index[k : k + 1], self.data.without)[0, 0] for k in range(index.size)]
        S = np.array(own) - np.sum(cross**2, axis=0)
        return with_known_size(S, s, value, sd / self.sigma, self.Q, rows or self.n)

    def gains(self, index: list[np.ndarray], freedom: list[np.ndarray], rows: float | None = None) -> np.ndarray:
        """Log Bayes factors of textbook forms: columns of each (indices into the table), their freedoms."""
        return self.scores(ScoredHypotheses(index, freedom, [i.size for i in index]), rows=rows)[0]

    def scores(
        self, listed: ScoredHypotheses, which: np.ndarray | None = None, rows: float | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For listed hypotheses: log Bayes factors given the active columns, best sizes, textbook forms' shares."""
        which = listed.every if which is None else which
        used, where = listed.used(which)
        cross = self.with_active(used)
        seen = evidence.project_out(self.chol, cross, self.half, self.Zy_all[used])
        of_each = listed.starts, listed.freedom, listed.cores, listed.places, listed.blocks(self.data)
        return evidence.scores(which, where, *of_each, cross, seen, self.Q, float(rows or self.n), SIZES)


def with_known_size(S: Any, s: Any, value: Any, sd: Any, spare: Any, rows: float) -> Any:
    """Log Bayes factors of columns, each alone, with a coefficient known to be `value` within `sd` noise rms.

    S: sum of squares of each, projected off the active columns; s: products with the signals; spare: sums of squares.
    """
    rest = s - value * S  # product with the residual once `value` times the column is subtracted
    Q = spare - 2 * value * s + value**2 * S - rest**2 / (S + 1 / sd**2)
    return -0.5 * np.log1p(S * sd**2) - 0.5 * rows * np.log(np.maximum(Q, 1e-9 * spare) / spare)


def averaged(S: np.ndarray, s: np.ndarray, spare: np.ndarray, rows: float) -> np.ndarray:
    """Log Bayes factors averaged over sizes, of m hypotheses on c signals, shape (m, c).

    S (m, k, k): products of a hypothesis' columns, projected off the active ones; s (m, k, c): with the signals;
    spare (c,): the signals' sums of squares after the projection.
    """
    lam, U = np.linalg.eigh(S)
    lam = np.maximum(lam, 0.0)
    z = (U.transpose(0, 2, 1) @ s) ** 2
    weight = SIZES[:, None] ** 2 / (1.0 + SIZES[:, None] ** 2 * lam[:, None, :])  # (m, sizes, k)
    explained = weight @ z  # (m, sizes, c)
    residual_share = np.maximum(1.0 - explained / spare, 1e-9)
    price = np.log1p(SIZES[:, None] ** 2 * lam[:, None, :]).sum(axis=2)
    log_bf = -0.5 * price[:, :, None] - 0.5 * rows * np.log(residual_share)
    peak = log_bf.max(axis=1)
    return peak + np.log(np.mean(np.exp(log_bf - peak[:, None]), axis=1))


def textbook_share(coefficients: np.ndarray, cores: int | np.ndarray) -> np.ndarray:
    """Share of the contribution made by a hypothesis' first `cores` columns of unit size; (..., k) to (...,)."""
    textbook = np.arange(coefficients.shape[-1]) < np.asarray(cores)[..., None]
    core = np.abs(coefficients * textbook).sum(axis=-1)
    slack = np.sqrt((coefficients**2 * ~textbook).sum(axis=-1))
    return core / np.maximum(core + slack, 1e-300)


def textbook_penalty(share: Any) -> Any:
    """Penalty, a log Bayes factor, of a hypothesis whose textbook form has a small share."""
    return MAX_TEXTBOOK_PENALTY * np.maximum(0.0, 1.0 - share / MIN_TEXTBOOK_SHARE)
