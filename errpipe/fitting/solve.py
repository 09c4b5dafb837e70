"""Solvers for problems that are linear in their parameters: least squares, ridge, robust, penalised, with priors.

A problem is `design @ coefficients = response`. Columns are scaled to unit length before anything is
decomposed, and all solvers use an orthogonal decomposition of the design itself, never
its normal equations: squaring the condition number loses half of the digits.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg import solve_triangular
from threadpoolctl import ThreadpoolController

from errpipe.fitting.parallel import WhileAnyInside

HUBER = 1.345  # 95 % efficiency on normal noise (Huber 1981)
TUKEY = 4.685  # the same for the biweight (Beaton and Tukey 1974)
MAD = 1.4826  # median absolute deviation -> standard deviation of normal noise
LOWEST_RANK = 1e-11  # of the largest scaled pivot; below it a direction is rounding
MAX_ROUNDS = 60  # of reweighting (by judgement)
REML_STEPS = 80  # upper limit for the strengths of penalties; a few dozen suffice


@dataclass(frozen=True)
class Solution:
    """coefficients: shape (p,). inverse: (design' W design + penalty)^-1, shape (p, p). weights: shape (n,)."""

    coefficients: np.ndarray
    residual: np.ndarray
    inverse: np.ndarray
    weights: np.ndarray
    degrees: float  # effective number of parameters
    rank: int
    strength: tuple[float, ...] = ()  # of ridge or of each penalty
    loss: str = ""  # of a robust solution: "huber" or "tukey"


@dataclass(frozen=True)
class Prior:
    """Prior of a parameter: `column` has the mean `value` and the standard deviation `spread`."""

    column: int
    value: float
    spread: float


@cache
def _controller() -> ThreadpoolController:
    return ThreadpoolController()


# Linear algebra on one thread: with two the last bits change from run to run.
one_thread = WhileAnyInside(lambda: _controller().limit(limits=1, user_api="blas").restore_original_limits)


@one_thread()
def least_squares(
    design: np.ndarray,
    response: np.ndarray,
    *,
    weights: np.ndarray | None = None,
    penalty: np.ndarray | None = None,
    priors: Sequence[Prior] = (),
    noise: float = 1.0,
) -> Solution:
    """Weighted least squares by QR, with a quadratic penalty and priors as further rows.

    design: (n, p); response: (n,); weights: (n,), 1 where not given; penalty: (p, p), positive semi-definite;
    noise: standard deviation of the response's noise, which weights the priors. A direction that the
    design does not determine gets the smallest coefficients (then rank < p).
    """
    stacked, right = design, response
    if weights is not None:
        stacked, right = design * np.sqrt(weights)[:, None], response * np.sqrt(weights)
    extra, target = _further_rows(design.shape[1], penalty, priors, noise)
    if target.size:
        stacked, right = np.vstack([stacked, extra]), np.r_[right, target]
    stacked = np.ascontiguousarray(stacked)  # bit-identical sums of squares for any memory layout
    coefficients, inverse, rank, leverage = _solve(stacked, right, response.size)
    used = np.ones(response.size) if weights is None else weights
    return Solution(coefficients, response - design @ coefficients, inverse, used, leverage, rank)


def _further_rows(columns: int, penalty, priors: Sequence[Prior], noise: float) -> tuple[np.ndarray, np.ndarray]:
    rows, right = [np.empty((0, columns))], [np.empty(0)]
    if penalty is not None:
        rows.append(penalty_rows(penalty))
        right.append(np.zeros(rows[-1].shape[0]))
    for prior in priors:
        row = np.zeros((1, columns))
        row[0, prior.column] = noise / prior.spread
        rows.append(row)
        right.append(np.array([noise * prior.value / prior.spread]))
    return np.vstack(rows), np.concatenate(right)


def penalty_rows(penalty: np.ndarray) -> np.ndarray:
    """Rows whose squares sum to the quadratic form, shape (rank, p), for columns of whatever units."""
    size = np.sqrt(np.diag(penalty))
    size = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(penalty / np.outer(size, size))
    keep = values > 1e-12 * max(values.max(), 1e-300)
    return np.sqrt(values[keep])[:, None] * vectors[:, keep].T * size


def _solve(stacked: np.ndarray, right: np.ndarray, rows: int) -> tuple[np.ndarray, np.ndarray, int, float]:
    length = np.sqrt(np.sum(stacked**2, axis=0))
    length[length == 0] = 1.0
    q, r = np.linalg.qr(stacked / length)
    pivots = np.abs(np.diag(r))
    if r.shape[0] == r.shape[1] and pivots.size and pivots.min() > LOWEST_RANK * pivots.max():
        inner = solve_triangular(r, np.eye(r.shape[0]))
        scaled, rank = inner @ (q.T @ right), r.shape[0]
    else:
        u, s, vt = np.linalg.svd(stacked / length, full_matrices=False)
        keep = s > LOWEST_RANK * max(s.max(initial=0.0), 1e-300)
        inner = vt[keep].T / s[keep]
        scaled, rank, q = inner @ (u[:, keep].T @ right), int(keep.sum()), u[:, keep]
    leverage = float(np.sum(q[:rows] ** 2))
    return scaled / length, (inner @ inner.T) / np.outer(length, length), rank, leverage


def scale_of(residual: np.ndarray, degrees: float) -> float:
    """Robust standard deviation of a residual that `degrees` parameters were fitted to."""
    spread = MAD * float(np.median(np.abs(residual - np.median(residual))))
    return spread * np.sqrt(residual.size / max(residual.size - degrees, 1.0))


@one_thread()
def robust(
    design: np.ndarray,
    response: np.ndarray,
    *,
    penalty: np.ndarray | None = None,
    priors: Sequence[Prior] = (),
    loss: str = "tukey",
) -> Solution:
    """Iteratively reweighted least squares: Huber's for a start, then Tukey's biweight, which rejects gross outliers.

    loss: "huber" or "tukey". The biweight keeps the scale of Huber's iterations (like MM-estimates): a scale that
    followed it would shrink onto the most consistent rows. `weights` of the solution are those of the last iteration.
    """
    solution = least_squares(design, response, penalty=penalty, priors=priors)
    least = 1e-12 * (1e-300 + np.abs(response).max())
    scale = max(scale_of(solution.residual, solution.degrees), least)
    for stage in ("huber",) if loss == "huber" else ("huber", "tukey"):
        for _ in range(MAX_ROUNDS):
            weights = row_weights(solution.residual / scale, stage)
            new = least_squares(design, response, weights=weights, penalty=penalty, priors=priors, noise=scale)
            moved = np.abs(new.residual - solution.residual).max(initial=0.0)
            solution = new
            if moved < 1e-6 * scale:
                break
            if stage == "huber":
                scale = max(scale_of(solution.residual, solution.degrees), least)
    return replace(solution, loss=loss)


def row_weights(standard: np.ndarray, loss: str) -> np.ndarray:
    """Weight of each row from its residual in standard deviations."""
    size = np.abs(standard)
    if loss == "huber":
        return np.minimum(1.0, HUBER / np.maximum(size, 1e-300))
    inside = np.clip(1.0 - (size / TUKEY) ** 2, 0.0, None)
    return np.maximum(inside**2, 1e-8)  # not quite zero: the design keeps its rank


def influence(standard: np.ndarray, loss: str) -> tuple[np.ndarray, np.ndarray]:
    """psi and its derivative at residuals in standard deviations."""
    if loss == "huber":
        inside = np.abs(standard) <= HUBER
        return np.clip(standard, -HUBER, HUBER), inside.astype(float)
    u = standard / TUKEY
    inside = np.abs(u) < 1.0
    return np.where(inside, standard * (1 - u**2) ** 2, 0.0), np.where(inside, (1 - u**2) * (1 - 5 * u**2), 0.0)


@one_thread()
def ridge(
    design: np.ndarray, response: np.ndarray, shrunk: np.ndarray, *, folds: Sequence[tuple[np.ndarray, np.ndarray]] = ()
) -> Solution:
    """Ridge on the columns marked in `shrunk`, its strength by held-out groups (folds) or else by GCV.

    Columns are weighted by their own spread, so that units do not matter. Among the strengths within one standard error
    of the best (at most 10 %), the strongest is used: a minimum over folds is optimistic.
    """
    spread = spread_of(design, shrunk)
    unit = np.diag(np.where(shrunk, spread**2, 0.0)) * response.size
    tried = np.logspace(-7, 2, 28)
    folds = [fold for fold in folds if fold[0].any() and fold[1].any()]  # a run without a sensor has no usable row
    if folds:
        scores = np.array([_fold_errors(design, response, unit * s, folds) for s in tried])
        mean = scores.mean(axis=1)
        best = int(np.argmin(mean))
        slack = float(np.std(scores[best] - scores[-1], ddof=1) / np.sqrt(len(folds))) if len(folds) > 1 else 0.0
        slack = min(slack, 0.1 * mean[best])
        chosen = float(tried[np.flatnonzero(mean <= mean[best] + slack).max()])
    else:
        chosen = float(tried[int(np.argmin([_gcv(design, response, unit * s) for s in tried]))])
    solution = least_squares(design, response, penalty=unit * chosen)
    return replace(solution, strength=(chosen,))


def spread_of(design: np.ndarray, shrunk: np.ndarray) -> np.ndarray:
    """Rms of each penalised column after projection on the other columns, shape (p,); 1 for unpenalised ones."""
    free = design[:, ~shrunk]
    left = design - free @ np.linalg.lstsq(free, design, rcond=None)[0] if free.size else design
    return np.where(shrunk, np.sqrt(np.mean(left**2, axis=0)), 1.0)


def _fold_errors(design, response, penalty, folds) -> list[float]:
    errors = []
    for train, test in folds:
        solution = least_squares(
            design[train], response[train], penalty=penalty * (np.count_nonzero(train) / len(train))
        )
        errors.append(float(np.mean((response[test] - design[test] @ solution.coefficients) ** 2)))
    return errors


def _gcv(design, response, penalty) -> float:
    solution = least_squares(design, response, penalty=penalty)
    n = response.size
    return float(np.mean(solution.residual**2) / (1.0 - solution.degrees / n) ** 2)


@one_thread()
def penalised(
    design: np.ndarray,
    response: np.ndarray,
    penalties: Sequence[np.ndarray],
    *,
    weights: np.ndarray | None = None,
    priors: Sequence[Prior] = (),
    rows_effective: float | None = None,
) -> Solution:
    """Least squares with one strength per penalty, each chosen by restricted likelihood (REML).

    penalties: (p, p) matrices that touch disjoint columns. Update of Wood and Fasiolo 2017 (Fellner-Schall):
    each step multiplies a strength by (rank/strength - tr(V S)) sigma^2 / (b' S b). rows_effective: if the
    noise is autocorrelated, fewer effective rows, else the curve would follow the noise.
    """
    used = np.ones(response.size) if weights is None else weights
    root = np.sqrt(used)
    small, left = _reduced(design * root[:, None], response * root)
    rows = float(np.sum(used > 1e-6))
    share = 1.0 if rows_effective is None else min(1.0, rows_effective / response.size)
    size = max(float(np.sum(small[:, :-1] ** 2)), 1e-300)
    strengths = np.array([1e-3 * size / max(np.trace(p), 1e-300) for p in penalties])
    ranks = np.array([np.linalg.matrix_rank(p) for p in penalties])
    degrees = np.inf
    for _ in range(REML_STEPS):
        total = sum(s * p for s, p in zip(strengths, penalties, strict=True))
        solution = least_squares(small[:, :-1], small[:, -1], penalty=total, priors=priors)
        variance = (left + float(np.sum(solution.residual**2))) / max(rows - solution.degrees, 1.0) / share
        for j, p in enumerate(penalties):
            rough = float(solution.coefficients @ p @ solution.coefficients)
            fitted = max(ranks[j] - strengths[j] * float(np.sum(solution.inverse * p)), 1e-12)
            strengths[j] = np.clip(fitted * variance / max(rough, 1e-300), 1e-10, 1e12)
        if abs(solution.degrees - degrees) < 1e-4 * solution.degrees:
            break
        degrees = solution.degrees
    total = sum(s * p for s, p in zip(strengths, penalties, strict=True))
    solution = least_squares(design, response, weights=weights, penalty=total, priors=priors)
    return replace(solution, strength=tuple(map(float, strengths)))


def _reduced(design: np.ndarray, response: np.ndarray) -> tuple[np.ndarray, float]:
    """Triangular factor of the design with the rotated response appended, and the residual sum of squares."""
    q, r = np.linalg.qr(design)
    rotated = q.T @ response
    return np.column_stack([r, rotated]), max(float(response @ response - rotated @ rotated), 0.0)
