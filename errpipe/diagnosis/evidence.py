"""Bayes factor of a hypothesis: ratio of marginal likelihoods with and without it, in coloured noise.

Model of a response on n rows:  y = N b + H w + e.  N holds nuisances (datum, gains of what the simulation
already knows) with Gaussian priors, H a hypothesis' columns, w ~ Normal(0, (a s)^2), s the columns' relative
freedom (1 for the textbook form, less for departures from it), a its unknown size, averaged over
a grid. e is white noise with a small slowly varying share; an ARMA(1,1) filter makes it white. The noise
variance is profiled. A hypothesis pays for every column and for every size that does not fit.

All products of columns are formed once (`Table`); a search then never touches the rows again.
"""

from __future__ import annotations

import copy
import hashlib
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from errpipe.diagnosis.coloured import USUAL, Colour, recolour, whiten
from errpipe.kernels import evidence

ROOM = 512  # capacity for columns besides those of the hypotheses
AT_ONCE = 64  # columns filtered together
MIN_TEXTBOOK_SHARE = 0.25  # threshold: below this share of its textbook form a hypothesis is penalised,
MAX_TEXTBOOK_PENALTY = 60.0  # up to this log Bayes factor at a share of 0
SIZES = np.geomspace(0.15, 600.0, 14)  # sizes tried, in units of the noise


def stretches(fold: np.ndarray) -> list[tuple[int, int, int]]:
    """Neighbouring rows of one fold: (first row, row after the last, fold)."""
    edges = np.r_[0, np.flatnonzero(np.diff(fold)) + 1, fold.size]
    return [(int(a), int(b), int(fold[a])) for a, b in itertools.pairwise(edges) if b > a]


class Table:
    """Whitened columns with all their products; columns can be added, and are addressed by index.

    Blocks are taken one at a time and need not exist at once; a column that several of them share is held once.
    places[i] are the indices of block i's columns. Storage is asked for generously: memory that is never written
    costs nothing.
    """

    def __init__(self, run: np.ndarray, blocks: Iterable[np.ndarray], fold: np.ndarray, room: int = 4096):
        self.run, self.n, self.fold = run, run.size, fold
        self.colour = USUAL
        self.rows = [np.flatnonzero(fold == f) for f in range(int(fold.max()) + 1)]
        self.stretches = stretches(fold)
        self._store = np.zeros((run.size, room), order="F")
        self._seen: dict[bytes, int] = {}
        self.width = 0
        self.places = [self._put(block) for block in blocks]
        self._products = np.zeros((self.width + ROOM, self.width + ROOM))
        self._multiply()

    def _multiply(self) -> None:
        """Form all products anew."""
        np.matmul(self.W.T, self.W, out=self.G)

    def recolour(self, colour: Colour) -> None:
        """Whiten every column by another model of the noise, in place; signals (`Data`) must be made again."""
        for k in range(0, self.width, AT_ONCE):
            columns = self._store[:, k : min(k + AT_ONCE, self.width)]
            columns[:] = recolour(columns, self.run, self.colour, colour)
        self.colour = colour
        self._multiply()

    def without(self, fold: int) -> np.ndarray:
        """Products of the columns over the rows outside of a fold; formed when needed, for they are as large as `G`."""
        out = self.G.copy()
        for k in range(0, self.width, 4 * AT_ONCE):
            columns = slice(k, k + 4 * AT_ONCE)
            for first, last, f in self.stretches:
                if f == fold:
                    out[k:, columns] -= self.W[first:last, k:].T @ self.W[first:last, columns]
            out[columns, k:] = out[k:, columns].T
        return out

    @property
    def G(self) -> np.ndarray:
        """Products of the columns over all rows."""
        return self._products[: self.width, : self.width]

    @property
    def W(self) -> np.ndarray:
        """Whitened columns, shape (rows, columns so far)."""
        return self._store[:, : self.width]

    def _put(self, block: np.ndarray) -> np.ndarray:
        """Store a block's columns, shared ones once; returns their indices. Products are not formed yet."""
        where: list[int] = []
        fresh: list[int] = []
        for j in range(block.shape[1]):
            column = np.ascontiguousarray(block[:, j], dtype=float)
            digest = hashlib.sha1(column.data, usedforsecurity=False).digest()  # twice as fast as blake2b here
            at = self._seen.setdefault(digest, self.width + len(fresh))
            if at == self.width + len(fresh):
                fresh.append(j)
            where.append(at)
        self._append(block[:, fresh])
        return np.array(where, dtype=int)

    def _append(self, columns: np.ndarray) -> None:
        first, last = self.width, self.width + columns.shape[1]
        if last > self._store.shape[1]:
            grown = np.zeros((self.n, 2 * last), order="F")
            grown[:, :first] = self.W
            self._store = grown
        for k in range(first, last, AT_ONCE):
            fresh = columns[:, k - first : k - first + AT_ONCE]
            self._store[:, k : min(k + AT_ONCE, last)] = whiten(fresh, self.run, self.colour)
        self.width = last

    def add(self, columns: np.ndarray) -> np.ndarray:
        """Append columns (rows, k) and form their products; returns their indices."""
        before = self.width
        self._append(columns)
        if self.width > self._products.shape[0]:
            known = self._products[:before, :before]
            self._products = np.zeros((self.width + ROOM, self.width + ROOM))
            self._products[:before, :before] = known
        self.G[:, before:] = self.W.T @ self.W[:, before:]
        self.G[before:, :before] = self.G[:before, before:].T
        return np.arange(before, self.width)


class Data:
    """A signal to be explained: its products with the table's columns and with itself, fold by fold.

    without: a fold that takes no part (held out), or None.
    """

    def __init__(self, table: Table, values: np.ndarray):
        self.table, self.y = table, whiten(values, table.run, table.colour)
        self.squares = np.array([float(self.y[r] @ self.y[r]) for r in table.rows])
        self._known = np.zeros((len(table.rows), 0))
        self._total = np.zeros(0)
        self.without: int | None = None
        self._train: np.ndarray | None = None

    def hold_out(self, fold: int) -> Data:
        """The same signal, one fold taking no part."""
        other = copy.copy(self)
        other.without, other._train, other._total = fold, None, np.zeros(0)
        return other

    @property
    def n(self) -> int:
        """Rows that take part."""
        out = 0 if self.without is None else self.table.rows[self.without].size
        return self.table.n - out

    @property
    def yy(self) -> float:
        """Sum of squares."""
        return float(self.squares.sum() - (0.0 if self.without is None else self.squares[self.without]))

    @property
    def G(self) -> np.ndarray:
        """Products of the table's columns."""
        if self.without is None:
            return self.table.G
        if self._train is None or self._train.shape[0] != self.table.width:
            self._train = self.table.without(self.without)
        return self._train

    def products(self) -> np.ndarray:
        """Products with all columns that the table holds by now."""
        done = self._known.shape[1]
        if done < self.table.width:
            fresh = np.zeros((len(self.table.rows), self.table.width - done))
            for first, last, f in self.table.stretches:
                fresh[f] += self.table.W[first:last, done:].T @ self.y[first:last]
            self._known = np.column_stack([self._known, fresh])
        if self._total.size != self.table.width:
            total = self._known.sum(axis=0)
            self._total = total if self.without is None else total - self._known[self.without]
        return self._total


@dataclass(frozen=True)
class Active:
    """Columns in use: indices into the table and the prior standard deviation of each (inf: free)."""

    index: np.ndarray
    sd: np.ndarray

    def plus(self, index: np.ndarray, sd: np.ndarray) -> Active:
        """These and further ones."""
        return Active(np.r_[self.index, index], np.r_[self.sd, sd])


NOTHING = Active(np.zeros(0, dtype=int), np.zeros(0))


class Listed:
    """Hypotheses that are scored again and again: columns (indices into the table), their freedoms, and how many of the
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
        """Columns that some hypotheses have, each once, and where among them every entry of `columns` is."""
        if which is self.every:
            self._all = self._all or np.unique(self.columns, return_inverse=True)
            return self._all
        inside = np.concatenate([np.arange(self.starts[k], self.starts[k + 1]) for k in which])
        used, at = np.unique(self.columns[inside], return_inverse=True)
        where = np.zeros(self.columns.size, dtype=np.int64)
        where[inside] = at
        return used, where

    def blocks(self, data: Data) -> np.ndarray:
        """Products of each hypothesis' columns among themselves, times their freedoms, flat."""
        if data.without not in self._blocks:
            widths = np.diff(self.starts)
            wide = np.repeat(widths, widths**2)
            place = np.arange(wide.size) - np.repeat(self.places[:-1], widths**2)
            first = np.repeat(self.starts[:-1], widths**2)
            i, j = first + place // wide, first + place % wide
            free = self.freedom[i] * self.freedom[j]
            self._blocks[data.without] = data.G[self.columns[i], self.columns[j]] * free
        return self._blocks[data.without]


@dataclass(frozen=True)
class Scored:
    """A hypothesis' log Bayes factor against the active columns alone, the size that fits best, and at that size the
    textbook form's share in what it explains."""

    gain: float
    size: float
    core: float = 1.0


class Scene:
    """A signal with some columns active: coefficients, residual, and log Bayes factors of further hypotheses."""

    def __init__(self, data: Data, active: Active, sigma: float):
        table = data.table
        self.table, self.data, self.active, self.sigma = table, data, active, sigma
        self.n = data.n
        self.G = data.G
        i = active.index
        self.Zy_all = data.products()
        self.M = self.G[i[:, None], i]
        prior = (sigma / np.maximum(active.sd, 1e-300)) ** 2  # none for a free column, whose sd is infinite
        self.M.flat[:: i.size + 1] += prior + 1e-11 * np.diag(self.M) + 1e-300
        self.chol = np.linalg.cholesky(self.M)
        self.half = evidence.forward(self.chol, self.Zy_all[i])
        self.Q = max(data.yy - float(self.half @ self.half), 1e-12 * data.yy + 1e-300)

    def coefficients(self) -> np.ndarray:
        """Posterior mean of the active columns' coefficients."""
        return evidence.backward(self.chol, self.half)

    def residual(self) -> np.ndarray:
        """Whitened residual, shape (rows,)."""
        return self.data.y - self.table.W[:, self.active.index] @ self.coefficients()

    def covariance(self) -> np.ndarray:
        """Posterior covariance of the coefficients."""
        inverse = np.linalg.inv(self.chol)
        return self.sigma**2 * inverse.T @ inverse

    def freedom_used(self) -> float:
        """Effective number of coefficients."""
        i = self.active.index
        return float(np.trace(np.linalg.solve(self.M, self.G[np.ix_(i, i)])))

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
        cross = np.ascontiguousarray(self.G[self.active.index][:, index])
        s = evidence.freed(self.chol, cross, self.half, self.Zy_all[index])
        S = self.G[index, index] - np.sum(cross**2, axis=0)
        rest = s - value * S  # product with the residual once `value` times the column is subtracted
        Q = self.Q - 2 * value * s + value**2 * S - rest**2 / (S + self.sigma**2 / sd**2)
        price = 0.5 * np.log1p(S * sd**2 / self.sigma**2)
        return -price - 0.5 * (rows or self.n) * np.log(np.maximum(Q, 1e-9 * self.Q) / self.Q)

    def score(
        self,
        slices: list[slice] | list[np.ndarray],
        freedom: list[np.ndarray],
        rows: float | None = None,
        cores: list[int] | None = None,
    ) -> list[Scored]:
        """Score hypotheses: columns of each (slice or indices into the table), their relative freedoms, and how many
        of the columns are the textbook form (None: all)."""
        index = [np.arange(s.start, s.stop) if isinstance(s, slice) else np.asarray(s) for s in slices]
        listed = Listed(index, freedom, [i.size for i in index] if cores is None else cores)
        return [Scored(float(g), float(a), float(c)) for g, a, c in zip(*self.scores(listed, rows=rows), strict=True)]

    def scores(
        self, listed: Listed, which: np.ndarray | None = None, rows: float | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As `score`, for all listed hypotheses or some: their gains, sizes, and the textbook form's shares."""
        which = listed.every if which is None else which
        used, where = listed.used(which)
        cross = np.ascontiguousarray(self.G[self.active.index][:, used])
        seen = evidence.freed(self.chol, cross, self.half, self.Zy_all[used])
        return evidence.scores(
            which,
            where,
            listed.starts,
            listed.freedom,
            listed.cores,
            listed.places,
            listed.blocks(self.data),
            cross,
            seen,
            self.Q,
            float(rows or self.n),
            SIZES,
        )

    def _log_bf(self, S: np.ndarray, s: np.ndarray, rows: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Batched: S (m, k, k), s (m, k); log Bayes factors averaged over sizes, the best size of each and the
        coefficients (m, k) at that size."""
        lam, U = np.linalg.eigh(S)
        lam = np.maximum(lam, 0.0)
        turned = np.einsum("mij,mi->mj", U, s)
        z = turned**2
        a2 = SIZES[None, :, None] ** 2
        explained = (z[:, None, :] * a2 / (1.0 + a2 * lam[:, None, :])).sum(axis=2)
        residual_squares = np.maximum(self.Q - explained, 1e-9 * self.Q)
        log_bf = -0.5 * np.log1p(a2 * lam[:, None, :]).sum(axis=2) - 0.5 * rows * np.log(residual_squares / self.Q)
        top = log_bf.argmax(axis=1)
        peak = log_bf.max(axis=1)
        mean = peak + np.log(np.mean(np.exp(log_bf - peak[:, None]), axis=1))
        at = SIZES[top][:, None] ** 2
        b = np.einsum("mij,mj->mi", U, at / (1.0 + at * lam) * turned)
        return mean, SIZES[top], b


def textbook_share(coefficients: np.ndarray, cores: int | np.ndarray) -> np.ndarray:
    """Share of a hypothesis' first `cores` columns in what its columns, all of unit size, carry; (..., k) to (...,)."""
    textbook = np.arange(coefficients.shape[-1]) < np.asarray(cores)[..., None]
    core = np.abs(coefficients * textbook).sum(axis=-1)
    slack = np.sqrt((coefficients**2 * ~textbook).sum(axis=-1))
    return core / np.maximum(core + slack, 1e-300)


def textbook_penalty(share: Any) -> Any:
    """Penalty, a log Bayes factor, of a hypothesis whose textbook form has a small share."""
    return MAX_TEXTBOOK_PENALTY * np.maximum(0.0, 1.0 - share / MIN_TEXTBOOK_SHARE)
