"""Components solved into an error model, and the model's deviations on any recording."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pydantic import ValidationError

from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedParameter, FittedTerm
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.design import Problem, Slot, assemble, inner_values, response_name
from errpipe.fitting.estimate import Estimate, estimate
from errpipe.fitting.noise_floor import noise_floor
from errpipe.fitting.solve import one_thread
from errpipe.fitting.spec import ComponentSpec, ModelSpec
from errpipe.fitting.statistics import rms
from errpipe.fitting.uncertainty import half_width
from errpipe.fitting.validity import box, extended, few_rows_outside
from errpipe.terms import TERMS, Term, plain
from errpipe.terms.run_offset import RunOffset


def evaluate(model: ErrorModel, recording: Recording) -> dict[str, np.ndarray]:
    """Deviations of every component in its unit, shape (rows,); NaN if an input is missing.

    With datum `run_start` they count from each run's first row with a value.
    """
    out = {}
    for component in model.components:
        total = np.zeros(len(recording))
        for fitted in component.terms:
            total = total + term_of(fitted).value(recording, fitted.values())
        if component.gain != 1.0:
            total = component.gain * total
        if model.datum == "run_start":
            total = from_run_start(recording, total)
        out[component.component] = (
            total if component.limit is None else np.clip(total, -component.limit, component.limit)
        )
    return out


def term_of(fitted: FittedTerm) -> Term:
    """The term from its plain data. Raises DataError for a term or an option unknown to this version."""
    name = fitted.term["term"]
    if name not in TERMS.tags:
        raise DataError(f"error model: the term {name!r} is unknown")
    try:
        term: Term = TERMS[name].model_validate(fitted.term)
    except ValidationError as err:
        first = err.errors()[0]
        where = ".".join(map(str, first["loc"]))
        raise DataError(f"error model: term {name}: {where}: {first['msg'].lower()}") from err
    return term


def from_run_start(recording: Recording, values: np.ndarray) -> np.ndarray:
    """Values minus the first finite one of each run, shape (rows,)."""
    return values - _first(recording, values)


def _first(recording: Recording, values: np.ndarray) -> np.ndarray:
    run, out = recording.run_codes(), np.zeros(values.size)
    for code in np.unique(run):
        here = np.flatnonzero(run == code)
        known = here[np.isfinite(values[here])]
        out[here] = values[known[0]] if known.size else np.nan
    return out


def solved(recording: Recording, spec: ModelSpec, mask: np.ndarray) -> ErrorModel:
    """The error model of `spec` on the rows of a mask, its prediction interval still open.

    Raises DataError if a response or a needed column is missing, NotIdentifiable if the rows cannot distinguish
    parameters.
    """
    models: list[ComponentModel] = []
    for group in groups_of(spec):
        models += _fit_group(recording, spec, group, mask)
    return whole_model(recording, spec, mask, models)


def solved_without_intervals(recording: Recording, spec: ModelSpec, mask: np.ndarray) -> ErrorModel:
    """`solved` without intervals and without the identifiability check: for predictions only."""
    models: list[ComponentModel] = []
    for group in groups_of(spec):
        problem, solution = solve_group(recording, spec, group, mask, intervals=False)
        for b, component in enumerate(problem.components):
            own = [s for s in problem.slots if s.block == b and not s.nuisance]
            models.append(ComponentModel(component=component, terms=tuple(_values(s, solution) for s in own)))
    return whole_model(recording, spec, mask, models)


def _values(slot: Slot, estimate: Estimate) -> FittedTerm:
    term = slot.term
    gains = dict(zip((p.name for p in slot.free), estimate.coefficients[slot.columns], strict=True)) | term.fixed
    inner = dict(
        zip((p.name for p in term.nonlinear()), inner_values(term, estimate.nonlinear[slot.searched]), strict=True)
    )
    values = [(p, gains[p.name]) for p in term.linear()] + [(p, inner[p.name]) for p in term.nonlinear()]
    return FittedTerm(
        term=plain(term), parameters=tuple(FittedParameter(name=p.name, value=float(v), unit=p.unit) for p, v in values)
    )


def nuisance_of(spec: ModelSpec) -> tuple[Term, ...]:
    """Nuisance terms of a specification; a datum at each run's start adds an offset per run."""
    if spec.datum == "run_start" and not any(isinstance(t, RunOffset) for t in spec.nuisance):
        return (*spec.nuisance, RunOffset())
    return spec.nuisance


def groups_of(spec: ModelSpec) -> list[tuple[ComponentSpec, ...]]:
    """Components solved together: all of them if a nuisance is shared, else each separately."""
    if any(hasattr(t, "shared") for t in spec.nuisance):
        return [spec.components]
    return [(c,) for c in spec.components]


def folds_of(recording: Recording, spec: ModelSpec, mask: np.ndarray) -> list[holdout.Fold]:
    """Hold-out folds inside the rows of a mask."""
    inside = recording if mask.all() else recording.take(mask)
    rows = np.flatnonzero(mask)
    folds = []
    for label, train, test in holdout.groups(inside, spec.holdout):
        wide_train, wide_test = np.zeros(mask.size, dtype=bool), np.zeros(mask.size, dtype=bool)
        wide_train[rows[train]] = True
        wide_test[rows[test]] = True
        folds.append(holdout.Fold(label, wide_train, wide_test))
    return folds


def solve_group(
    recording: Recording, spec: ModelSpec, group: Sequence[ComponentSpec], mask: np.ndarray, intervals: bool
) -> tuple[Problem, Estimate]:
    """Components that share a nuisance, solved together on the rows of a mask."""
    blocks = [(c.component, c.terms) for c in group]
    problem = assemble(recording, blocks, nuisance_of(spec), mask)
    folds = []
    if spec.method == "ridge":
        try:
            folds = [(f.train, f.test) for f in folds_of(recording, spec, mask)]
        except DataError:
            folds = []  # one group left inside a hold-out: the strength comes from generalised cross-validation
    return problem, estimate(problem, spec, folds=folds, intervals=intervals)


def _fit_group(recording, spec, group, mask) -> list[ComponentModel]:
    problem, solution = solve_group(recording, spec, group, mask, intervals=True)
    before = without_nuisance(problem, problem.response)
    models, start = [], 0
    for b, component in enumerate(problem.components):
        rows = slice(start, start + problem.rows[b].size)
        models.append(component_model(problem, solution, b, component, before[rows], solution.residual[rows]))
        start = rows.stop
    return models


def component_model(problem: Problem, estimate: Estimate, block: int, component: str, before, after) -> ComponentModel:
    """A block of a solved problem as a component of an error model; before, after: on the block's rows, (n,)."""
    response, rows = response_name(problem.recording, component), problem.rows[block]
    unit = problem.recording.manifest.columns[response].unit or "um"
    own = [s for s in problem.slots if s.block in (block, -1)]
    terms = tuple(fitted_term(s, estimate, problem.width, unit) for s in own if not s.nuisance)
    nuisance = tuple(fitted_term(s, estimate, problem.width, unit) for s in own if s.nuisance)
    names, index = [], []
    for k, s in enumerate(s for s in own if not s.nuisance):
        names += [f"{s.term.term}[{k}].{p.name}" for p in (*s.free, *s.term.free())]
        index += [*range(s.columns.start, s.columns.stop)]
        index += [problem.width + j for j in range(s.searched.start, s.searched.stop)]
    spread = estimate.covariance[np.ix_(index, index)]
    share = after.size / max(problem.response.size, 1)
    return ComponentModel(
        component=component,
        unit=unit,
        terms=terms,
        nuisance=nuisance,
        parameter_names=tuple(names),
        covariance=tuple(tuple(map(float, row)) for row in spread),
        rows=int(after.size),
        rows_effective=float(estimate.rows_effective * share),
        rms_before=rms(before),
        rms_after=rms(after),
        noise_floor=noise_floor(problem.recording, rows, after, problem.recording.array(response)[rows]),
    )


def fitted_term(slot: Slot, estimate: Estimate, width: int, unit: str) -> FittedTerm:
    """Parameters of one term with 95 % intervals; on a logarithmic scale for a positive non-linear one."""
    term, out = slot.term, []
    gains = dict(zip((p.name for p in slot.free), range(slot.columns.start, slot.columns.stop), strict=True))
    for p in term.linear():
        if p.name in term.fixed:
            out.append(FittedParameter(name=p.name, value=term.fixed[p.name], unit=unit_in(p.unit, unit), note="fixed"))
            continue
        value = float(estimate.coefficients[gains[p.name]])
        error = float(np.sqrt(max(estimate.covariance[gains[p.name], gains[p.name]], 0.0)))
        half = half_width(error, estimate.freedom)
        facts = {"unit": unit_in(p.unit, unit), "standard_error": error, "note": _remark(p, value)}
        out.append(FittedParameter(name=p.name, value=value, ci95=(value - half, value + half), **facts))
    values = inner_values(term, estimate.nonlinear[slot.searched])
    places = iter(range(width + slot.searched.start, width + slot.searched.stop))
    for p, value in zip(term.nonlinear(), values, strict=True):
        if p.name in term.fixed:
            out.append(FittedParameter(name=p.name, value=value, unit=p.unit, note="fixed"))
            continue
        place = next(places)
        error = float(np.sqrt(max(estimate.covariance[place, place], 0.0)))
        half = half_width(error, estimate.freedom)
        ends = (value - half, value + half)
        if p.bounds[0] >= 0 and value > 0:
            spread = min(half / value, 20.0)
            ends = (value * float(np.exp(-spread)), value * float(np.exp(spread)))
        out.append(
            FittedParameter(
                name=p.name, value=value, unit=p.unit, standard_error=error, ci95=ends, note=_at_bound(p, value)
            )
        )
    return FittedTerm(term=plain(term), parameters=tuple(out))


def unit_in(unit: str, response: str) -> str:
    """Unit of a parameter when the response is not in um: terms are written for um."""
    if response != "um" and (unit == "um" or unit.startswith("um/")):
        return response + unit[2:]
    return unit


def _remark(parameter, value: float) -> str:
    low, high = parameter.bounds
    return "" if low <= value <= high else f"outside the physically possible range ({low:g} to {high:g})"


def _at_bound(parameter, value: float) -> str:
    low, high = parameter.bounds
    near = min(abs(value - low) / max(abs(low), 1e-12), abs(value - high) / max(abs(high), 1e-12)) < 1e-3
    return "at a bound: not determined" if near else ""


@one_thread()
def without_nuisance(problem: Problem, values: np.ndarray) -> np.ndarray:
    """`values` minus the nuisance terms, shape (n,)."""
    columns = [problem.columns_of(s, np.zeros(len(problem.unknowns))) for s in problem.slots if s.nuisance]
    if not columns:
        return values
    design = np.hstack(columns)
    return values - design @ np.linalg.lstsq(design, values, rcond=None)[0]


def whole_model(recording: Recording, spec: ModelSpec, mask, models: Sequence[ComponentModel]) -> ErrorModel:
    """Components as an error model, with the validity box of the rows of a mask."""
    used: list[str] = []
    for model in models:
        for fitted in model.terms:
            used += term_of(fitted).drivers(recording)
    names = list(dict.fromkeys(used))
    axes = {recording.manifest.columns[n].axis for n in names} - {None}
    kept = [k for k, c in recording.manifest.constants.items() if k in axes or c.role != "axis"]
    validity = box(recording, names, mask)
    return ErrorModel.of(
        recording.manifest,
        names,
        kept,
        components=tuple(models),
        validity=extended(validity, spec.also_valid, recording),
        datum=spec.datum,
        notes=tuple(few_rows_outside(recording, validity, mask)),
    )
