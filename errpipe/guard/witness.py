"""Two witnesses for a sensor: disjoint sets of others that each tell how it should move over the next hours.

Disjoint, so that one sensor that lies cannot carry both away. Small, where few tell as much as many: what many
together say of one in spring they no longer say in winter.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from errpipe.guard import description as g

WITHIN = 0.9  # of the time a healthy reading departs less from a witness
WORTH_A_SECOND = 0.75  # times the corridor of the best one sensor: a pair is taken where it is narrower
RIDGE = 1e-3  # times the mean square of the columns
LEAST = 1e-6  # K


@dataclass(frozen=True)
class Rows:
    """Healthy readings. shifts, rises: shape (rows, kinds, sensors), what weights come from and what is judged.

    group: (rows,), left out one by one; lags: s, of the kinds; lagged: columns, s -> lagged columns.
    """

    names: tuple[str, ...]
    shifts: np.ndarray
    rises: np.ndarray
    group: np.ndarray
    lags: tuple[float | None, ...]
    lagged: Callable[[np.ndarray, float], np.ndarray]
    hours: float

    def squares(self) -> dict[int, np.ndarray]:
        """Of all columns with each other, per group."""
        flat = self.shifts.reshape(len(self.shifts), -1)
        return {int(c): flat[self.group == c].T @ flat[self.group == c] for c in np.unique(self.group)}


def witnesses(rows: Rows, name: str) -> tuple[g.Witness, ...]:
    """The closest sensor, or pair, and beside a sensor the second closest one, beside a pair all the rest."""
    own, count = rows.names.index(name), len(rows.names)
    others = [j for j in range(count) if j != own]
    squares = rows.squares()
    single = sorted((_witness(rows, squares, own, (j,)) for j in others), key=_width)
    if count < 4:
        return tuple(single[:2])
    pairs = [(p, _witness(rows, squares, own, p)) for p in combinations(others, 2)]
    members, pair = min(pairs, key=lambda found: _width(found[1]))
    if pair.within > WORTH_A_SECOND * single[0].within:
        return tuple(single[:2])
    return pair, _witness(rows, squares, own, tuple(j for j in others if j not in members))


def _width(witness: g.Witness) -> float:
    return witness.within


def _witness(rows: Rows, squares: dict[int, np.ndarray], own: int, chosen: tuple[int, ...]) -> g.Witness:
    count = len(rows.names)
    columns = [kind * count + j for kind in range(len(rows.lags)) for j in chosen]
    flat, total = rows.rises.reshape(len(rows.rises), -1), sum(squares.values())
    departed = flat[:, own].copy()
    for c, square in squares.items():
        mine = rows.group == c
        departed[mine] -= flat[np.ix_(mine, columns)] @ _solve(total - square, columns, own)
    recent = np.abs(departed - rows.lagged(departed[:, None], rows.hours)[:, 0])
    return g.Witness(
        sources=tuple(g.Source(name=rows.names[j], lag_s=lag) for lag in rows.lags for j in chosen),
        weights=tuple(float(w) for w in _solve(total, columns, own)),
        within=max(float(np.quantile(recent, WITHIN)), LEAST),
    )


def _solve(square: np.ndarray, columns: list[int], own: int) -> np.ndarray:
    part = square[np.ix_(columns, columns)].copy()
    part[np.diag_indices_from(part)] += RIDGE * np.mean(np.diag(part))
    return np.linalg.solve(part, square[columns, own])
