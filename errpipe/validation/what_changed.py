"""Terms of a model that its residual suggests to change: the machine's change in terms of the model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain.error_model import ComponentModel, ErrorModel, FittedTerm
from errpipe.domain.recording import Recording
from errpipe.fitting.components import from_run_start, term_of

MAX_NAMED_TERMS = 3  # terms that are named; a change of more terms is not specific
MIN_EXPLAINED_SHARE = 0.02  # of the variance beyond the noise that a further term must explain: a seventh of the rms
NEARLY = 0.9  # share of the best term's variance: a term with fewer parameters that explains as much is preferred
SIGNIFICANT = 4.0  # standard errors of the mean square of noise: threshold of a change
AGAIN = 6.0  # standard errors of a second change of the level: chosen on simulated axes, seed 1
FEWEST = 5  # runs since a second change: a challenger needs at least this many
SHOWN = 2  # parameters printed per term
LARGEST_CONDITION = 1e8  # more collinear columns are not solved for together


@dataclass(frozen=True)
class TermChange:
    """says: parameters before and after; size: rms of the change, um (urad); unexplained: by no term of the model."""

    term: str
    says: str
    size: float


def what_changed(
    model: ErrorModel, component: ComponentModel, recording: Recording, residual: np.ndarray, noise: float
) -> list[TermChange]:
    """The fewest terms whose linear parameters explain a residual, the largest first; the unexplained part last.

    residual: measured minus predicted on the rows since the change, um (urad), (rows,), NaN if unknown; noise: its
    rms before the change. Terms are added one by one, each fitted with those before it by least squares.
    """
    known = np.isfinite(residual)
    bases = [_columns(model, component, fitted, recording) for fitted in component.terms]
    for basis in bases:
        known = known & np.isfinite(basis).all(axis=1)
    if not known.any():
        return []
    r, bases = residual[known], [basis[known] for basis in bases]
    begin = float(np.mean(r**2))
    chosen: list[int] = []
    beyond = left = begin - noise**2
    least = SIGNIFICANT * noise**2 * np.sqrt(2.0 / r.size)
    if beyond < least:
        return []
    least = max(least, MIN_EXPLAINED_SHARE * beyond)
    while left > least and len(chosen) < MAX_NAMED_TERMS:
        trials = {
            k: left - (_mean_square_residual(bases, [*chosen, k], r) - noise**2)
            for k in range(len(bases))
            if k not in chosen
        }
        good = [k for k, taken in trials.items() if taken >= max(NEARLY * max(trials.values()), least)]
        if not good:
            break
        chosen.append(min(good, key=lambda k: (bases[k].shape[1], -trials[k])))
        left -= trials[chosen[-1]]
    out = [
        _term_change(component, component.terms[k], bases[k], steps)
        for k, steps in zip(chosen, _steps(bases, chosen, r), strict=True)
    ]
    if left > 0.5 * beyond:
        out.append(TermChange("", "no term of the model explains the rest", float(np.sqrt(left))))
    return sorted(out, key=lambda c: (not c.term, -c.size))


def changed_again(
    model: ErrorModel,
    component: ComponentModel,
    recording: Recording,
    residual: np.ndarray,
    reference: np.ndarray,
    first: int,
) -> int:
    """Number of runs after run `first`, at which a machine changed, until its level changed again; 0 if it did not.

    residual: as of `what_changed`, of all rows; reference: rows before the first change, (rows,). Means of the runs
    since then: a step at the likeliest run, with all linear terms, over the standard deviation between reference runs.
    """
    run = recording.run_codes()
    columns = np.column_stack([residual, *(_columns(model, component, f, recording) for f in component.terms)])
    known = np.isfinite(columns).all(axis=1)
    old = [float(np.mean(residual[known & (run == c)])) for c in np.unique(run[known & reference])]
    codes = np.unique(run[known & (run >= first)])
    means = np.array([columns[known & (run == c)].mean(axis=0) for c in codes])
    if len(old) < 2 or len(codes) < FEWEST + 1:
        return 0
    steps = np.tri(len(codes), k=-1)[:, : len(codes) - FEWEST]  # of the runs after the first, the second, ...
    design = means[:, 1:] / np.maximum(np.abs(means[:, 1:]).max(axis=0), 1e-12)
    basis, size, _ = np.linalg.svd(design, full_matrices=False)
    basis = basis[:, size > size.max(initial=0.0) / LARGEST_CONDITION]
    level, steps = (v - basis @ (basis.T @ v) for v in (means[:, 0], steps))
    length = np.sqrt(np.sum(steps**2, axis=0))
    z = np.abs(level @ steps) / np.maximum(length, 0.1) / max(float(np.std(old, ddof=1)), 1e-9)
    best = int(np.argmax(z))
    return int(codes[best + 1]) - first if z[best] > AGAIN else 0


def _columns(model: ErrorModel, component: ComponentModel, fitted: FittedTerm, recording: Recording) -> np.ndarray:
    """Change of the deviation per unit of each linear parameter of a term, (rows, parameters)."""
    term, values = term_of(fitted), fitted.values()
    before = term.value(recording, values)
    columns = []
    for parameter in term.linear():
        one_more = dict(values) | {parameter.name: values[parameter.name] + 1.0}
        step = component.gain * (term.value(recording, one_more) - before)
        columns.append(from_run_start(recording, step) if model.datum == "run_start" else step)
    return np.column_stack(columns) if columns else np.zeros((len(recording), 0))


def _steps(bases: Sequence[np.ndarray], chosen: Sequence[int], r: np.ndarray) -> list[np.ndarray]:
    if not chosen:
        return []
    design = np.column_stack([bases[k] for k in chosen])
    scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-12)
    solved = np.linalg.lstsq(design / scale, r, rcond=1.0 / LARGEST_CONDITION)[0] / scale
    return list(np.split(solved, np.cumsum([bases[k].shape[1] for k in chosen])[:-1]))


def _mean_square_residual(bases: Sequence[np.ndarray], chosen: Sequence[int], r: np.ndarray) -> float:
    steps = _steps(bases, chosen, r)
    return float(np.mean((r - sum(bases[k] @ s for k, s in zip(chosen, steps, strict=True))) ** 2))


def _term_change(component: ComponentModel, fitted: FittedTerm, basis: np.ndarray, steps: np.ndarray) -> TermChange:
    name, size = fitted.term["term"], float(np.sqrt(np.mean((basis @ steps) ** 2)))
    bound = [value for key, value in fitted.term.items() if key != "term" and isinstance(value, str)]
    twins = [other.term["term"] for other in component.terms].count(name) > 1
    label = f"{name} of {', '.join(bound)}" if twins and bound else name
    parameters = {p.name: p for p in fitted.parameters}
    if len(steps) > SHOWN:
        return TermChange(name, f"{label} by {size:.3g} um rms", size)
    moved = []
    for declared, step in zip(term_of(fitted).linear(), steps, strict=True):
        p = parameters[declared.name]
        moved.append(f"{p.name} {p.value:.3g} -> {p.value + step:.3g} {p.unit}")
    return TermChange(name, f"{label}: {', '.join(moved)}", size)
