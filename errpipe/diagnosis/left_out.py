"""Prediction of held-out rows by an explanation fitted without them; which findings held-out rows support.

If each session has its own datum, that of a held-out session is estimated from its first rows, which are not scored.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.special import chdtrc

from errpipe.diagnosis.admit import AdmittedShapes
from errpipe.diagnosis.coloured import whiten
from errpipe.diagnosis.evidence import ActiveSet, Data
from errpipe.diagnosis.gains import Nuisance
from errpipe.diagnosis.hypotheses import Library
from errpipe.diagnosis.search import Search
from errpipe.diagnosis.shapes import Shape
from errpipe.domain.recording import Recording
from errpipe.terms import MANY_STARTS

FIRST_READINGS, ROWS_ZEROED = 3, 30  # readings that show a session's zero; rows that it must have
AT_ZERO = 0.3  # their rms, over that of all readings; drifting noise accounts for part of it
BY_CHANCE = 0.02  # probability that readings oscillating about zero start this close to it
ZEROED = 5  # first rows of a held-out session, from which its datum is estimated


@dataclass
class LeftOut:
    """A response's columns before whitening, and the scoring of held-out rows.

    recal: columns of the nuisances (rows, k); session: of each row, if each session has its own datum, else None.
    """

    library: Library
    recording: Recording
    rows: np.ndarray
    y: np.ndarray
    recal: np.ndarray
    session: np.ndarray | None
    free_shapes: list[Shape]
    _blocks: dict[int, np.ndarray] = field(default_factory=dict)

    def columns(self, chosen: list[int], shapes: tuple[int, ...] = ()) -> np.ndarray:
        """Columns of nuisances, hypotheses and shapes, in the order of their active columns, shape (rows, k)."""
        for i in chosen:
            if i not in self._blocks:
                self._blocks[i] = self.library.block(i, self.recording, self.rows)
        return np.column_stack(
            [self.recal, *[self._blocks[i] for i in chosen], *[self.free_shapes[k].columns for k in shapes]]
        )

    def zeroed(self, values: np.ndarray, test: np.ndarray) -> np.ndarray:
        """Values of the scored rows of `test`, minus the datum of their session."""
        if self.session is None:
            return values
        session, out = self.session[test], []
        for s in np.unique(session):
            inside = values[session == s]
            out.append(inside[ZEROED:] - inside[:ZEROED].mean())
        return np.concatenate(out)

    def left(self, data: Data, active: ActiveSet, sigma: float, columns: np.ndarray, fold: int) -> np.ndarray:
        """Residual on this fold's rows of a fit to `data` without the fold."""
        test = self.library.table.rows[fold]
        b = coefficients(data, active, sigma, fold if fold != data.without else None)
        return self.zeroed(self.y[test] - columns[test] @ b, test)

    def whitened(self, data: Data, active: ActiveSet, sigma: float, columns: np.ndarray, fold: int) -> np.ndarray:
        """As `left`, each row minus the noise predicted from its neighbours."""
        if self.session is not None:
            return self.left(data, active, sigma, columns, fold)
        table = self.library.table
        b = coefficients(data, active, sigma, fold if fold != data.without else None)
        return whiten(self.y - columns @ b, table.run, table.colour)[table.rows[fold]]

    def mean_square(self, data: Data, active: ActiveSet, sigma: float, columns: np.ndarray) -> float:
        """Mean square of the cross-validation residual over the folds of `data`."""
        folds = [f for f, rows in enumerate(self.library.table.rows) if f != data.without and rows.size]
        return float(np.mean(np.concatenate([self.whitened(data, active, sigma, columns, f) for f in folds]) ** 2))

    def of_explanation(self, search: Search, chosen: list[tuple[int, float]]) -> float:
        """The same of chosen hypotheses in a search."""
        columns = self.columns([i for i, _ in chosen])
        return self.mean_square(search.data, search.active(chosen), search.noise, columns)


def coefficients(data: Data, active: ActiveSet, sigma: float, without: int | None) -> np.ndarray:
    """Posterior mean of the active columns' coefficients, with one more fold held out."""
    table, i = data.table, active.index
    G, s = table.products(i, i, data.without), data.products()[i]
    if without is not None:
        rows = table.rows[without]
        W = table.whitened[np.ix_(rows, i)]
        G, s = G - W.T @ W, s - W.T @ data.y[rows]
    prior = np.where(np.isinf(active.sd), 0.0, sigma**2 / np.maximum(active.sd, 1e-300) ** 2)
    return np.linalg.solve(G + np.diag(prior + 1e-11 * np.diag(G) + 1e-300), s)


def datums(
    recording: Recording, rows: np.ndarray, session: np.ndarray, library: Library, y: np.ndarray, few: bool
) -> tuple[ActiveSet, np.ndarray, list[Nuisance]] | None:
    """A datum for each session, for an instrument that is zeroed whenever the machine is started: columns in the
    library with their freedom, the same before whitening, their meaning. None if there are too few starts.

    session: of each row; y: the mismatch, whose spread between sessions sets the freedom; few: two starts suffice.
    Runs that follow each other without a long pause share a datum: a step between them is physics.
    """
    codes, first, inside, count = np.unique(session, return_index=True, return_inverse=True, return_counts=True)
    if codes.size < (2 if few else MANY_STARTS):
        return None
    level = np.bincount(inside, y) / count
    columns = (session[:, None] == codes).astype(float)
    columns -= columns.mean(axis=0)
    sd = np.full(codes.size, max(float(np.std(level)), 1e-12))
    labels = [recording.run_labels()[r] for r in recording.run_codes()[rows[first]]]
    each = [Nuisance("session datum", f"datum of run {label}") for label in labels]
    return ActiveSet(library.table.add(columns), sd), columns, each


def zeroed_at_starts(error: np.ndarray, session: np.ndarray) -> bool:
    """Do at least two sessions begin at zero, because the probes are zeroed at the start (ISO 230-3)?

    error: recorded values; session: of each of these rows.
    """
    _, first, count = np.unique(session, return_index=True, return_counts=True)
    if first.size < 2 or count.min() < ROWS_ZEROED:
        return False
    levels = [float(np.mean(error[k : k + FIRST_READINGS])) for k in first]
    if np.sqrt(np.mean(np.square(levels))) >= AT_ZERO * np.sqrt(np.mean(error**2)):
        return False
    mean = np.full(FIRST_READINGS, 1.0 / FIRST_READINGS)
    means = [np.abs(np.convolve(error[k : k + n], mean, "valid")) for k, n in zip(first, count, strict=True)]
    as_near = [np.mean(m <= m[0] + 1e-12) for m in means]
    return bool(chdtrc(2 * first.size, -2.0 * np.sum(np.log(as_near))) < BY_CHANCE)  # Fisher's combined probability


def supported_by_held_out(search: Search, chosen: list[tuple[int, float]], judged: LeftOut) -> list[tuple[int, float]]:
    """The leading findings, strongest first, that predict held-out sessions best; the first is always kept.

    Only if sessions have their own datums: their rows are then strongly correlated, and overfitted by a further one.
    """
    if judged.session is None or len(chosen) < 2:
        return chosen
    return min((chosen[:k] for k in range(1, len(chosen) + 1)), key=lambda way: judged.of_explanation(search, way))


def predicts_held_out(search: Search, chosen: list[tuple[int, float]], rest: AdmittedShapes, judged: LeftOut) -> bool:
    """Do unnamed shapes predict held-out rows? What differs from session to session is not the shape of a mechanism."""
    columns = judged.columns([i for i, _ in chosen], rest.taken)
    return judged.mean_square(search.data, rest.active, search.noise, columns) < judged.of_explanation(search, chosen)
