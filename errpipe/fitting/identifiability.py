"""Identifiability on given rows: variance inflation, the collinear pair, its cause and a remedy."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import NotIdentifiable
from errpipe.fitting.solve import one_thread
from errpipe.terms import TERMS

MAX_INFLATION = 200.0  # of a variance by the other columns: a correlation of 0.9975; beyond it the names are arbitrary


@dataclass(frozen=True)
class DesignColumn:
    """One design column: parameter, term, the columns of the recording that drive it."""

    parameter: str
    term: str
    drivers: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.parameter} ({self.term})"


@one_thread()
def check(
    design: np.ndarray,
    names: Sequence[DesignColumn],
    recording: Recording,
    *,
    component: str,
    penalty: np.ndarray | None = None,
    most: float = MAX_INFLATION,
) -> np.ndarray:
    """Variance inflation of each column, shape (p,), about the level if the design has one.

    Raises NotIdentifiable with the collinear columns, and a remedy. A constant column is also
    rejected.
    """
    length = np.sqrt(np.sum(design**2, axis=0))
    for k in np.flatnonzero(length == 0):
        raise NotIdentifiable(_is_constant(names[int(k)], component))
    scaled = design / length
    gram = scaled.T @ scaled
    if penalty is not None:
        gram = gram + penalty / np.outer(length, length)
    level = [k for k, n in enumerate(names) if n.term in TERMS.tags and TERMS[n.term].is_level]
    size = np.sqrt(np.diag(gram))  # scaled: a strong penalty would make other columns look like rounding errors
    values, vectors = np.linalg.eigh(gram / np.outer(size, size))
    varying = np.sqrt(np.maximum(1.0 - scaled.shape[0] * scaled.mean(axis=0) ** 2, 1e-12))  # what is not the mean
    spread = varying if level else np.ones(design.shape[1])
    if values[0] <= 1e-13 * values[-1]:
        direction = _without_level(vectors[:, 0] / size, level, scaled)
        raise NotIdentifiable(_words(direction, scaled, names, recording, component))
    inverse = vectors / values @ vectors.T / np.outer(size, size)
    inflation = np.diag(inverse) * spread**2
    inflation[level] = 1.0
    worst = int(np.argmax(inflation))
    if inflation[worst] > most:
        direction = inverse[:, worst] / np.sqrt(np.diag(inverse) * inverse[worst, worst])
        direction[level] = 0.0
        raise NotIdentifiable(_words(direction, scaled, names, recording, component))
    return inflation


def _without_level(direction: np.ndarray, level: list[int], scaled: np.ndarray) -> np.ndarray:
    """The same direction about the level, if two other columns are already collinear there."""
    about = direction.copy()
    about[level] = 0.0
    one, two = np.argsort(-np.abs(about), kind="stable")[:2] if direction.size > 1 else (0, 0)
    collinear = one != two and abs(about[two]) > 0.0 and abs(_correlation(scaled[:, one], scaled[:, two])) > 0.95
    return about if collinear else direction


def _words(direction, scaled, names, recording, component) -> str:
    order = np.argsort(-np.round(np.abs(direction) / np.abs(direction).max(), 6), kind="stable")  # ties: as listed
    one, two = names[order[0]], names[order[1]]
    r = _correlation(scaled[:, order[0]], scaled[:, order[1]])
    involved = [names[k] for k in order if abs(direction[k]) > 0.1 * abs(direction[order[0]])]
    if abs(r) < 0.95 and len(involved) > 2:
        listed = ", ".join(map(str, involved[1:6]))
        return (
            f"fit: {one} of {component} is a combination of {listed}"
            + (" and others" if len(involved) > 6 else "")
            + f" on these rows.\n     {_remedy(one, two, recording)}"
        )
    why = _why(one, two, recording)
    return (
        f"fit: {one} and {two} of {component} cannot be distinguished: {why} (correlation {abs(r):.3f})."
        f"\n     {_remedy(one, two, recording)}"
    )


def _is_constant(name: DesignColumn, component: str) -> str:
    what = " and ".join(name.drivers) or "its driver"
    return (
        f"fit: {name} of {component} cannot be estimated: {what} is zero or constant on all rows."
        f"\n     Omit the term, or record a run in which {what} changes."
    )


def _why(one: DesignColumn, two: DesignColumn, recording: Recording) -> str:
    first = [c for c in one.drivers if c not in two.drivers]
    second = [c for c in two.drivers if c not in one.drivers]
    for a in first:
        for b in second:
            if _numeric(recording, a) and _numeric(recording, b):
                r = _correlation(recording.array(a), recording.array(b))
                if abs(r) > 0.95:
                    return f"{a} {'rose' if r > 0 else 'fell'} with {b}"
    for c in (*first, *second):
        if c in recording.names("temperature"):
            return f"{c} hardly changed"
    return "they are equivalent" if not first and not second else "their columns move together in every run"


def _remedy(one: DesignColumn, two: DesignColumn, recording: Recording) -> str:
    temperatures = set(recording.names("temperature"))
    first, second = set(one.drivers) & temperatures, set(two.drivers) & temperatures
    if not set(one.drivers) ^ set(two.drivers):
        return "Omit one of them, or fix its value."
    if first and second and first != second:
        return "Omit one sensor, use method: ridge, or record a run in which the two temperatures differ."
    if first | second:
        return "Fix one of them, or record runs at clearly different temperatures."
    return "Fix one of them, or record a run in which they differ."


def _numeric(recording: Recording, name: str) -> bool:
    return name in recording.frame.columns and recording.frame[name].dtype.kind == "f"


def _correlation(a: np.ndarray, b: np.ndarray) -> float:
    known = np.isfinite(a) & np.isfinite(b)
    x, y = a[known] - a[known].mean(), b[known] - b[known].mean()
    size = np.sqrt(float(x @ x) * float(y @ y))
    if size < 1e-12:  # a level: compare as they stand
        x, y = a[known], b[known]
        size = np.sqrt(float(x @ x) * float(y @ y))
    return float(x @ y / size) if size > 0 else 1.0
