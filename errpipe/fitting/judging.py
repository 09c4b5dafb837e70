"""Cross-validation: residuals of held-out groups, and the figures derived from them.

If a recording has nuisance (the datum of a run, the pose of a workpiece), it is fitted on the test rows,
too, for the model and for no compensation alike, and its degrees of freedom are counted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting.components import evaluate, folds_of, groups_of, solved_without_intervals, without_nuisance
from errpipe.fitting.design import Problem, assemble, response_name
from errpipe.fitting.holdout import Fold, check
from errpipe.fitting.parallel import parallel_map
from errpipe.fitting.spec import ComponentSpec, ModelSpec
from errpipe.fitting.validity import distance

MIN_IMPROVEMENT = 0.01  # share of the held-out error that a term must remove to be kept (by judgement)


class NothingJudged(DataError):
    """A held-out group without a row that has every input of the model, such as a run without a sensor."""


@dataclass(frozen=True)
class HeldOut:
    """One held-out group. before: response without the model; after: residual of the model; shape (n,).

    rows: row numbers; outside: distance from the validity range of the fitted rows, (n,); used: degrees of freedom
    of the nuisance on these rows.
    """

    label: str
    rows: np.ndarray
    before: np.ndarray
    after: np.ndarray
    outside: np.ndarray
    used: float

    def rms(self, values: np.ndarray) -> float:
        """Root mean square of `values` over the degrees of freedom left, in the response's unit."""
        return float(np.sqrt(np.sum(values**2) / max(values.size - self.used, 1.0)))


def validate_fold(recording: Recording, spec: ModelSpec, fold: Fold) -> dict[str, HeldOut]:
    """Fit on one side of a fold, test on the other, per component. Raises DataError if rows are on both.

    Terms are selected again on the fitted rows: held-out rows do not influence the selection either.
    """
    check(fold)
    out = {}
    if spec.selection == "held-out":
        spec = select(recording, spec, fold.train)
    model = solved_without_intervals(recording, spec, fold.train)
    values = evaluate(model, recording)
    for group in groups_of(spec):
        out.update(_residual(recording, spec, group, fold, values, model))
    return out


def _residual(recording, spec: ModelSpec, group: Sequence[ComponentSpec], fold, values, model: ErrorModel):
    usable = fold.test.copy()
    for component in group:
        usable &= np.isfinite(values[component.component])
    if not usable.any():
        empty = ", ".join(_empty(recording, fold.test))
        raise NothingJudged(
            f"hold-out {fold.label}: no judged row has a value in every column that the model reads"
            + (f" (empty in all of them: {empty})" if empty else "")
        )
    problem = assemble(recording, [(c.component, ()) for c in group], spec.nuisance, usable)
    predicted = np.concatenate([values[c][r] for c, r in zip(problem.components, problem.rows, strict=True)])
    response, left = problem.response, problem.response - predicted
    if spec.datum == "run_start":
        response, left = response - _starts(recording, problem), left - _starts(recording, problem, values)
    before, after = without_nuisance(problem, response), without_nuisance(problem, left)
    used = float(np.linalg.matrix_rank(problem.design(np.empty(0)))) if problem.width else 0.0
    far, out, start = distance(model.validity, recording), {}, 0
    for name, rows in zip(problem.components, problem.rows, strict=True):
        part = slice(start, start + rows.size)
        share = used * rows.size / problem.response.size
        out[name] = HeldOut(fold.label, rows, before[part], after[part], far[rows], share)
        start = part.stop
    return out


def _empty(recording: Recording, rows: np.ndarray) -> list[str]:
    """Columns of readings without a value in some rows."""
    labels = ("run", "group", "ignore")
    read = [n for n, c in recording.manifest.columns.items() if c.role not in labels and n in recording.frame]
    return [n for n in read if not np.isfinite(recording.array(n)[rows]).any()]


def _starts(recording: Recording, problem: Problem, values: Mapping[str, np.ndarray] | None = None) -> np.ndarray:
    """Each run's first reading (minus the model's value there), for every row of the problem, (n,).

    One, because a table counts from one: the mean of several would remove most of what its noise costs the whole run.
    """
    run, out = recording.run_codes(), []
    for component, rows in zip(problem.components, problem.rows, strict=True):
        y = recording.array(response_name(recording, component))
        y = y if values is None else y - values[component]
        first = np.zeros(int(run.max()) + 1)
        for code in np.unique(run[rows]):
            readings = y[run == code]
            first[code] = readings[np.isfinite(readings)][0]
        out.append(first[run[rows]])
    return np.concatenate(out)


def judge_all(recording: Recording, spec: ModelSpec, mask: np.ndarray) -> dict[str, list[HeldOut]]:
    """`validate_fold` for every fold of the specification's hold-out, within a mask; see `judge_components`."""
    folds = folds_of(recording, spec, mask)
    return judge_components(
        [c.component for c in spec.components], folds, lambda fold: validate_fold(recording, spec, fold)
    )[0]


def judge_components(
    components: Iterable[str], folds: Sequence[Fold], judge_one: Callable[[Fold], Mapping[str, HeldOut]]
) -> tuple[dict[str, list[HeldOut]], list[str]]:
    """Per component the held-out rows of every fold, and why some folds have no test rows.

    Raises DataError if none does.
    """
    out: dict[str, list[HeldOut]] = {c: [] for c in components}
    empty: list[str] = []

    def judged(fold: Fold) -> Mapping[str, HeldOut] | NothingJudged:
        try:
            return judge_one(fold)
        except NothingJudged as why:
            return why

    for one in parallel_map(judged, folds):
        if isinstance(one, NothingJudged):
            empty.append(str(one))
            continue
        for component, left in one.items():
            out[component].append(left)
    if empty and not all(out.values()):
        raise NothingJudged(empty[0])
    return out, empty


def calibrated(model: ErrorModel, judged: dict[str, list[HeldOut]]) -> ErrorModel:
    """The model with the half width of its 90 % prediction interval, inside the validity range and beyond it."""
    components = []
    for component in model.components:
        folds = judged[component.component]
        half = half_width90(folds)
        components.append(component.model_copy(update={"half_width90": half, "widening90": widening90(folds, half)}))
    return model.model_copy(update={"components": tuple(components)})


def half_width90(folds: Sequence[HeldOut]) -> float:
    """90 % quantile of the held-out error inside the range (conformal by group: every group has equal weight)."""
    return next(_half_widths90(folds, (None,)))


def half_widths90_without_each(folds: Sequence[HeldOut]) -> list[float]:
    """`half_width90` of all groups but one, for each in turn: the errors of a million rows are sorted once."""
    return list(_half_widths90(folds, range(len(folds))))


def _half_widths90(folds: Sequence[HeldOut], without: Iterable[int | None]) -> Iterator[float]:
    size = np.concatenate([np.abs(f.after) for f in folds])
    weight = np.concatenate([np.full(f.rows.size, 1.0 / f.rows.size) for f in folds])
    inside = np.concatenate([f.outside for f in folds]) <= 0.0
    group = np.repeat(np.arange(len(folds)), [f.rows.size for f in folds])
    order = np.argsort(size, kind="stable")
    for number in without:
        used = np.ones(size.size, dtype=bool) if number is None else group != number
        if np.count_nonzero(used & inside) >= 0.2 * np.count_nonzero(used):
            used &= inside
        ordered = order[used[order]]
        reached = np.cumsum(weight[ordered]) / weight[used].sum()
        yield float(size[ordered[min(int(np.searchsorted(reached, 0.9)), ordered.size - 1)]])


def widening90(folds: Sequence[HeldOut], half: float) -> float:
    """Half width added per range width outside the range, from held-out rows outside, else `half` (by judgement)."""
    size = np.concatenate([np.abs(f.after) for f in folds])
    outside = np.concatenate([f.outside for f in folds])
    beyond = outside > 0.02
    if np.count_nonzero(beyond) < 50:
        return half
    return max(float(np.quantile(np.maximum(size[beyond] - half, 0.0) / outside[beyond], 0.9)), half)


def select(recording: Recording, spec: ModelSpec, mask: np.ndarray) -> ModelSpec:
    """Backward elimination of terms that do not improve held-out rows; no compensation wins ties."""
    kept = []
    for component in spec.components:
        terms = list(component.terms)
        score = _score(recording, spec, component, terms, mask)
        while terms:
            tried = [
                (_score(recording, spec, component, terms[:k] + terms[k + 1 :], mask), k) for k in range(len(terms))
            ]
            best, k = min(tried)
            if best > score * (1.0 + MIN_IMPROVEMENT):
                break
            score = best
            terms.pop(k)
        kept.append(component.model_copy(update={"terms": tuple(terms)}))
    return spec.model_copy(update={"components": tuple(kept), "selection": "none"})


def _score(recording, spec, component, terms, mask) -> float:
    one = component.model_copy(update={"terms": tuple(terms), "priors": ()})
    alone = spec.model_copy(update={"components": (one,), "selection": "none"})
    judged = judge_all(recording, alone, mask)[component.component]
    return float(np.sqrt(np.mean([f.rms(f.after) ** 2 for f in judged])))
