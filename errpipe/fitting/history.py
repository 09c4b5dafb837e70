"""Terms fitted to, and validated on, a recording larger than memory.

Parameters, rms and counts, of the fit and of every held-out group, are those of all rows. The noise's memory, the
noise floor, the 90 % interval and the gaps of the validity box are those of the sample (see `batches`); the memory's
effect on the parameters is again that of all rows, cut at the borders of batches.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from errpipe.domain.error_model import ComponentModel, ErrorModel
from errpipe.domain.recording import Column, Manifest, Recording
from errpipe.errors import DataError
from errpipe.fitting import batches, holdout, identifiability, solve, uncertainty
from errpipe.fitting.batches import History, Prepare
from errpipe.fitting.components import component_model, whole_model
from errpipe.fitting.design import Problem
from errpipe.fitting.estimate import Estimate, without_columns
from errpipe.fitting.judging import HeldOut, calibrated
from errpipe.fitting.model import without_interval
from errpipe.fitting.source import Source, survey
from errpipe.fitting.spec import ModelSpec
from errpipe.fitting.validity import GAP, box, distance, extended
from errpipe.kernels.noise import correlated

CUT = "cell_group"  # name of the column of cells' groups


@dataclass
class Fold:
    """One held-out group. held_out: its rows in the sample; rows: their number; factor: of them, (k, k).

    weights: of the columns of the factor in the residual of the model, (k,).
    """

    held_out: HeldOut
    rows: int
    factor: np.ndarray
    weights: np.ndarray
    cells: np.ndarray  # of the history that was held out, as a mask

    def residual_at_gain(self, gain: float) -> tuple[float, float]:
        """(sum of squares, mean) of the residual of the response at a share of the correction."""
        bare = np.zeros(self.weights.size)
        bare[-1] = 1.0
        rotated = self.factor @ (gain * self.weights + (1.0 - gain) * bare)
        return float(rotated @ rotated), float(rotated[0] / self.factor[0, 0])


def unsupported_in_batches(spec: ModelSpec, recording: Recording) -> list[str]:
    """Parts of a specification that cannot be fitted batch by batch; recording: any rows of it."""
    reasons = [f"method: {spec.method}"] if spec.method != "linear" else []
    reasons += ["datum: run_start"] if spec.datum == "run_start" else []
    reasons += [f"selection: {spec.selection}"] if spec.selection != "none" else []
    reasons += ["nuisance"] if spec.nuisance else []
    for component in spec.components:
        reasons += [f"priors of {component.component}"] if component.priors else []
        for term in component.terms:
            named = f"{term.term} of {component.component}"
            if term.free():
                reasons.append(f"{named} (non-linear: fix {' and '.join(p.name for p in term.free())})")
            elif not term.splittable_in_batches(recording) or term.settled(recording).penalty() is not None:
                reasons.append(named)
    return reasons


def fitted(source: Source, spec: ModelSpec, prepare: Prepare) -> ErrorModel:
    """`model.fit` of a specification for which `unsupported_in_batches` is empty. Raises DataError, NotIdentifiable."""
    layout = survey(source, spec)
    histories = batches.gather(source, spec, layout, prepare)
    models, sample = [_component(source, h, spec, prepare) for h in histories], histories[0].sample(source.manifest)
    model = whole_model(sample, spec, np.ones(len(sample), dtype=bool), models)
    model = _widened(model, spec, source, sample)
    try:
        folds = leave_one_group_out(histories, source.manifest)
    except DataError as why:
        return without_interval(model, str(why))
    return calibrated(model, {h.component: [f.held_out for f in fs] for h, fs in zip(histories, folds, strict=True)})


def _component(source: Source, history: History, spec: ModelSpec, prepare: Prepare) -> ComponentModel:
    sample, rows = history.sample(source.manifest), history.rows()
    k = np.flatnonzero(np.isfinite(rows.sum(axis=1)))
    rows, sequence = rows[k], _sequence(history, sample)[k]
    width, total = history.width, batches.equivalent_rows(history.factor())
    number = int(sum(history.counts))
    response, y = total[:, -1] - total[:, -2], rows[:, -1] - rows[:, -2]
    problem = Problem(sample, (history.component,), (k,), y, sequence, history.slots, width, ())
    if width:
        identifiability.check(
            total[:, 1:-2], problem.names(), sample, component=history.component, most=spec.most_inflation
        )
        solution = solve.least_squares(total[:, 1:-2], response)
        estimate = _estimate(source, history, problem, rows, solution, prepare)
    else:
        estimate = without_columns(y, _rms(response, number), number)
    model = component_model(problem, estimate, 0, history.component, y, estimate.residual)
    left = history.factor() @ history.weights(estimate.coefficients)
    figures = {"rows": number, "rows_effective": estimate.rows_effective}
    figures |= {"rms_before": _rms(response, number), "rms_after": _rms(left, number)}
    return model.model_copy(update=figures)


def _rms(rotated: np.ndarray, rows: int) -> float:
    return float(np.sqrt(rotated @ rotated / rows))


def _sequence(history: History, sample: Recording) -> np.ndarray:
    """Integer per row of the sample, distinct for every run and stretch."""
    if history.layout.rows <= batches.SAMPLE_ROWS:
        return sample.run_codes()
    jump = np.diff(np.concatenate(history.places)) > batches.SHORTEST
    return np.r_[0, np.cumsum(jump | (np.diff(sample.run_codes()) != 0))]


def _estimate(source, history: History, problem: Problem, rows, solution: solve.Solution, prepare) -> Estimate:
    """Parameters with intervals: the noise from the sample, its effect on the parameters from all rows."""
    b, width = solution.coefficients, history.width
    residual = problem.response - rows[:, 1:-2] @ b
    noise = uncertainty.noise_model(problem.sequence, rows[:, 1:-2], residual, None)
    gram = np.linalg.inv(solution.inverse) if noise.share <= 0.0 else _coloured(source, history, noise, prepare)
    by_run: dict[str, list[int]] = {}
    for (run, _), k in history.keys.items():
        if history.counts[k]:
            by_run.setdefault(run, []).append(k)
    weights = history.weights(b)
    pulls = np.array([sum(history.gradient(k, weights)[1:-2] for k in ks) for ks in by_run.values()])
    seen = solution.inverse @ (pulls.T @ pulls) @ solution.inverse
    spread = uncertainty.larger(noise.sigma**2 * solution.inverse @ gram @ solution.inverse, seen, len(by_run))
    lengths = np.array([sum(history.counts[k] for k in ks) for ks in by_run.values()])
    freedom = uncertainty.degrees_of_freedom(int(lengths.sum()), float(width), noise)
    effective = uncertainty.effective_rows(lengths, noise)
    return Estimate(b, np.empty(0), residual, float(width), (), spread, noise, effective, freedom)


def _coloured(source: Source, history: History, noise: uncertainty.Noise, prepare) -> np.ndarray:
    """design' C design with the noise's correlation C, from a second pass, (width, width); C ends with each batch."""
    total: np.ndarray = sum(source.over(_coloured_part, history.without_rows(), noise, prepare))
    return total


def _coloured_part(source: Source, history: History, noise: uncertainty.Noise, prepare: Prepare) -> np.ndarray:
    total = np.zeros((history.width, history.width))
    with solve.one_thread():  # the sums are then the same on machines with other numbers of cores
        for batch in map(prepare, source.batches(history.names, runs=history.layout.runs_of(source))):
            rows = history.columns(batch)
            known = np.isfinite(rows.sum(axis=1))
            design = np.ascontiguousarray(rows[known, 1:-2])
            total += design.T @ correlated(batch.run_codes()[known], design, noise.rho, noise.share)
    return total


def _widened(model: ErrorModel, spec: ModelSpec, source: Source, sample: Recording) -> ErrorModel:
    """The validity range extended to the smallest and largest value of all rows, unless these are beyond a gap."""
    ranges = model.validity.ranges | model.validity.seen
    for name, (low, high) in ranges.items():
        seen, (least, most) = sample.array(name), source.ends.array(name)
        reach = GAP * (high - low)
        low = float(least) if low == np.nanmin(seen) and low - least <= reach else low
        high = float(most) if high == np.nanmax(seen) and most - high <= reach else high
        ranges[name] = (low, high)
    validity = extended(model.validity.model_copy(update={"ranges": ranges}), spec.also_valid, sample)
    return model.model_copy(update={"validity": validity})


def leave_one_group_out(histories: list[History], manifest: Manifest) -> list[list[Fold]]:
    """For each history every group, validated with parameters of the others. Raises DataError if that is impossible."""
    sample = histories[0].sample(manifest)
    drivers = list(dict.fromkeys(n for h in histories for s in h.slots for n in s.term.drivers(sample)))
    return [_left_out(history, sample, drivers) for history in histories]


def _left_out(history: History, sample: Recording, drivers: list[str]) -> list[Fold]:
    rows, cells = history.rows(), np.concatenate(history.cells)
    known = np.isfinite(rows.sum(axis=1))
    folds = []
    for label, train, test in _folds(history):
        total, judged = batches.equivalent_rows(history.factor(train)), np.flatnonzero(test[cells] & known)
        b = solve.least_squares(total[:, 1:-2], total[:, -1] - total[:, -2]).coefficients
        weights = history.weights(b)
        validity = box(sample, drivers, train[cells])
        if not judged.size:
            raise DataError(f"hold-out {label}: no row of the sample is of this group")
        part = rows[judged]
        held = HeldOut(label, judged, part[:, -1], part @ weights, distance(validity, sample.take(judged)), 0.0)
        folds.append(Fold(held, int(np.array(history.counts)[test].sum()), history.factor(test), weights, test))
    return folds


def _folds(history: History) -> list[holdout.Fold]:
    """The hold-out's folds as masks of cells."""
    scheme, keys = history.layout.scheme, list(history.keys)
    measured = np.where(np.array(history.counts) > 0, 0.0, np.nan)
    columns = {"run": Column(role="run"), "E": Column(role="error", component=history.component)}
    frame = {"run": [run for run, _ in keys], "E": measured}
    if any(group for _, group in keys):
        columns[CUT] = Column(role="group", of=CUT)
        frame[CUT] = [group for _, group in keys]
        kind = "forward" if scheme.scheme == "forward" else "batches" if scheme.scheme == "batches" else None
        scheme = scheme.model_copy(update={"scheme": kind or "leave-one-group-out", "of": CUT})
    cells = Recording(Manifest(recording=1, tables=("-",), columns=columns), pd.DataFrame(frame))
    return holdout.groups(cells, scheme)


def largest_deviations(
    source: Source, histories: list[History], folds: list[list[Fold]], prepare: Prepare
) -> list[np.ndarray]:
    """Per history the largest deviation of each fold before and after the model, (folds, 2), from one more pass."""
    of_cell = [{k: i for i, f in enumerate(fs) for k in np.flatnonzero(f.cells).tolist()} for fs in folds]
    weights = [np.array([f.weights for f in fs]) for fs in folds]
    bare = [h.without_rows() for h in histories]
    parts = source.over(_largest_of_part, bare, of_cell, weights, prepare)
    return [np.maximum.reduce(of_component) for of_component in zip(*parts, strict=True)]


def _largest_of_part(source: Source, histories: list[History], of_cell, weights, prepare: Prepare) -> list[np.ndarray]:
    sums = [np.zeros((len(w), 2)) for w in weights]
    names = sorted({n for h in histories for n in h.names})
    for part in batches.parts(source, histories[0].layout, names, prepare):
        for history, own, of_fold, out in zip(histories, of_cell, weights, sums, strict=True):
            rows = history.columns(part.batch)
            rows = np.where(np.isfinite(rows.sum(axis=1))[:, None], rows, 0.0)
            for key, first, end in batches.part_stretches(part):
                if (i := own.get(history.keys[key])) is not None:
                    here = rows[first:end]
                    left = (np.abs(here[:, -1]).max(), np.abs(here @ of_fold[i]).max())
                    out[i] = np.maximum(out[i], left)
    return sums
