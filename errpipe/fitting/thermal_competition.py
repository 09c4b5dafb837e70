"""Thermal models of several families compete on groups left out, and the best mixture of them is fitted.

Every entrant predicts each run by gains that never saw it, nor (asked once per grouping) its season, its duty cycle or
its day. Of each family the setting with the least error over all groupings enters the mixture; the weights are
least squares with no negative weight and a sum of at most one (stacked regression, Breiman 1996), so that doing
nothing and partial gains compete. An entrant that the mixture is not better with than by chance, run by run, leaves.
All of this sees the fitted rows only: who judges the result has had no say in any choice.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import nnls
from scipy.stats import t as student

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout

MOST_FOLDS = 10  # of a grouping; more groups are left out in as many batches
LEVEL = (
    0.5  # p over runs above which a further entrant counts as chance; chosen: it joins a mixture, it replaces nothing
)
LEAST_WEIGHT = 0.05  # a share of the prediction below which an entrant is not worth its operations in a table
FEWEST_RUNS = 3  # on either side of a split by the warmth of the start
RUN = "run"
# Weight of the residuals of every other grouping beside those of runs left out. Chosen on: seeds 1 to 3 of
# `trials.thermal`, where weights of 1 choose models too simple, since a fold then learns from half the data only.
OTHER_GROUPINGS = 0.5
WHOLE = 1e3  # weight of the row that holds the sum of weights at one, beside rows of unit mean square

Groups = tuple[int, ...]
Parts = tuple[tuple[str, float, d.Driver], ...]


@dataclass(frozen=True)
class Entrant:
    """One setting of a family.

    predict: groups to learn from -> deviation since the start of the run on every row, um, (rows,).
    parts: the same as named gains (um/K) times drivers (K), for a table. physical: gains are held to signs that physics
    allows, so that it may be used in surroundings that no fitted run vouches for.
    """

    family: str
    name: str
    predict: Callable[[Groups], np.ndarray]
    parts: Callable[[Groups], Parts]
    physical: bool = False


@dataclass(frozen=True)
class Grouping:
    """A way to leave groups out: its name and its folds, each a tuple of the groups that sit out."""

    name: str
    folds: tuple[Groups, ...]


@dataclass(frozen=True)
class Outcome:
    """weights: entrant -> share of the mixture; left: grouping -> entrant's name (or "mixture", "nothing") -> rms, um.

    residuals: grouping -> what the mixture leaves on groups left out, um, (rows,), NaN where nothing judged.
    """

    weights: tuple[tuple[Entrant, float], ...]
    left: Mapping[str, Mapping[str, float]]
    predictions: Mapping[str, np.ndarray] = field(default_factory=dict)


def groupings(recording: Recording, group: np.ndarray, groups: Sequence[int]) -> tuple[Grouping, ...]:
    """Runs, and every label by which runs can be left out together: season, duty cycle, day, machine."""
    found = [Grouping(RUN, _batches([(g,) for g in groups]))]
    first = {g: int(np.flatnonzero(group == g)[0]) for g in groups}
    for name in recording.names("group"):
        labels = holdout.labels(recording, name)
        members: dict[str, list[int]] = {}
        for g in groups:
            members.setdefault(str(labels[first[g]]), []).append(g)
        if 1 < len(members) < len(groups):
            told = str(recording.manifest.columns[name].of or name)
            found.append(Grouping(told, _batches([tuple(m) for m in members.values()])))
    warmth = _start_warmth(recording, first)
    order = sorted(groups, key=lambda g: (warmth[g], g))
    half = len(order) // 2
    if half >= FEWEST_RUNS:
        found.append(Grouping("cold or warm starts", (tuple(order[:half]), tuple(order[half:]))))
    return tuple(found)


def _start_warmth(recording: Recording, first: Mapping[int, int]) -> dict[int, float]:
    """Mean temperature at the first usable row of each group, degC."""
    names = recording.names("temperature")
    level = np.nanmean(np.column_stack([recording.array(n) for n in names]), axis=1)
    return {g: float(np.nan_to_num(level[row])) for g, row in first.items()}


def _batches(folds: Sequence[Groups]) -> tuple[Groups, ...]:
    if len(folds) <= MOST_FOLDS:
        return tuple(folds)
    number = [k * MOST_FOLDS // len(folds) for k in range(len(folds))]
    return tuple(
        tuple(g for k, fold in zip(number, folds, strict=True) if k == n for g in fold) for n in range(MOST_FOLDS)
    )


def compete(
    entrants: Sequence[Entrant], ways: Sequence[Grouping], response: np.ndarray, rows: np.ndarray, group: np.ndarray
) -> Outcome:
    """The mixture of entrants. response: um, (rows,); rows: mask of usable rows; group: run of each row.

    Raises DataError where nothing can be left out.
    """
    groups = tuple(int(g) for g in np.unique(group[rows]))
    left_out = {w.name: [_left_out(e, w, groups, rows, group) for e in entrants] for w in ways if len(w.folds) > 1}
    if not left_out:
        raise DataError("thermal model: only one group of rows, so families cannot be compared")
    seen = {name: rows & np.isfinite(np.array(p)).all(axis=0) for name, p in left_out.items()}
    vote = [1.0 if name == RUN else OTHER_GROUPINGS**2 for name in left_out]
    score = [
        float(np.average([_share(response, p[k], seen[n]) for n, p in left_out.items()], weights=vote))
        for k in range(len(entrants))
    ]
    best: dict[str, int] = {}
    for k, entrant in enumerate(entrants):
        if entrant.family not in best or score[k] < score[best[entrant.family]]:
            best[entrant.family] = k
    chosen = sorted(best.values(), key=lambda k: score[k])
    weights = _selected(chosen, left_out, seen, response, group)
    left, predictions = {}, {}
    for name, predicted in left_out.items():
        total = sum((w * predicted[k] for k, w in weights.items()), np.zeros(response.size))
        predictions[name] = np.where(seen[name], total, np.nan)
        left[name] = {"nothing": _rms(response[seen[name]])}
        left[name] |= {entrants[k].name: _rms((response - predicted[k])[seen[name]]) for k in chosen}
        left[name]["mixture"] = _rms((response - total)[seen[name]])
    return Outcome(tuple((entrants[k], w) for k, w in weights.items()), left, predictions)


def _left_out(entrant: Entrant, way: Grouping, groups: Groups, rows: np.ndarray, group: np.ndarray) -> np.ndarray:
    out = np.full(rows.size, np.nan)
    for fold in way.folds:
        rest = tuple(g for g in groups if g not in fold)
        if rest:
            here = rows & np.isin(group, fold)
            out[here] = entrant.predict(rest)[here]
    return out


def _selected(
    chosen: Sequence[int],
    left_out: Mapping[str, Sequence[np.ndarray]],
    seen: Mapping[str, np.ndarray],
    response: np.ndarray,
    group: np.ndarray,
) -> dict[int, float]:
    """Weights of the entrants that the mixture is better with, run by run; added one by one, the best first."""
    kept: list[int] = []
    weights: dict[int, float] = {}
    for k in chosen:
        tried = _weights([*kept, k], left_out, seen, response)
        if tried.get(k, 0.0) >= LEAST_WEIGHT and _better(tried, weights, left_out, seen, response, group):
            kept.append(k)
            weights = tried
    return {k: w for k, w in weights.items() if w >= LEAST_WEIGHT}


def _weights(kept, left_out, seen, response) -> dict[int, float]:
    """Least squares over all groupings, each of the same total weight; no negative weight, a sum of at most one."""
    designs, rights = [], []
    for name, predicted in left_out.items():
        mask = seen[name]
        size = (np.sqrt(np.sum(response[mask] ** 2)) or 1.0) / (1.0 if name == RUN else OTHER_GROUPINGS)
        designs.append(np.column_stack([predicted[k][mask] for k in kept]) / size)
        rights.append(response[mask] / size)
    design, right = np.vstack(designs), np.concatenate(rights)
    found, _ = nnls(design, right)
    if found.sum() > 1.0:
        found, _ = nnls(np.vstack([design, np.full(len(kept), WHOLE)]), np.r_[right, WHOLE])
    return dict(zip(kept, map(float, found), strict=True))


def _better(new, old, left_out, seen, response, group) -> bool:
    """Whether a mixture leaves less than another one by more than chance: paired t over runs, all groupings."""
    gained: dict[int, float] = {}
    for name, predicted in left_out.items():
        mask = seen[name]
        size = float(np.mean(response[mask] ** 2)) or 1.0
        squares = []
        for weights in (old, new):
            total = sum((w * predicted[k] for k, w in weights.items()), np.zeros(response.size))
            squares.append((response - total) ** 2)
        for g in np.unique(group[mask]):
            here = mask & (group == g)
            gained[int(g)] = gained.get(int(g), 0.0) + float(np.mean((squares[0] - squares[1])[here])) / size
    values = np.array(list(gained.values()))
    if values.mean() <= 0.0:
        return False
    spread = values.std(ddof=1) if values.size > 1 else np.inf
    if spread == 0.0:
        return True
    return float(student.sf(values.mean() / (spread / np.sqrt(values.size)), max(values.size - 1, 1))) < LEVEL


def _share(response: np.ndarray, predicted: np.ndarray, mask: np.ndarray) -> float:
    """Logarithm of the mean square left over that of doing nothing."""
    below = float(np.mean(response[mask] ** 2))
    return float(np.log((np.mean((response - predicted)[mask] ** 2) + 1e-12) / (below + 1e-12)))


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
