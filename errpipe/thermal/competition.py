"""Stacked regression of thermal models of several families, chosen by leave-one-group-out.

Every entrant predicts each run with gains fitted without it and, once per grouping, without its season, duty cycle or
day. The setting of each family with the smallest error enters the mixture, whose weights are least squares with no
negative weight and a sum of at most one (stacked regression, Breiman 1996), so that no compensation and partial gains
compete.

Held-out runs decide, and with less weight held-out environments (season, warmth of the start): the next season is
further from the fitted rows than a run between them, but a fit without a season uses about half of the data, and alone
would favour too simple models. An entrant with more than `REGRET` times the best one's rms in held-out environments, or
a larger one than no compensation, is excluded.
Only the fitted rows are used, so that the result can be validated on other rows.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from errpipe.domain import driver as d
from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.statistics import student_tail

MOST_FOLDS = 10  # of a grouping; more groups are held out in as many batches
LEVEL = 0.3  # p over runs, one-sided, above which a partial gain is rejected; 0.1 to 0.5 are equal on seeds 101 to 103
LEAST_WEIGHT = 0.05  # smallest weight of an entrant in the mixture, because each costs operations in a table
FEWEST_RUNS = 3  # on either side of a split by the warmth of the start
RUN = "run"
HALF = "half"  # of one run, by the other half: closer to the next run than a block is
NOTHING, MIXTURE = "nothing", "mixture"  # in addition to the names of entrants
WARMTH = "cold or warm starts"
# Ratio to the rms of the best entrant. Chosen on seeds 1 to 3 of `trials.thermal`: 1.5 has 4 % more rms than 2, 3 has
# 2 % less; entrants excluded by it have 2 to 4 times the rms in another season (turning centre, no signs).
REGRET = 2.0
# Ratio to the rms of the best entrant on blocks of one run, up to which a plain one is used. Chosen on seeds 111, 112
# of `trials.thermal`; stretches of a spindle's run (16 sensors) are within it (1.2 to 2.6) but one.
PLAIN_REGRET = 3.0
# Ratio to the rms of the best entrant on runs of one season, and one-sided p over runs (two-sided 0.05), above and
# below which entrants with possible signs are not used alone. Chosen on 12 simulated machines (seeds 1 to 3), one of 2
# seasons fitted: residual 0.061 of the deviation in the other one with 1.2, 0.065 with 1.5, 0.087 with 1e9; and on 12
# draws of 3 to 6 days of a turning centre: 1.2 without p 12.3 and 26.4 um, with them alone 7.0 and 19.0, 1.5 with p is
# never worse.
PHYSICAL_REGRET, PHYSICAL_LEVEL = 1.5, 0.025
# Weight of held-out environments, and of residuals that count from one reading as a table does instead of from the mean
# of several. Chosen on seeds 8811 and 48811 of `trials.thermal` (36 machines) and 16 machines of eight other kinds:
# third season 0.995 and 0.97 of the residual by runs and means alone; unseen 1.007 (seed 48812, 24 machines; 0.99 from
# one reading) and 0.95 (eight of other kinds, true residual). 0.5 and 0: 1.03, 0.96; 0 and 0.5: 0.98, 1.02.
FURTHER, AT_ONCE = 0.25, 0.25
EXACT = 1e-9  # um2: below it a mean square is rounding
WHOLE = 1e3  # weight of the row that fixes the sum of weights at one, relative to rows of unit mean square

Groups = tuple[int, ...]
Parts = tuple[tuple[str, float, d.Driver], ...]


@dataclass(frozen=True)
class Entrant:
    """One setting of a family.

    predict: training groups -> deviation since the start of the run on every row, um, (rows,).
    parts: the same as named gains (um/K) times drivers (K), for a table. physical: gains are limited to physically
    possible signs, so that it may be used in environments without a fitted run. linear: gains times drivers that do not
    depend on the groups; None: `parts` already are. plain: preferred for one run, if nearly as good.
    """

    family: str
    name: str
    predict: Callable[[Groups], np.ndarray]
    parts: Callable[[Groups], Parts]
    physical: bool = False
    linear: Callable[[Groups], Parts] | None = None
    plain: bool = False


@dataclass(frozen=True)
class Grouping:
    """A hold-out grouping: its name, its folds (each a tuple of the held-out groups) and their labels.

    labels: empty if folds are batches of groups. decides: whether it represents other environments, and may exclude.
    """

    name: str
    folds: tuple[Groups, ...]
    labels: tuple[str, ...] = ()
    decides: bool = True


@dataclass(frozen=True)
class Outcome:
    """weights: entrant -> share of the mixture; left: grouping -> entrant's name (or "mixture", "nothing") -> rms, um.

    predictions: grouping -> prediction of the mixture on held-out groups, um, (rows,), NaN where nothing is judged.
    by_group: grouping -> label of the held-out group -> name -> rms, um. chance: name -> probability that the mixture's
    smaller leave-one-run-out residual is due to chance (paired t test). rivals: the best setting of each family that
    was admitted; apart: variance between their predictions of the first grouping's held-out groups, um2, (rows,).
    """

    weights: tuple[tuple[Entrant, float], ...]
    left: Mapping[str, Mapping[str, float]]
    predictions: Mapping[str, np.ndarray] = field(default_factory=dict)
    by_group: Mapping[str, Mapping[str, Mapping[str, float]]] = field(default_factory=dict)
    chance: Mapping[str, float] = field(default_factory=dict)
    rivals: tuple[Entrant, ...] = ()
    apart: np.ndarray = field(default_factory=lambda: np.zeros(0))


def groupings(recording: Recording, group: np.ndarray, groups: Sequence[int], environment: str) -> tuple[Grouping, ...]:
    """Runs, and every label by which runs can be held out together: season (environment), duty cycle, day, machine."""
    candidates = [Grouping(RUN, _batches([(g,) for g in groups]))]
    first = {g: int(np.flatnonzero(group == g)[0]) for g in groups}
    for name in recording.names("group"):
        labels = holdout.labels(recording, name)
        members: dict[str, list[int]] = {}
        for g in groups:
            members.setdefault(str(labels[first[g]]), []).append(g)
        if 1 < len(members) < len(groups):
            quantity = str(recording.manifest.columns[name].of or name)
            folds = _batches([tuple(m) for m in members.values()])
            of_folds = tuple(members) if len(folds) == len(members) else ()
            candidates.append(Grouping(quantity, folds, of_folds, environment in (quantity, name)))
    if not recording.names("temperature"):
        return tuple(candidates)
    warmth = _start_warmth(recording, group, groups)
    order = sorted(groups, key=lambda g: (warmth[g], g))
    half = len(order) // 2
    if half >= FEWEST_RUNS:
        candidates.append(Grouping(WARMTH, (tuple(order[:half]), tuple(order[half:])), ("cold", "warm")))
    return tuple(candidates)


def halves(groups: Sequence[int]) -> Grouping:
    """Each half of the blocks of a run predicted by the other one; a middle block is in neither."""
    count = len(groups) // 2
    return Grouping(
        HALF, tuple(tuple(g for g in groups if g not in own) for own in (groups[-count:], groups[:count])), (), False
    )


def _start_warmth(recording: Recording, group: np.ndarray, groups: Sequence[int]) -> dict[int, float]:
    """Mean temperature at the first row of each group in which all sensors have a reading, degC."""
    level = np.mean([recording.array(n) for n in recording.names("temperature")], axis=0)
    return {g: float(level[(group == g) & np.isfinite(level)][0]) for g in groups}


def _batches(folds: Sequence[Groups]) -> tuple[Groups, ...]:
    if len(folds) <= MOST_FOLDS:
        return tuple(folds)
    number = [k * MOST_FOLDS // len(folds) for k in range(len(folds))]
    return tuple(
        tuple(g for k, fold in zip(number, folds, strict=True) if k == n for g in fold) for n in range(MOST_FOLDS)
    )


def compete(
    entrants: Sequence[Entrant],
    ways: Sequence[Grouping],
    response: np.ndarray,
    rows: np.ndarray,
    group: np.ndarray,
    ahead: bool = False,
    one_environment: bool = False,
    run: np.ndarray | None = None,
) -> Outcome:
    """The mixture of entrants. response: um, (rows,); rows: mask of usable rows; group: run of each row.

    ahead: groups are consecutive blocks of one run, between which a fit interpolates: the choice is then made on
    stretches that extrapolate (`_within_run_predictions`). one_environment: all rows are of one season, so that
    entrants without possible signs compete only if those with them are already worse there (`PHYSICAL_REGRET`).
    run: run of each row where runs are the groups: environments then decide, too (`FURTHER`).

    Raises DataError if no group can be held out.
    """
    groups = tuple(int(g) for g in np.unique(group[rows]))
    left_out = {
        w.name: np.array([_left_out(e, w, groups, rows, group) for e in entrants]).reshape(len(entrants), rows.size)
        for w in ways
        if len(w.folds) > 1
    }
    if not left_out:
        raise DataError("thermal model: only one group of rows, so families cannot be compared")
    judged = {name: _HeldOutPredictions(p, response, rows, group) for name, p in left_out.items()}
    chooser = judged[RUN] if RUN in judged else next(iter(judged.values()))
    if ahead:
        chooser = _within_run_predictions(entrants, groups, response, rows, group)
    further = [judged[w.name] for w in ways if w.decides and w.name != RUN and w.name in judged]
    judges = _weighted_holdouts(chooser, further, run) if further and run is not None else [(chooser, 1.0)]
    left_by = _mean_square(judges)
    score = np.where(_admitted(judged, {w.name for w in ways if w.decides}), left_by, np.inf)
    if one_environment:
        score = _physical_first(entrants, score, chooser)
    best: dict[str, int] = {}
    for k, entrant in enumerate(entrants):
        so_far = best.setdefault(entrant.family, k)
        if (score[k], left_by[k]) < (score[so_far], left_by[so_far]):
            best[entrant.family] = k
    ranked = sorted(best.values(), key=lambda k: score[k])
    weights = _plain(entrants, judged) if ahead else {}
    admitted = [k for k in ranked if np.isfinite(score[k])]
    weights = weights or _stacked(admitted, _combined(judges, admitted))
    named: dict[str, dict[int, float]] = (
        {NOTHING: {}} | {entrants[k].name: {k: 1.0} for k in ranked} | {MIXTURE: weights}
    )
    left = {way: {name: judge.rms(w) for name, w in named.items()} for way, judge in judged.items()}
    by_group = {w.name: _by_label(w, judged[w.name], named, group) for w in ways if w.labels and w.name in judged}
    mixed = chooser.by_group(weights)
    chance = {name: paired_p_value(chooser.by_group(w) - mixed) for name, w in named.items() if name != MIXTURE}
    predictions = {name: judge.mixture(weights) for name, judge in judged.items()}
    apart = next(iter(judged.values())).predicted[admitted].var(axis=0) if admitted else np.zeros(rows.size)
    rivals = tuple(entrants[k] for k in admitted)
    mixture = tuple((entrants[k], w) for k, w in weights.items())
    return Outcome(mixture, left, predictions, by_group, chance, rivals, apart)


@dataclass(frozen=True)
class _HeldOutPredictions:
    """Predictions of held-out rows by entrants: (entrants, rows) in um, NaN where not validated."""

    predicted: np.ndarray
    response: np.ndarray
    rows: np.ndarray
    group: np.ndarray

    @cached_property
    def seen(self) -> np.ndarray:
        """Mask of the rows that every entrant predicts."""
        return self.rows & np.isfinite(self.predicted).all(axis=0)

    def mean_square(self) -> np.ndarray:
        """Mean square residual of each entrant, every run with equal weight, um2, (entrants,)."""
        return np.array([self.by_group({k: 1.0}).mean() for k in range(len(self.predicted))])

    def from_first_reading(self, run: np.ndarray) -> _HeldOutPredictions:
        """The same, counted from the first row of each run that is judged."""
        rows = np.flatnonzero(self.seen)
        _, first, code = np.unique(run[rows], return_index=True, return_inverse=True)
        start = np.zeros(self.rows.size, dtype=int)
        start[rows] = rows[first][code]
        return replace(
            self, predicted=self.predicted - self.predicted[:, start], response=self.response - self.response[start]
        )

    def mixture(self, weights: Mapping[int, float]) -> np.ndarray:
        """Weighted sum of predictions, um, (rows,); NaN where not validated."""
        total = sum((w * self.predicted[k] for k, w in weights.items()), np.zeros(self.rows.size))
        return np.where(self.seen, total, np.nan)

    def by_group(self, weights: Mapping[int, float]) -> np.ndarray:
        """Mean square residual of a mixture in each run, um2."""
        squares = (self.response - self.mixture(weights))[self.seen] ** 2
        codes = np.unique(self.group[self.seen], return_inverse=True)[1]
        return np.bincount(codes, squares) / np.bincount(codes)

    def rms(self, weights: Mapping[int, float], among: np.ndarray | bool = True) -> float:
        """Residual rms of a mixture on all validated rows, or on those of a mask, um."""
        residual = (self.response - self.mixture(weights))[self.seen & among]
        return float(np.sqrt(np.mean(residual**2))) if residual.size else 0.0


def _weighted_holdouts(
    near: _HeldOutPredictions, further: Sequence[_HeldOutPredictions], run: np.ndarray
) -> list[tuple[_HeldOutPredictions, float]]:
    """Held-out runs and environments, each also counted from a run's first reading as a table does, with weights."""
    judges = [(near, 1.0 - FURTHER), *((judge, FURTHER / len(further)) for judge in further)]
    at_once = [(judge.from_first_reading(run), weight * AT_ONCE) for judge, weight in judges]
    return [*((judge, weight * (1.0 - AT_ONCE)) for judge, weight in judges), *at_once]


def _mean_square(judges: Sequence[tuple[_HeldOutPredictions, float]]) -> np.ndarray:
    """Weighted geometric mean of an entrant's mean square residuals, um2, (entrants,)."""
    if len(judges) == 1:
        return judges[0][0].mean_square()
    return np.asarray(np.exp(sum(weight * np.log(np.maximum(judge.mean_square(), EXACT)) for judge, weight in judges)))


def _combined(judges: Sequence[tuple[_HeldOutPredictions, float]], admitted: Sequence[int]) -> _HeldOutPredictions:
    """The rows of all, scaled so that each has its weight whatever it leaves."""
    if len(judges) == 1 or not admitted:
        return judges[0][0]
    least = [max(judge.mean_square()[admitted].min(), EXACT) for judge, _ in judges]
    scaled = [(judge, np.sqrt(weight * least[0] / own)) for (judge, weight), own in zip(judges, least, strict=True)]
    return _HeldOutPredictions(
        np.hstack([scale * judge.predicted for judge, scale in scaled]),
        np.concatenate([scale * judge.response for judge, scale in scaled]),
        np.concatenate([judge.seen for judge, _ in scaled]),
        np.concatenate([judge.group for judge, _ in scaled]),
    )


def _by_label(
    way: Grouping, judge: _HeldOutPredictions, named: Mapping[str, Mapping[int, float]], group: np.ndarray
) -> dict[str, dict[str, float]]:
    """Label of each held-out group -> name -> rms, um."""
    return {
        label: {name: judge.rms(share, np.isin(group, fold)) for name, share in named.items()}
        for label, fold in zip(way.labels, way.folds, strict=True)
    }


def _admitted(judged: Mapping[str, _HeldOutPredictions], deciding: set[str]) -> np.ndarray:
    """Mask of the entrants that no grouping by environment excludes (see `REGRET`).

    Other groupings are reported and exclude no family: if a fit of half of the duty cycles fails on the others, that is
    little evidence about the next season. Seed 9811 of `trials.thermal`, 24 machines: 2 % less residual.
    """
    count = len(next(iter(judged.values())).predicted)
    regret, useful = np.ones(count), np.ones(count, dtype=bool)
    for name in deciding & set(judged) - {RUN}:
        mean_squares = judged[name].mean_square()
        least = max(mean_squares.min(initial=np.inf), EXACT)
        regret = np.maximum(regret, np.sqrt(mean_squares / least))
        useful &= mean_squares <= judged[name].by_group({}).mean()
    return useful & (regret <= max(REGRET, regret[useful].min(initial=np.inf)))


def _physical_first(entrants: Sequence[Entrant], score: np.ndarray, judged: _HeldOutPredictions) -> np.ndarray:
    """Scores, infinite without physically possible signs unless those with them are significantly worse."""
    signed = np.where([e.physical for e in entrants], score, np.inf)
    if not np.isfinite(signed).any():
        return score
    ahead, best = judged.by_group({int(np.argmin(score)): 1.0}), judged.by_group({int(np.argmin(signed)): 1.0})
    behind = signed.min() > PHYSICAL_REGRET**2 * score.min() and paired_p_value(best - ahead) < PHYSICAL_LEVEL
    return score if behind else signed


def _plain(entrants: Sequence[Entrant], judged: Mapping[str, _HeldOutPredictions]) -> dict[int, float]:
    """The plain entrant with the weight of one if its residual on blocks is nearly that of the best."""
    left = next(iter(judged.values())).mean_square()
    return {k: 1.0 for k, e in enumerate(entrants) if e.plain and left[k] <= PLAIN_REGRET**2 * left.min()}


def _within_run_predictions(
    entrants: Sequence[Entrant], groups: Groups, response: np.ndarray, rows: np.ndarray, group: np.ndarray
) -> _HeldOutPredictions:
    """Predictions by every stretch from either end of a run, of at least half of its blocks, of the remaining blocks.

    Forward chaining (prequential analysis, Dawid 1984) in both directions of time: a later run is beyond all rows.
    """
    rests = [rest for size in range(len(groups) // 2, len(groups)) for rest in (groups[size:], groups[:-size])]
    ways = [Grouping("", (rest,)) for rest in rests]
    predicted = [np.hstack([_left_out(e, way, groups, rows, group) for way in ways]) for e in entrants]
    count = len(ways)
    return _HeldOutPredictions(
        np.array(predicted).reshape(len(entrants), count * rows.size),
        np.tile(response, count),
        np.tile(rows, count),
        np.tile(group, count),
    )


def _left_out(entrant: Entrant, way: Grouping, groups: Groups, rows: np.ndarray, group: np.ndarray) -> np.ndarray:
    out = np.full(rows.size, np.nan)
    for fold in way.folds:
        train = tuple(g for g in groups if g not in fold)
        if train:
            test = rows & np.isin(group, fold)
            out[test] = entrant.predict(train)[test]
    return out


def _stacked(ranked: Sequence[int], judged: _HeldOutPredictions) -> dict[int, float]:
    """Weights of the entrants that jointly predict held-out rows best; small ones are dropped (`LEAST_WEIGHT`).

    A sum below one (a partial gain) is accepted only if significantly better: shrinking correct gains costs
    most if the next season exceeds the fitted range.
    """
    kept = [k for k, w in _weights(ranked, judged).items() if w >= LEAST_WEIGHT] if ranked else []
    if not kept:
        return {}
    part, whole = _weights(kept, judged), _weights(kept, judged, whole=True)
    chosen = part if (paired_p_value(judged.by_group(whole) - judged.by_group(part)) < LEVEL) else whole
    return {k: w for k, w in chosen.items() if w > 0.0}


def _weights(kept: Sequence[int], judged: _HeldOutPredictions, whole: bool = False) -> dict[int, float]:
    """Least squares on held-out rows; no negative weight, a sum of at most one. whole: a sum of one."""
    right = judged.response[judged.seen]
    size = np.sqrt(np.sum(right**2)) or 1.0
    both = np.column_stack([judged.predicted[kept][:, judged.seen].T, right]) / size
    triangle = np.asarray(np.linalg.qr(both, mode="r"))
    design, right = triangle[:, :-1], triangle[:, -1]
    weights, _ = nnls(design, right)
    if weights.sum() > 1.0 or whole:
        weights, _ = nnls(np.vstack([design, np.full(len(kept), WHOLE)]), np.r_[right, WHOLE])
    return dict(zip(kept, map(float, weights), strict=True))


def paired_p_value(gained: np.ndarray) -> float:
    """p of a paired t test, one-sided, of improvements in mean square, one per run."""
    if gained.mean() <= 0.0:
        return 1.0
    spread = gained.std(ddof=1) if gained.size > 1 else np.inf
    if spread == 0.0:
        return 0.0
    return student_tail(gained.mean() / (spread / np.sqrt(gained.size)), max(gained.size - 1, 1))
