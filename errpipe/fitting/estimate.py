"""Solve one assembled problem: non-linear search, linear solve by the requested method, covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from errpipe.fitting import identifiability, lack_of_fit, separable, solve, uncertainty
from errpipe.fitting.design import Problem
from errpipe.fitting.solve import one_thread
from errpipe.fitting.spec import ModelSpec
from errpipe.fitting.statistics import rms

ROUNDS = 3  # alternations of search and robust weights; the third changes no printed digit


@dataclass(frozen=True)
class Estimate:
    """Linear coefficients (width,), non-linear values (q,), and covariance of both together (width + q squared)."""

    coefficients: np.ndarray
    nonlinear: np.ndarray
    residual: np.ndarray
    degrees: float
    strength: tuple[float, ...]
    covariance: np.ndarray = field(default_factory=lambda: np.empty((0, 0)))
    noise: uncertainty.Noise | None = None
    rows_effective: float = 0.0
    freedom: float = 0.0
    loss: str = ""  # of a robust solution


@one_thread()
def estimate(
    problem: Problem, spec: ModelSpec, *, folds: Sequence[tuple[np.ndarray, np.ndarray]] = (), intervals: bool = True
) -> Estimate:
    """Solve `problem` as `spec` asks. folds: row masks of the recording, for the strength of ridge.

    Raises NotIdentifiable if the rows cannot distinguish parameters (not for ridge, which is the remedy).
    """
    if problem.width == 0:
        return without_columns(problem.response, rms(problem.response), problem.response.size)
    priors = _priors(problem, spec)
    penalties = problem.penalties()
    if problem.unknowns:
        nonlinear, solution = _separable(problem, spec, penalties, priors, folds)
    else:
        nonlinear = np.empty(0)
        solution = _linear(problem.design(nonlinear), problem, spec, penalties, priors, folds)
    if penalties and spec.method == "linear" and solution.residual.size > 3 * solution.degrees:
        solution = _with_effective_rows(problem, nonlinear, penalties, priors, solution)
    design = problem.design(nonlinear)
    penalty = _penalty(problem, spec, penalties, solution, priors)
    if intervals and spec.method != "ridge":
        names, component = problem.names(), " and ".join(problem.components)
        identifiability.check(
            design, names, problem.recording, component=component, penalty=penalty, most=spec.most_inflation
        )
    degrees = solution.degrees + nonlinear.size
    plain = Estimate(
        solution.coefficients, nonlinear, solution.residual, degrees, solution.strength, loss=solution.loss
    )
    return _with_intervals(plain, problem, spec, design, penalty) if intervals else plain


def without_columns(response: np.ndarray, sigma: float, rows: int) -> Estimate:
    """The estimate of no term: the response (n,) is noise of standard deviation sigma, known from so many rows."""
    none, noise = np.empty(0), uncertainty.Noise(sigma, 0.0, 0.0)
    return Estimate(none, none, response, 0.0, (), np.empty((0, 0)), noise, float(rows), float(rows))


def _linear(design, problem, spec, penalties, priors, folds) -> solve.Solution:
    y = problem.response
    if spec.method == "ridge":
        return solve.ridge(design, y, _shrunk(problem), folds=[_within(problem, f) for f in folds])
    if penalties:
        solution = solve.penalised(design, y, penalties, priors=priors)
        if spec.method == "linear":
            return solution
        first = _robust(design, problem, spec, _sum(penalties, solution.strength), priors)
        solution = solve.penalised(design, y, penalties, weights=first.weights, priors=priors)
        again = _robust(design, problem, spec, _sum(penalties, solution.strength), priors)
        return replace(again, strength=solution.strength)
    if spec.method == "robust":
        return _robust(design, problem, spec, None, priors)
    first = solve.least_squares(design, y)
    if not priors:
        return first
    # priors are weighed against as few rows as are independent
    noise = uncertainty.noise_model(problem.sequence, design, first.residual, None)
    sigma = noise.sigma * float(np.sqrt(y.size / uncertainty.rows_effective(problem.sequence, noise)))
    return solve.least_squares(design, y, priors=priors, noise=sigma)


def _robust(design, problem, spec, penalty, priors) -> solve.Solution:
    """With Huber's loss, which rejects nothing, where runs repeat what the biweight would reject."""
    solution = solve.robust(design, problem.response, penalty=penalty, priors=priors, loss=spec.loss)
    if spec.loss == "huber" or not lack_of_fit.is_repeated(design, solution, problem.sequence):
        return solution
    return solve.robust(design, problem.response, penalty=penalty, priors=priors, loss="huber")


def _with_effective_rows(problem, nonlinear, penalties, priors, solution) -> solve.Solution:
    """Repeat the choice of smoothing with the effective number of rows: autocorrelated noise makes it too rough."""
    design = problem.design(nonlinear)
    noise = uncertainty.noise_model(problem.sequence, design, solution.residual, _sum(penalties, solution.strength))
    effective = uncertainty.rows_effective(problem.sequence, noise)
    if effective > 0.8 * solution.residual.size:
        return solution
    return solve.penalised(design, problem.response, penalties, priors=priors, rows_effective=effective)


def _separable(problem, spec, penalties, priors, folds):
    """Alternate: non-linear parameters for given weights, then weights and linear parameters for these."""
    moving = [s for s in problem.slots if s.searched.stop > s.searched.start]
    still = [s for s in problem.slots if s.searched.stop == s.searched.start]
    unknowns = [separable.Unknown(p.name, *_bounds(p), _starts(slot, p)) for slot in moving for p in slot.term.free()]
    order = np.r_[tuple(slice(s.columns.start, s.columns.stop) for s in (*still, *moving))] if problem.width else []
    fixed = len(order) - sum(len(s.free) for s in moving)
    nothing = np.array([_middle(u) for u in unknowns])
    weights, nonlinear, solution, extra = np.ones(problem.response.size), None, None, np.empty((0, problem.width))
    for _ in range(ROUNDS if spec.method == "robust" or penalties else 1):
        root = np.sqrt(weights)[:, None]
        below = extra[:, order]
        constant = [problem.columns_of(s, nothing) for s in still]
        held = np.vstack([np.hstack([np.empty((root.size, 0)), *constant]) * root, below[:, :fixed]])

        def columns(values, root=root, below=below):
            return np.vstack([np.hstack([problem.columns_of(s, values) for s in moving]) * root, below[:, fixed:]])

        response = np.r_[problem.response * root[:, 0], np.zeros(below.shape[0])]
        before = nonlinear
        nonlinear = separable.search(columns, held, response, unknowns, begin=nonlinear)
        solution = _linear(problem.design(nonlinear), problem, spec, penalties, priors, folds)
        weights = solution.weights if spec.method == "robust" else weights
        extra = solve.penalty_rows(_sum(penalties, solution.strength)) if penalties else extra
        if before is not None and np.allclose(before, nonlinear, rtol=1e-5):
            break
    return nonlinear, solution


def _bounds(parameter) -> tuple[float, float]:
    low, high = parameter.bounds
    span = parameter.typical
    wide = 10.0 * max(abs(span[0]), abs(span[1]), 1e-6)
    return (low if np.isfinite(low) else -wide, high if np.isfinite(high) else wide)


def _starts(slot, parameter) -> tuple[float, ...]:
    """Start values: the term's own list, else spread over the typical range and towards the bounds."""
    own = slot.term.starts(parameter.name)
    if own:
        return own
    low, high = parameter.typical
    if 0 < low < high:
        inside = np.geomspace(low, high, separable.STARTS - 4)
        outer = [max(low / 3, parameter.bounds[0]), max(low / 10, parameter.bounds[0])]
        beyond = [min(high * 3, parameter.bounds[1]), min(high * 10, parameter.bounds[1])]
        return tuple(sorted({*map(float, inside), *map(float, outer), *map(float, beyond)}))
    return tuple(np.linspace(low, high, separable.STARTS))


def _middle(unknown: separable.Unknown) -> float:
    trial = unknown.trial()
    return float(trial[trial.size // 2])


def _sum(penalties, strengths) -> np.ndarray:
    return sum(s * p for s, p in zip(strengths, penalties, strict=True))


def _shrunk(problem: Problem) -> np.ndarray:
    shrunk = np.zeros(problem.width, dtype=bool)
    for slot in problem.slots:
        shrunk[slot.columns] = not slot.nuisance and not slot.term.is_level
    return shrunk


def _within(problem: Problem, fold) -> tuple[np.ndarray, np.ndarray]:
    rows = np.concatenate(problem.rows)
    return fold[0][rows], fold[1][rows]


def _penalty(problem, spec, penalties, solution, priors) -> np.ndarray | None:
    """Regularisation that the solve added to the normal matrix, shape (width, width)."""
    total = np.zeros((problem.width, problem.width))
    if spec.method == "ridge":
        return None
    if penalties:
        total += _sum(penalties, solution.strength)
    if priors:
        noise = float(np.sqrt(np.mean(solution.residual**2)))
        for p in priors:
            total[p.column, p.column] += (noise / p.spread) ** 2
    return total if penalties or priors else None


def _priors(problem: Problem, spec: ModelSpec) -> list[solve.Prior]:
    priors = []
    for component in spec.components:
        b = problem.components.index(component.component) if component.component in problem.components else None
        for prior in component.priors:
            for slot in problem.slots:
                for k, p in enumerate(slot.free):
                    if slot.block == b and p.name == prior.parameter and prior.applies_to(slot.term):
                        priors.append(solve.Prior(slot.columns.start + k, prior.value, prior.spread))
    return priors


def _with_intervals(plain: Estimate, problem: Problem, spec: ModelSpec, design, penalty) -> Estimate:
    jacobian, wide = design, penalty
    if plain.nonlinear.size:
        jacobian = np.hstack([design, problem.derivative(plain.nonlinear, plain.coefficients)])
        if penalty is not None:
            wide = np.zeros((jacobian.shape[1],) * 2)
            wide[: penalty.shape[0], : penalty.shape[0]] = penalty
    scores, curvature = plain.residual, None
    if spec.method == "robust":
        scale = max(solve.scale_of(plain.residual, plain.degrees), 1e-300)
        psi, slope = solve.influence(plain.residual / scale, plain.loss)
        scores, curvature = psi * scale, np.maximum(slope, 0.0)
    if spec.method == "ridge":
        wide = _ridge_penalty(problem, design, plain.strength[0], jacobian.shape[1])
    inverse = solve.least_squares(jacobian, np.zeros(scores.size), weights=curvature, penalty=wide).inverse
    noise = uncertainty.noise_model(problem.sequence, jacobian, scores, wide)
    spread = uncertainty.covariance(problem.sequence, jacobian, inverse, noise, scores, wide)
    effective = uncertainty.rows_effective(problem.sequence, noise)
    freedom = uncertainty.degrees_of_freedom(scores.size, plain.degrees, noise)
    return replace(plain, covariance=spread, noise=noise, rows_effective=effective, freedom=freedom)


def _ridge_penalty(problem: Problem, design: np.ndarray, strength: float, size: int) -> np.ndarray:
    shrunk = _shrunk(problem)
    spread = solve.spread_of(design, shrunk)
    whole = np.zeros((size, size))
    whole[: problem.width, : problem.width] = np.diag(spread**2 * shrunk) * design.shape[0] * strength
    return whole
