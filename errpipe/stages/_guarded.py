"""A table's guard: the sensors that it monitors, those that it replaces, and its cost when all are healthy."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from errpipe.domain.components import unit
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.domain.table import MAX_NODES, LagNode
from errpipe.errors import DataError
from errpipe.fitting import holdout
from errpipe.fitting.statistics import rms
from errpipe.guard import learn
from errpipe.guard.description import GuardedSensor, SensorGuard
from errpipe.guard.rows import rows_of
from errpipe.guard.rules import RULES
from errpipe.stages._compile import CompileOptions, compile_model
from errpipe.stages.predict import table_values
from errpipe.thermal.arithmetic import short_gaps_held

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable
    from errpipe.validation.gate import GatedModel

MAX_COMPARED, MAX_INDIVIDUAL = 6, 15  # compared with each other; monitored individually
# Nodes of a table: per compared sensor and for the rest of the guard, at most 400 (tests/unit/stages/test_guarded.py);
# per sensor monitored individually; without those of the rules.
NODES_COMPARED, NODES_BESIDE, NODES_ALONE = 49, 18, 18
NODES_KEPT, NODES_HELD = 6, 1  # per sensor that is kept consistent with those that are compared; that is held
MAX_COST = 0.03  # relative increase of the held-out residual with healthy sensors
# Ratio of the held-out residual with a replaced sensor to no compensation. Chosen on trials.thermal, seed 41401: with
# 0.7, 4 instead of 2 of 115 frozen sensors exceed no compensation.
MAX_LEFT = 1.0
WIDER = (1.0, 1.5, 2.5, 4.0)  # factors on the learnt thresholds: held-out groups may be more active (by judgement)
MAX_ROWS = 20_000  # of a recording for learning and validating a guard: 6 s on one core
COARSEST_S = 30.0  # largest s between remaining rows: a tenth of the time in which a healthy reading changes
MAX_BATCHES = 6  # of held-out runs: each needs a separate guard
MAX_TITLE = 127  # characters, of a table
MONITORED_ALONE = "temperatures monitored individually"
MAX_HELD = 1.0  # of the uncompensated rms: sum of the largest changes by held temperatures (by judgement)
KEPT = "limited to the difference from these that the recording shows"
NOT_MONITORED = "temperatures not monitored"
Fold = tuple[np.ndarray, SensorGuard]  # rows of a group, and the guard that was learnt without them


@dataclass(frozen=True)
class TableGuard:
    """The guard of a table (none: no sensor is monitored), its sentence, and the document of `export.json`."""

    guard: SensorGuard | None
    sentence: str
    document: dict[str, Any]

    def title(self, title: str) -> str:
        """The title of the table, with a note if temperatures are not monitored, or only individually."""
        mark = NOT_MONITORED if self.guard is None else "" if self.guard.compares else MONITORED_ALONE
        return "; ".join(filter(None, (title[: MAX_TITLE - len(mark) - 2], mark))) if mark else title


@dataclass(frozen=True)
class Baseline:
    """What a guard is judged by: the model's plain table on the recording's own rows.

    left, before: component -> rms that the model, and no compensation, leave on held-out rows, um.
    """

    model: ErrorModel
    options: CompileOptions
    recording: Recording
    plain: CompensationTable
    left: Mapping[str, float]
    before: Mapping[str, float]

    def compiled(self, guard: SensorGuard) -> CompensationTable:
        return compile_model(self.model, self.options, guard, self.recording)

    def free_nodes(self) -> int:
        """Nodes that a guard may take: every pair of the table takes one to fade."""
        return MAX_NODES - len(self.plain.nodes) - len(self.plain.pairs)

    def predicted(self, table: CompensationTable, recording: Recording) -> Mapping[str, np.ndarray]:
        """Predictions of a table, um."""
        return table_values(table, self.model, recording)

    def rms_difference(self, one: Mapping[str, np.ndarray], other: Mapping[str, np.ndarray]) -> dict[str, float]:
        """Component -> rms difference of predictions, um."""
        differences = {name: values - other[name] for name, values in one.items()}
        return {name: rms(d[np.isfinite(d)]) for name, d in differences.items()}

    def cost(self, moved: Mapping[str, float]) -> float:
        """Share by which the largest residual grows: squares of the difference add to those that are left."""
        shares = [np.hypot(1.0, moved[n] / left) - 1.0 for n, left in self.left.items() if n in moved and left > 0]
        return float(max(shares, default=0.0))

    def is_useful(self, moved: Mapping[str, float]) -> bool:
        """Whether the residual with a substitute is below `MAX_LEFT` of no compensation, for every component."""
        return all(np.hypot(self.left[n], moved[n]) < MAX_LEFT * self.before[n] for n in self.left if n in moved)


def baseline_of(
    passed: GatedModel, options: CompileOptions, recording: Recording, plain: CompensationTable
) -> Baseline:
    """What guards of an export are judged by; where nothing was judged, the rows of the fit stand for held-out ones."""
    left = {c.component: c.rms_after for c in passed.model.components}
    before = {c.component: c.rms_before for c in passed.model.components}
    for figures in sorted(passed.judged, key=lambda f: -f["rms_at_gain"]):  # the least of several validations
        left[figures["component"]], before[figures["component"]] = figures["rms_at_gain"], figures["rms_before"]
    return Baseline(passed.model, options, _fewer_rows(recording), plain, left, before)


def _fewer_rows(recording: Recording) -> Recording:
    """At most about `MAX_ROWS` rows: first every n-th one of each run, up to `COARSEST_S`, then every n-th run."""
    if len(recording) <= MAX_ROWS or recording.name("time") is None:
        return recording
    run, time = recording.run_codes(), recording.time()
    starts = np.flatnonzero(np.diff(run, prepend=-1))
    within = np.arange(run.size) - np.repeat(starts, np.diff(np.append(starts, run.size)))
    step = float(np.median(np.diff(time)[np.diff(run) == 0])) if starts.size < run.size else COARSEST_S
    stride = int(np.clip(COARSEST_S // max(step, 1e-9), 1, np.ceil(run.size / MAX_ROWS)))
    kept = within % stride == 0
    runs = np.cumsum(within == 0) - 1
    return recording.take(kept & (runs % int(np.ceil(kept.sum() / MAX_ROWS)) == 0))


def sensors_read(plain: CompensationTable, recording: Recording) -> list[str]:
    read = {i.name for i in plain.inputs}
    return [n for n in recording.names("temperature") if n in read]


def choose_guard(baseline: Baseline, scheme: str | None) -> TableGuard:
    """The guard learnt from the recording, if it costs at most `MAX_COST` with healthy sensors.

    scheme: the hold-out of the validation; its groups, else runs, are held out. If sensors cannot be compared
    (one sensor, one run), each is monitored individually and the correction fades if one fails.
    """
    held = short_gaps_held(baseline.recording)
    max_count = min(MAX_COMPARED, (baseline.free_nodes() - NODES_BESIDE) // (NODES_COMPARED + _nodes_of_rules()))
    if max_count < 2:
        return _one_by_one(baseline, held, "the table has too few free nodes for a comparison", scheme)
    influence = _influence_of_each(baseline, held, max_count)
    names = _most_influential(influence, max_count)
    free = baseline.free_nodes() - NODES_BESIDE - len(names) * (NODES_COMPARED + _nodes_of_rules())
    others = {n: of for n, of in influence.items() if n not in names}
    free -= sum(isinstance(n, LagNode) for n in baseline.plain.nodes)  # a node more for each
    count = (free - NODES_HELD * len(others)) // (NODES_KEPT - NODES_HELD)  # the others may be held
    kept = _most_influential(others, max(count, 0)) if len(names) > 1 else ()
    unmonitored = {n: of for n, of in others.items() if n not in kept}
    little = _held_sensors(unmonitored, free - NODES_KEPT * len(kept))
    if len(names) < 2:  # add the other sensors of the recording for comparison
        names = (*names, *(n for n in held.names("temperature") if n not in names))[:max_count]
    try:
        guard, folds = _learn(held, names, scheme, partial(learn.learn, others=kept) if kept else learn.learn)
    except DataError as why:
        return _one_by_one(baseline, held, str(why), scheme)
    guard, accuracy = _with_substitutes(baseline, held, guard, folds)
    guard, cost = _affordable(baseline, held, guard.model_copy(update={"held": little}), folds)
    if cost > MAX_COST:
        return _one_by_one(
            baseline, held, f"with healthy sensors it would cost {100 * cost:.0f} % on held-out groups", scheme
        )
    document = {"watched": list(names), "stand_in": [s.name for s in guard.sensors if s.stands_in], "cost": cost}
    document |= {"accuracy": accuracy, "kept_within_K": {s.name: s.within for s in guard.kept}}
    sentence = (
        f"{len(names)} temperatures are monitored against each other, and replace one that fails{_ranges(accuracy)}"
    )
    sentence += f"; {len(kept)} of less influence are {KEPT}" if kept else ""
    sentence += _unmonitored_sentence(unmonitored, guard)
    fading = [s.name for s in guard.sensors if not s.stands_in]
    sentence += f"; the correction fades if {' or '.join(fading)} fails, which no other replaces" if fading else ""
    return TableGuard(guard, sentence, document | {"held": list(guard.held)})


def _unmonitored_sentence(names: Collection[str], guard: SensorGuard) -> str:
    """What a table does if a temperature that its guard leaves out is lost, in words."""
    fades = len(names) - len(guard.held)
    sentence = (
        f"; {len(guard.held)} of little influence are not: a lost one keeps its last reading"
        if fades < len(names)
        else ""
    )
    return sentence + (f"; {fades} of less influence are not; the correction fades if one is lost" if fades else "")


def _influence_of_each(baseline: Baseline, held: Recording, count: int) -> dict[str, tuple[float, float]]:
    """Temperature -> what is changed if it stays as at each start: relative cost; largest change, of the uncompensated
    rms. In the recording's order; zeros where there are `count` at most, since none has to be left out."""
    names = sensors_read(baseline.plain, held)
    if len(names) <= count:
        return dict.fromkeys(names, (0.0, 0.0))
    predicted, run = baseline.predicted(baseline.plain, held), held.run_codes()
    first = np.maximum.accumulate(np.where(np.r_[True, np.diff(run) != 0], np.arange(run.size), 0))
    out = {}
    for name in names:
        stuck = baseline.predicted(baseline.plain, held.with_columns({name: held.array(name)[first]}, {}))
        largest = max(
            float(np.nanmax(np.abs(values - predicted[c]), initial=0.0)) / max(baseline.before.get(c, 0.0), 1e-9)
            for c, values in stuck.items()
        )
        out[name] = (baseline.cost(baseline.rms_difference(stuck, predicted)), largest)
    return out


def _most_influential(influence: Mapping[str, tuple[float, float]], count: int) -> tuple[str, ...]:
    """The `count` temperatures with the largest effect on the table, in the recording's order."""
    ranked = sorted(influence, key=lambda n: influence[n][0], reverse=True)[:count]
    return tuple(n for n in influence if n in ranked)


def _held_sensors(influence: Mapping[str, tuple[float, float]], free: int) -> tuple[str, ...]:
    """Temperatures, those of the smallest effect first, that together change the table by at most `MAX_HELD`.

    free: nodes of the table.
    """
    total, out = 0.0, list[str]()
    for name in sorted(influence, key=lambda n: influence[n][1]):
        total += influence[name][1]
        if total > MAX_HELD or NODES_HELD * (len(out) + 1) > free:
            break
        out.append(name)
    return tuple(n for n in influence if n in out)


def _learn(
    held: Recording, names: Sequence[str], scheme: str | None, by: Callable[..., SensorGuard]
) -> tuple[SensorGuard, list[Fold]]:
    """The guard of all rows, and (rows, guard without them) of each group left out. Raises DataError."""
    guard = by(held, names)
    for way in (scheme, f"batches:{MAX_BATCHES}", "leave-one-run-out"):
        try:
            splits = holdout.groups(held, way) if way else []
            if 1 < len(splits) <= MAX_BATCHES:
                return guard, [(s.test, by(held.take(s.train), names)) for s in splits]
        except DataError:
            continue
    if guard.compares:
        raise DataError("a sensor guard needs groups of which it can be learnt without one")
    return guard, []


def _ranges(accuracy: Mapping[str, Mapping[str, float]]) -> str:
    """How accurate replacements are on left-out groups, in words; every key but K is a component."""
    units = {name: f"{unit(name)} of {name}" if name != "K" else name for of in accuracy.values() for name in of}
    ends = {
        name: (min(of[name] for of in accuracy.values()), max(of[name] for of in accuracy.values())) for name in units
    }
    parts = [f"{low:.2g} to {high:.2g} {units[name]}" for name, (low, high) in ends.items()]
    return f" (rms of a replacement on left-out groups: {', '.join(parts)})"


def _with_substitutes(
    baseline: Baseline, held: Recording, guard: SensorGuard, folds: Sequence[Fold]
) -> tuple[SensorGuard, dict[str, dict[str, float]]]:
    """The guard, each sensor with a useful estimate marked: one at a time and in pairs.

    And per sensor the rms of its replacement on left-out groups, in K and in um (urad) of each component.
    """
    names, predicted = guard.names(), baseline.predicted(baseline.plain, held)
    gone = np.zeros((len(names), len(names), len(held)))  # of sensor i where j fails too
    for rows, own in folds:
        for (i, j), shift in _replacement_shifts(own, held.take(rows)):
            gone[i, j, rows] = shift
    x = {n: held.array(n) for n in names}

    def moved(*failed: int) -> dict[str, float]:
        pair = (failed[0], failed[-1]), (failed[-1], failed[0])
        columns = {names[i]: x[names[i]] - gone[i, j] for i, j in pair}
        return baseline.rms_difference(baseline.predicted(baseline.plain, held.with_columns(columns, {})), predicted)

    alone_moved = [moved(i) for i in range(len(names))]
    accuracy = {n: {"K": rms(gone[i, i]), **alone_moved[i]} for i, n in enumerate(names)}
    use = [baseline.is_useful(m) for m in alone_moved]
    both = guard.most_failed > 1 and all(
        baseline.is_useful(moved(i, j)) for i, j in combinations([i for i, alone in enumerate(use) if alone], 2)
    )
    alone = learn.limits(held, names)  # for a sensor without replacement: a false alarm costs the whole correction
    sensors = tuple(
        s if u else _monitored_alone(s, a) for s, a, u in zip(guard.sensors, alone.sensors, use, strict=True)
    )
    return guard.model_copy(update={"sensors": sensors, "most_failed": 2 if both else 1}), accuracy


def _monitored_alone(sensor: GuardedSensor, limits: GuardedSensor) -> GuardedSensor:
    """A compared sensor whose estimate is too inaccurate, with the limits of one monitored individually."""
    rules = tuple(rule.not_below(sensor.rule(rule.rule)) for rule in limits.rules)
    return sensor.model_copy(update={"stands_in": False, "rules": rules})


def _replacement_shifts(guard: SensorGuard, held: Recording) -> Iterator[tuple[tuple[int, int], np.ndarray]]:
    """(i, j) -> replacement of sensor i if j (itself: no other) fails, minus its healthy reading, K, (rows,)."""
    healthy = rows_of(held, guard.names())
    rise = healthy.rises()
    weight = np.array([s.estimate for s in guard.sensors])
    left = np.zeros((len(held), len(weight)))
    whole = np.isfinite(np.column_stack([held.array(n) for n in guard.names()])).all(axis=1)
    left[whole] = rise - rise @ weight.T
    for i in range(len(weight)):
        yield (i, i), left[:, i]
        for j in set(range(len(weight))) - {i}:
            yield (i, j), (left[:, i] + weight[i, j] * left[:, j]) / (1.0 - weight[i, j] * weight[j, i])


def _cost(baseline: Baseline, held: Recording, guard: SensorGuard, folds: Sequence[Fold]) -> float:
    """Relative increase of the residual by a guard with healthy sensors: larger one of held-out and fitted groups.

    Rows of a group are evaluated without those before them, where states start anew; so are those of the plain table.
    """
    predicted, by_fold = (
        baseline.predicted(baseline.plain, held),
        dict(baseline.predicted(baseline.compiled(guard), held)),
    )
    own = baseline.cost(baseline.rms_difference(by_fold, predicted))
    for rows, fold in folds:
        sensors = tuple(
            o if s.stands_in else _monitored_alone(o, s) for o, s in zip(fold.sensors, guard.sensors, strict=True)
        )
        same = fold.model_copy(update={"sensors": sensors, "most_failed": guard.most_failed})
        group = held.take(rows)
        plain = baseline.predicted(baseline.plain, group)
        for name, values in baseline.predicted(baseline.compiled(same), group).items():
            by_fold[name] = by_fold[name].copy()
            by_fold[name][rows] = predicted[name][rows] + values - plain[name]
    return max(own, baseline.cost(baseline.rms_difference(by_fold, predicted)))


def _affordable(
    baseline: Baseline, held: Recording, guard: SensorGuard, folds: Sequence[Fold]
) -> tuple[SensorGuard, float]:
    """The guard at the smallest of `WIDER` with a cost of at most `MAX_COST`, else the widest; the cost."""
    tried, cost = guard, np.inf
    for times in WIDER:
        tried = guard.widened(times)
        cost = _cost(baseline, held, tried, [(rows, fold.widened(times)) for rows, fold in folds])
        if cost <= MAX_COST:
            break
    return tried, float(cost)


def _one_by_one(baseline: Baseline, held: Recording, why: str, scheme: str | None) -> TableGuard:
    """Each sensor monitored individually; no guard if that costs too much with healthy sensors."""
    max_count = min(MAX_INDIVIDUAL, baseline.free_nodes() // (NODES_ALONE + _nodes_of_rules()))
    if max_count < 1:
        return no_guard(f"{why}; the table has no free nodes")
    influence = _influence_of_each(baseline, held, max_count)
    names = _most_influential(influence, max_count)
    unmonitored = {n: of for n, of in influence.items() if n not in names}
    little = _held_sensors(unmonitored, baseline.free_nodes() - len(names) * (NODES_ALONE + _nodes_of_rules()))
    try:
        guard, folds = _learn(held, names, scheme, learn.limits)
    except DataError as lacking:
        return no_guard(f"{why}; {lacking}")
    guard, cost = _affordable(baseline, held, guard.model_copy(update={"held": little}), folds)
    if cost > MAX_COST:
        return no_guard(f"{why}; individual monitoring would increase the residual by {100 * cost:.0f} %")
    symptoms = ", or ".join(rule.symptom for rule in RULES)
    sentence = f"each temperature is monitored by itself ({why}): the correction fades if one {symptoms}"
    document = {"watched": list(names), "stand_in": [], "cost": cost, "why": why, "held": list(guard.held)}
    return TableGuard(guard, sentence + _unmonitored_sentence(unmonitored, guard), document)


def _nodes_of_rules() -> int:
    return sum(rule.nodes for rule in RULES)


def no_guard(why: str) -> TableGuard:
    return TableGuard(
        None, f"temperatures are not monitored ({why}): a failed one is followed", {"watched": [], "why": why}
    )
