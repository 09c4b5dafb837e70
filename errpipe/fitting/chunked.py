"""Fit recordings that do not fit into memory: rows come in chunks, several times over, and are never kept.

Four passes: ranges (spans of curves, validity), the streaming decomposition, the noise's memory from a sample of whole
runs, and the covariance. A run must not be cut in two by chunks where a term remembers (a lag, a direction of travel).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator

import numpy as np
import pandas as pd

from errpipe import __version__
from errpipe.domain.error_model import ComponentModel, ErrorModel, Validity
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import uncertainty
from errpipe.fitting.components import fitted_term, nuisance_of
from errpipe.fitting.design import Problem, assemble, response_name
from errpipe.fitting.estimate import Estimate
from errpipe.fitting.spec import ComponentSpec, ModelSpec
from errpipe.fitting.streaming import StreamingFit
from errpipe.fitting.validity import box
from errpipe.kernels import whitening
from errpipe.terms import Term

Chunks = Callable[[], Iterable[Recording]]
NORMAL90 = 1.645


def fit_chunks(chunks: Chunks, spec: ModelSpec) -> ErrorModel:
    """The error model of `spec` by least squares over chunks of whole runs; `chunks()` starts again from the first row.

    Equals `fit` without hold-outs up to rounding. Raises DataError where the specification needs more than that:
    another method, a penalty, a non-linear parameter that is not fixed, shared nuisance.
    """
    _only_linear(spec)
    ends = _ends(chunks)
    models = [_component(chunks, spec, component, ends) for component in spec.components]
    names = list(dict.fromkeys(n for c in spec.components for t in c.terms for n in t.drivers(ends)))
    return ErrorModel(
        machine=ends.manifest.machine,
        title=ends.manifest.title,
        version=__version__,
        columns={n: ends.manifest.columns[n].model_dump(exclude_none=True) for n in names},
        constants={k: c.model_dump(mode="json", exclude_none=True) for k, c in ends.manifest.constants.items()},
        components=tuple(models),
        validity=box(ends, names, np.ones(len(ends), dtype=bool)) if names else Validity(),
        datum=spec.datum,
        notes=("fitted over chunks: the prediction interval comes from the fitted rows themselves",),
    )


def _only_linear(spec: ModelSpec) -> None:
    if spec.method != "linear" or spec.selection != "none":
        raise DataError(f"fit over chunks: only method linear without selection (found {spec.method})")
    for term in (*(t for c in spec.components for t in c.terms), *spec.nuisance):
        if term.free():
            raise DataError(f"fit over chunks: {term.term} has to search {term.free()[0].name}; fix it")
        if term.penalty() is not None or hasattr(term, "shared"):
            raise DataError(f"fit over chunks: {term.term} needs all rows at once")
    if any(c.priors for c in spec.components):
        raise DataError("fit over chunks: priors are not kept")


def _ends(chunks: Chunks) -> Recording:
    """A recording of few rows that spans all of them: lowest and highest value per column, every run's label."""
    low: pd.Series | None = None
    high: pd.Series | None = None
    labels: dict[str, None] = {}
    manifest = None
    for chunk in chunks():
        numbers = chunk.frame.select_dtypes("number")
        low = numbers.min() if low is None else np.minimum(low.fillna(np.inf), numbers.min().fillna(np.inf))
        high = numbers.max() if high is None else np.maximum(high.fillna(-np.inf), numbers.max().fillna(-np.inf))
        labels.update(dict.fromkeys(chunk.run_labels()))
        manifest = chunk.manifest
    if low is None or high is None or manifest is None:
        raise DataError("fit over chunks: no rows")
    rows = max(len(labels), 2)
    frame = pd.DataFrame({name: [low[name]] + [high[name]] * (rows - 1) for name in low.index})
    run = next((n for n, c in manifest.columns.items() if c.role == "run"), None)
    if run is not None:
        frame[run] = [*labels, *[next(iter(labels))] * (rows - len(labels))]
    return Recording(manifest, frame)


def _problems(chunks: Chunks, component: ComponentSpec, terms, nuisance) -> Iterator[Problem]:
    for chunk in chunks():
        try:
            yield assemble(chunk, [(component.component, terms)], nuisance)
        except DataError:
            continue  # a chunk that only logs temperatures


def _component(chunks: Chunks, spec: ModelSpec, component: ComponentSpec, ends: Recording) -> ComponentModel:
    terms: list[Term] = [t.settled(ends) for t in component.terms]
    nuisance = [t.settled(ends) for t in nuisance_of(spec)]
    running, before, last = None, 0.0, None
    for problem in _problems(chunks, component, terms, nuisance):
        running = running or StreamingFit(problem.width)
        running.add(problem.design(np.empty(0)), problem.response)
        before += float(problem.response @ problem.response)
        last = problem
    if running is None or last is None:
        raise DataError(f"fit over chunks: no row has both {component.component} and everything its terms need")
    coefficients, inverse, squares = running.solve()
    noise, memory = _noise(chunks, component, terms, nuisance, coefficients)
    spread, apart, runs = np.zeros((running.columns,) * 2), np.zeros((running.columns,) * 2), 0
    for problem in _problems(chunks, component, terms, nuisance):
        design = problem.design(np.empty(0))
        spread += design.T @ whitening.correlated(problem.sequence, design, noise.rho, noise.share)
        more, pulls = uncertainty.between_runs(problem.sequence, design, problem.response - design @ coefficients)
        runs, apart = runs + more, apart + pulls
    degrees = running.rows - running.columns
    sigma2 = squares / max(degrees, 1)
    effective = running.rows * memory
    known = uncertainty.larger(sigma2 * inverse @ spread @ inverse, inverse @ apart @ inverse, runs)
    found = Estimate(
        coefficients,
        np.empty(0),
        np.empty(0),
        float(running.columns),
        (),
        known,
        noise,
        effective,
        uncertainty.degrees_of_freedom(running.rows, running.columns, noise),
    )
    return _told(last, found, component.component, running.rows, before, squares)


def _noise(chunks, component, terms, nuisance, coefficients) -> tuple[uncertainty.Noise, float]:
    """The noise's memory from whole runs, spread over the chunks, and independent rows per row."""
    count = sum(1 for _ in chunks())
    share = max(uncertainty.MOST_ROWS // max(count, 1), 200)
    designs, residuals, sequences, offset = [], [], [], 0
    for problem in _problems(chunks, component, terms, nuisance):
        take = slice(0, share)
        design = problem.design(np.empty(0))[take]
        designs.append(design)
        residuals.append(problem.response[take] - design @ coefficients)
        sequences.append(problem.sequence[take] + offset)
        offset += int(problem.sequence.max()) + 1
    sequence = np.concatenate(sequences)
    noise = uncertainty.noise_model(sequence, np.vstack(designs), np.concatenate(residuals), None)
    return noise, uncertainty.rows_effective(sequence, noise) / sequence.size


def _told(problem: Problem, found: Estimate, component: str, rows: int, before: float, after: float) -> ComponentModel:
    name = response_name(problem.recording, component)
    unit = problem.recording.manifest.columns[name].unit or "um"
    own = [s for s in problem.slots if not s.nuisance]
    index = [k for s in own for k in range(s.columns.start, s.columns.stop)]
    names = [f"{s.term.term}[{k}].{p.name}" for k, s in enumerate(own) for p in s.free]
    rms = float(np.sqrt(after / rows))
    return ComponentModel(
        component=component,
        unit=unit,
        terms=tuple(fitted_term(s, found, problem.width, unit) for s in own),
        nuisance=tuple(fitted_term(s, found, problem.width, unit) for s in problem.slots if s.nuisance),
        parameter_names=tuple(names),
        covariance=tuple(tuple(map(float, row)) for row in found.covariance[np.ix_(index, index)]),
        rows=rows,
        rows_effective=float(found.rows_effective),
        rms_before=float(np.sqrt(before / rows)),
        rms_after=rms,
        half_width90=NORMAL90 * rms,
        widening90=NORMAL90 * rms,
    )
