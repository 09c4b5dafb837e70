"""Parameters of the findings, refined between grid points, with 95 % intervals widened for departures from the form."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace

import numpy as np

from errpipe.diagnosis import units
from errpipe.diagnosis.case import Case
from errpipe.diagnosis.coloured import whiten
from errpipe.diagnosis.evidence import Scene, averaged, with_known_size
from errpipe.diagnosis.hypotheses import Hypothesis, columns_of, scaled
from errpipe.terms import search_of

WIDER = 1.3  # factor on intervals for departures from textbook forms; chosen on coverage over generated cases
DROP = 3.2  # drop of the log Bayes factor at the ends of a non-linear parameter's interval (1.92 times WIDER squared)
CHI2_95 = {1: 3.84, 2: 5.99, 3: 7.81, 4: 9.49, 5: 11.07, 6: 12.59}  # 95 % points, by degrees of freedom
DEPARTED = 0.3  # relative standard deviation of a size if the contribution departs from its textbook form
STRETCHES, STUDENT = 5, 2.776  # jackknife stretches; 97.5 % point of Student's t of one less
STEP = 0.03  # of logarithms, for derivatives
FLATTEST = 0.5  # smallest curvature: a factor of about 12 in either direction
SHAPE = 0.1  # relative standard deviation of the deepest point of a worn stretch due to its shape
APART = 0.1  # relative distance of the nearest textbook form's size, beyond the interval, for a report
MOSTLY = 0.5  # share of the contribution's variance that the textbook form must explain to have a size at all


@dataclass(frozen=True)
class Estimate:
    """One parameter with its 95 % interval."""

    name: str
    value: float
    unit: str
    low: float
    high: float


@dataclass(frozen=True)
class FittedFinding:
    """A finding with refined non-linear parameters, estimates and contribution."""

    hypothesis: Hypothesis
    estimates: tuple[Estimate, ...]
    contribution: np.ndarray
    joint: float  # chi squared of all linear parameters together, with the widened intervals
    cores: int  # number of linear parameters


def fit_finding(case: Case, k: int) -> FittedFinding:
    """Parameters of finding k given the others."""
    f = case.explanation.accepted[k]
    scene = case.search.scene([(g.index, g.size) for j, g in enumerate(case.explanation.accepted) if j != k])
    hypothesis, spans = _refine(case, scene, f.hypothesis)
    curved = None
    if len(hypothesis.terms[0].linear()) > 1 and len(hypothesis.terms[0].free()) > 1:
        hypothesis, spans, curved = _refine_jointly(case, scene, hypothesis)
    block, freedom, scale, cores = _columns(case, hypothesis)
    b, cov = _fit(scene, block, freedom, f.size, case)
    dependence = _dependence(case, scene, block, b)
    cov = cov * dependence
    if curved is not None:
        cov[:cores, :cores] += _covariance_from_nonlinear(case, scene, hypothesis, f.size, curved, scale[:cores])
    contribution = block @ b
    linear = _linear(hypothesis, b, cov, scale)
    joint = float(b[:cores] @ np.linalg.solve(cov[:cores, :cores], b[:cores])) / WIDER**2
    lags = cores == 1 and hypothesis.terms[0].form.startswith("any start")  # departures imitate it
    form = block[:, : case.library.textbook(f.index) if lags else cores]
    form, whole = form - form.mean(axis=0), contribution - contribution.mean()
    nearest = np.linalg.lstsq(form, whole, rcond=None)[0]
    reach = max(1.96 * WIDER * float(np.sqrt(cov[0, 0])), APART * abs(b[0]))
    projected = joint < CHI2_95.get(cores, 2.0 * cores) or (lags and abs(nearest[0] - b[0]) > reach)
    if projected:
        carried = 1.0 - float(np.var(whole - form @ nearest)) / max(float(np.var(whole)), 1e-300)
        shape = hypothesis, nearest[:cores], carried
        linear, alone = _projected_sizes(case, scene, shape, block[:, :cores], scale, dependence)
        joint = max(joint, alone)
    if curved is None and spans and not projected:  # a size depends on the scale at which it was fitted
        wide = cov.copy()
        wide[:cores, :cores] += _covariance_over_spans(case, scene, hypothesis, f.size, spans, scale[:cores])
        linear = [_with_longer_interval(e, w) for e, w in zip(linear, _linear(hypothesis, b, wide, scale), strict=True)]
    estimates = linear + _amplitudes(linear, cov, scale)
    if not hypothesis.mask:
        own, sd = case.library.textbook(f.index), 2.0 * max(f.size, 3.0) * case.sigma * freedom
        between = min((_between_stretches(scene, block[:, :k], sd, cores) for k in (cores, own)), key=np.trace)
        uneven = _linear(hypothesis, b, between, scale) + _amplitudes(linear, between, scale)
        estimates = [_with_longer_interval(e, u) for e, u in zip(estimates, uneven, strict=True)]
    largest = {p.name for p in hypothesis.terms[0].linear() if p.at_largest}
    estimates = [_at_largest(e, contribution, block, cov) if e.name in largest else e for e in estimates]
    for name, unit, value, low, high in spans:
        estimates.append(Estimate(name, value, unit, low, high))
    rotary = units.on_rotary_axis(hypothesis.terms[0], case.recording)
    units_of = [(e, *units.reported(e.unit, case.pair.unit, rotary)) for e in estimates]
    stated = (Estimate(e.name, e.value * f, unit, e.low * f, e.high * f) for e, unit, f in units_of)
    return FittedFinding(hypothesis, tuple(stated), contribution, joint, cores)


def _projected_sizes(case: Case, scene: Scene, shape, core, scale, dependence: float) -> tuple[list[Estimate], float]:
    """Sizes if departures dominate the textbook form: its projection onto the contribution; their chi squared.

    shape: hypothesis, projection, its share of the variance. Intervals are those of a fit of the textbook form alone,
    plus the uncertainty of the shape.
    """
    h, nearest, carried = shape
    S, _ = _projected(scene, core)
    # from the residual of the whole form: the departures' variance is added below
    cov = dependence * case.sigma**2 * np.linalg.inv(S + 1e-9 * np.trace(S) * np.eye(nearest.size))
    out = _linear(h, nearest, cov, scale)
    joint = float(nearest @ np.linalg.solve(cov, nearest)) / WIDER**2 if carried > MOSTLY else 0.0
    return [replace(e, low=e.low - DEPARTED * abs(e.value), high=e.high + DEPARTED * abs(e.value)) for e in out], joint


def _columns(case: Case, h: Hypothesis):
    core, slack, rel = columns_of(h, case.recording)
    made = scaled(core[case.pair.rows], slack[case.pair.rows], rel)
    if made is None:
        raise ValueError(f"{h.effect}: no columns")
    return (*made, core.shape[1])


def _projected(scene: Scene, block: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Products of a block with itself and with the signal, projected off the active columns."""
    W = whiten(block, scene.table.run, scene.table.colour)
    cross = np.linalg.solve(scene.chol, scene.table.whitened[:, scene.active.index].T @ W)
    return W.T @ W - cross.T @ cross, W.T @ scene.data.y - cross.T @ scene.half


def _gain(case: Case, scene: Scene, h: Hypothesis) -> float:
    try:
        block, freedom, scale, _ = _columns(case, h)
    except ValueError:
        return -np.inf
    S, s = _projected(scene, block)
    rows, known = case.search.rows or scene.n, h.terms[0].gain_sd  # effective number of rows if correlated
    if known is not None:
        return float(with_known_size(S[0, 0], s[0], scale[0], known * scale[0] / scene.sigma, scene.Q, rows))
    own = (S * freedom[:, None] * freedom)[None]
    return float(averaged(own, (freedom * s)[None, :, None], np.array([scene.Q]), rows)[0, 0])


def _fit(scene: Scene, block, freedom, size: float, case: Case) -> tuple[np.ndarray, np.ndarray]:
    S, s = _projected(scene, block)
    sd = 2.0 * max(size, 3.0) * freedom * case.sigma / case.search.noise
    M = S + np.diag(1.0 / sd**2)
    b = np.linalg.solve(M, s)
    return b, case.sigma**2 * np.linalg.inv(M)


def _dependence(case: Case, scene: Scene, block, b) -> float:
    """Ratio of the variance to that of independent rows, from block sums of the scores."""
    inside = scene.table.whitened[:, scene.active.index]
    both = whiten(np.column_stack([block[:, 0], block @ b]), case.run, scene.table.colour)
    projected = both - inside @ np.linalg.solve(scene.M, inside.T @ both)
    score = projected[:, 0] * (scene.residual() - projected[:, 1])
    sums = np.add.reduceat(score, np.arange(0, score.size, max(score.size // 40, 1)))
    return float(np.clip(np.sum(sums**2) / max(np.sum(score**2), 1e-300), 1.0, 200.0))


def _between_stretches(scene: Scene, form: np.ndarray, sd: np.ndarray, cores: int) -> np.ndarray:
    """Covariance of the textbook form's sizes by the jackknife over a few stretches of neighbouring rows.

    A real part varies along the machine and from day to day. Scaled to Student's quantile for so few stretches,
    in the units of `_linear`. form: alone, or with the reference or end from which it counts; sd: of each column.
    """
    inside = scene.active
    columns = np.column_stack(
        [scene.table.whitened[:, inside.index], whiten(form, scene.table.run, scene.table.colour)]
    )
    prior = (scene.sigma / np.maximum(np.r_[inside.sd, np.full(cores, np.inf), sd[cores : form.shape[1]]], 1e-300)) ** 2
    edges = np.linspace(0, scene.table.n, STRETCHES + 1).astype(int)
    parts = [(columns[a:b].T @ columns[a:b], columns[a:b].T @ scene.data.y[a:b]) for a, b in itertools.pairwise(edges)]
    products, seen = sum(p for p, _ in parts), sum(s for _, s in parts)
    firm = np.diag(prior + 1e-9 * np.diag(products) + 1e-300)
    sizes = np.array([np.linalg.solve(products - p + firm, seen - s)[inside.index.size :][:cores] for p, s in parts])
    return (STUDENT / 1.96 / WIDER * (STRETCHES - 1)) ** 2 / STRETCHES * np.atleast_2d(np.cov(sizes.T))


def _linear(h: Hypothesis, b, cov, scale) -> list[Estimate]:
    out, place = [], 0
    for term in h.terms:
        for p in term.linear():
            value, sd = b[place] / scale[place], WIDER * np.sqrt(cov[place, place]) / scale[place]
            out.append(Estimate(p.name, float(value), p.unit, float(value - 1.96 * sd), float(value + 1.96 * sd)))
            place += 1
    return out


def _amplitudes(estimates: list[Estimate], cov, scale) -> list[Estimate]:
    """Amplitudes of waves, added to their sines and cosines."""
    out = []
    names = [e.name for e in estimates]
    for k in range(len(names) - 1):
        order = names[k].removeprefix("sine")
        if names[k].startswith("sine") and names[k + 1] == f"cosine{order}":
            pair = np.array([estimates[k].value, estimates[k + 1].value])
            size = float(np.hypot(*pair))
            way = pair / max(size, 1e-300) / scale[k : k + 2]
            sd = WIDER * float(np.sqrt(way @ cov[k : k + 2, k : k + 2] @ way))
            low = max(size - 1.96 * sd, 0.0)
            out.append(Estimate(f"amplitude{order}", size, estimates[k].unit, low, size + 1.96 * sd))
    return out


def _at_largest(e: Estimate, contribution: np.ndarray, block: np.ndarray, cov: np.ndarray) -> Estimate:
    """A parameter that states the largest value is taken from the largest row, whatever the shape of the effect."""
    at = int(np.argmax(np.abs(contribution)))
    sign = 1.0 if e.value * contribution[at] >= 0 else -1.0
    value, sd = sign * float(contribution[at]), WIDER * float(np.sqrt(block[at] @ cov @ block[at]))
    reach = 1.96 * sd + SHAPE * abs(value)
    return Estimate(e.name, value, e.unit, value - reach, value + reach)


def _refine(case: Case, scene: Scene, h: Hypothesis):
    """Optimise each non-linear parameter in turn near its value, with the span over which the evidence holds."""
    spans, best = [], h
    for j, p in enumerate(h.terms[0].nonlinear()):
        value = best.nonlinear[0][j]
        if p.name in h.terms[0].fixed:
            spans.append((p.name, p.unit, value, 0.99 * value, 1.01 * value))
            continue
        if value == 0:
            spans.append((p.name, p.unit, 0.0, 0.0, 0.0))
            continue
        search = search_of(p)
        steps = search.neighbours(value, best.terms[0], case.recording)
        if search.bounded:
            steps = steps[(steps >= p.bounds[0]) & (steps <= p.bounds[1])]
        scored = [(_gain(case, scene, _with_value(best, j, float(v))), float(v)) for v in [value, *steps]]
        top, where = max(scored)
        best = _with_value(best, j, where)
        inside = [v for g, v in scored if g > top - DROP]
        spans.append((p.name, p.unit, where, *search.widened(min(inside), max(inside), best.terms[0], case.recording)))
    return best, spans


def _refine_jointly(case: Case, scene: Scene, h: Hypothesis):
    """All non-linear parameters together: the best, their spans, and the covariance of their logarithms.

    If the columns of two parameters are collinear (two time constants), spans of one at a time are far too short. The
    covariance is the inverse curvature of the log Bayes factor (Laplace).
    """
    from scipy.optimize import minimize

    term, start = h.terms[0], np.log(np.abs(h.nonlinear[0]))

    def loss(at: np.ndarray) -> float:
        return -_gain(case, scene, _with_values(h, at))

    optimum = minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 0.02, "maxfev": 150}).x
    best, k = _with_values(h, optimum), optimum.size
    steps = STEP * np.eye(k)
    centre = loss(optimum)
    curvature = np.empty((k, k))
    for i in range(k):
        curvature[i, i] = (loss(optimum + steps[i]) - 2 * centre + loss(optimum - steps[i])) / STEP**2
        for j in range(i):
            alike = loss(optimum + steps[i] + steps[j]) + loss(optimum - steps[i] - steps[j])
            opposite = loss(optimum + steps[i] - steps[j]) + loss(optimum - steps[i] + steps[j])
            curvature[i, j] = curvature[j, i] = (alike - opposite) / (4 * STEP**2)
    values, vectors = np.linalg.eigh(curvature)
    cov = vectors / np.maximum(values, FLATTEST) @ vectors.T
    reach = np.exp(np.sqrt(2 * DROP * np.diag(cov)))
    spans = [
        (p.name, p.unit, v, float(v / r), float(v * r))
        for p, v, r in zip(term.nonlinear(), best.nonlinear[0], reach, strict=True)
    ]
    return best, spans, cov


def _covariance_from_nonlinear(
    case: Case, scene: Scene, h: Hypothesis, size: float, cov: np.ndarray, scale: np.ndarray
):
    """Covariance of the linear parameters, times their scales, due to the non-linear ones."""
    at, slopes = np.log(np.abs(h.nonlinear[0])), []
    for step in STEP * np.eye(at.size):
        ends = []
        for other in (_with_values(h, at + step), _with_values(h, at - step)):
            block, freedom, own, cores = _columns(case, other)
            ends.append(_fit(scene, block, freedom, size, case)[0][:cores] / own[:cores])
        slopes.append((ends[0] - ends[1]) / (2 * STEP))
    slope = np.column_stack(slopes) * scale[:, None]
    return slope @ cov @ slope.T


def _covariance_over_spans(
    case: Case, scene: Scene, h: Hypothesis, size: float, spans, scale: np.ndarray
) -> np.ndarray:
    """Covariance of the linear parameters, times their scales, over the span of each non-linear one alone."""
    out = np.zeros((scale.size, scale.size))
    for j, (_, _, _, *ends) in enumerate(spans):
        if h.terms[0].nonlinear()[j].name in h.terms[0].fixed or not ends[0] < ends[1]:
            continue
        sizes = []
        for end in ends:
            try:
                block, freedom, own, cores = _columns(case, _with_value(h, j, float(end)))
            except ValueError:  # its columns are constant there
                break
            sizes.append(_fit(scene, block, freedom, size, case)[0][:cores] / own[:cores])
        if len(sizes) == 2:
            half = (sizes[1] - sizes[0]) / 2 * scale
            out += np.outer(half, half) / (2 * DROP)
    return out


def _with_longer_interval(e: Estimate, other: Estimate) -> Estimate:
    """The estimate with the interval of another one around its own value, if that is longer."""
    reach = max(e.high - e.value, (other.high - other.low) / 2)
    return replace(e, low=e.value - reach, high=e.value + reach)


def _with_values(h: Hypothesis, logarithms: np.ndarray) -> Hypothesis:
    """The hypothesis at other non-linear values, given by their logarithms; signs are kept."""
    values = tuple(float(s * np.exp(v)) for s, v in zip(np.sign(h.nonlinear[0]), logarithms, strict=True))
    return replace(h, nonlinear=(values,) * len(h.nonlinear))


def _with_value(h: Hypothesis, j: int, value: float) -> Hypothesis:
    return replace(h, nonlinear=tuple((*nl[:j], value, *nl[j + 1 :]) for nl in h.nonlinear))
