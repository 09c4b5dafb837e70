"""Which few sensors carry the error: held-out gain, stability over days left out, and what to do when one dies.

Every subset of sensors is fitted as a whole season model of its own and judged on groups left out. `pareto` lists
the best subset of each size; since it is the best of many, its figure flatters by a little. `nested` chooses the
subset inside the rows that fit and only then looks at the group left out: its figure is the honest one. Redundancy
asks how well the others would stand in: a sensor that nobody can replace needs a spare.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np

from errpipe.domain.recording import Recording
from errpipe.errors import DataError
from errpipe.fitting import thermal_causes, thermal_season
from errpipe.fitting.holdout import Fold, check
from errpipe.fitting.season_options import SeasonOptions
from errpipe.fitting.solve import one_thread

MOST_SENSORS = 10  # beyond it the subsets are grown one by one instead of all being tried
TIE = 1.05  # a smaller set within 5 % of the best is as good (held-out figures are that uncertain)


@dataclass(frozen=True)
class Choice:
    """One set of sensors: rms over all left-out rows and per left-out group, um."""

    sensors: tuple[str, ...]
    rms: float
    groups: dict[str, float]

    @property
    def worst(self) -> float:
        """Largest rms of a left-out group, um."""
        return max(self.groups.values())


def judge(
    recording: Recording, component: str, folds: Sequence[Fold], sensors: Sequence[str], options: SeasonOptions
) -> Choice:
    """A season model on a subset of the temperatures, judged on groups left out.

    Raises DataError where no sensor on the machine is among them.
    """
    chosen = options.model_copy(update={"sensors": tuple(sensors), "room": None, "spindle": None, "bed": None})
    squares, rows, groups = 0.0, 0, {}
    for fold in folds:
        check(fold)
        model = thermal_season.fit(recording, component, chosen, fold.train)
        values = recording.array(thermal_season.response_name(recording, component))
        y = thermal_season.since_start(values, recording.run_codes(), chosen.datum_rows)[0]
        left = (y - model.values(recording))[fold.test]
        left = left[np.isfinite(left)]
        groups[fold.label] = float(np.sqrt(np.mean(left**2)))
        squares, rows = squares + float(np.sum(left**2)), rows + left.size
    return Choice(tuple(sensors), float(np.sqrt(squares / max(rows, 1))), groups)


def pareto(
    recording: Recording, component: str, folds: Sequence[Fold], options: SeasonOptions | None = None
) -> list[Choice]:
    """The best subset of each size, from one sensor to all; by the worst left-out group relative to doing nothing.

    Sensors on the machine are needed, so a subset of the room alone is left out.
    """
    options = options or SeasonOptions(correction=False)
    names = recording.names("temperature")
    if not names:
        raise DataError("sensor choice: the recording has no temperatures")
    room = thermal_causes.sensors(recording).room
    base = judge_nothing(recording, component, folds)
    best: dict[int, tuple[float, Choice]] = {}
    for subset in _subsets(names, best):
        if set(subset) <= {room}:
            continue
        found = judge(recording, component, folds, subset, options)
        score = float(np.mean([found.groups[g] / base[g] for g in base]))
        if len(subset) not in best or score < best[len(subset)][0]:
            best[len(subset)] = (score, found)
    return [best[k][1] for k in sorted(best)]


def nested(
    recording: Recording, component: str, folds: Sequence[Fold], size: int, options: SeasonOptions | None = None
) -> list[Choice]:
    """Per fold, the subset of `size` sensors chosen by the fitting rows alone, and its rms on the group left out.

    Inside, a subset is scored by runs left out and by environments left out (cold against warm starts), both.
    """
    options = options or SeasonOptions(correction=False)
    names = recording.names("temperature")
    room = thermal_causes.sensors(recording).room
    out = []
    for fold in folds:
        scores = {}
        for subset in combinations(names, size):
            if set(subset) <= {room}:
                continue
            chosen = options.model_copy(update={"sensors": subset})
            told = thermal_season.fit(recording, component, chosen, fold.train).report
            inner = [told["rms_core_runs_left_out"], told["rms_core_environments_left_out"]]
            scores[subset] = float(np.sqrt(np.mean([v**2 for v in inner if v is not None])))
        best = min(scores, key=lambda s: (scores[s], s))
        out.append(judge(recording, component, [fold], best, options))
    return out


def _subsets(names: Sequence[str], best: dict[int, tuple[float, Choice]]):
    if len(names) <= MOST_SENSORS:
        for size in range(1, len(names) + 1):
            yield from combinations(names, size)
        return
    yield from combinations(names, 1)
    for size in range(2, len(names) + 1):
        kept = best[size - 1][1].sensors
        yield from (tuple(n for n in names if n in kept or n == new) for new in names if new not in kept)


def judge_nothing(recording: Recording, component: str, folds: Sequence[Fold]) -> dict[str, float]:
    """Left-out group -> rms without compensation, um."""
    values = recording.array(thermal_season.response_name(recording, component))
    y = thermal_season.since_start(values, recording.run_codes(), 3)[0]
    return {f.label: float(np.sqrt(np.nanmean(y[f.test] ** 2))) for f in folds}


def enough(choices: Sequence[Choice]) -> Choice:
    """The smallest set within 5 % of the best of a pareto list."""
    best = min(c.rms for c in choices)
    return next(c for c in choices if c.rms <= best * TIE)


def stability(
    recording: Recording, component: str, options: SeasonOptions | None = None, rounds: int = 30, seed: int = 0
) -> dict[str, float]:
    """Sensor -> share of half samples of runs in which a cause of its own keeps a gain (stability selection)."""
    options = options or SeasonOptions(correction=False)
    run = recording.run_codes()
    codes = np.unique(run)
    if codes.size < 4:
        raise DataError("sensor choice: stability needs four runs at least")
    rng = np.random.default_rng(seed)
    count = dict.fromkeys(recording.names("temperature"), 0)
    for _ in range(rounds):
        half = rng.permutation(codes)[: codes.size // 2]
        model = thermal_season.fit(recording, component, options, np.isin(run, half))
        kept = [name for name, gain in model.report["causes"].items() if abs(gain) > 0.05]
        for sensor in count:
            count[sensor] += any(_about(cause, sensor) for cause in kept)
    return {n: c / rounds for n, c in count.items()}


def _about(cause: str, sensor: str) -> bool:
    return sensor in cause.split(" ") or sensor in cause.replace(",", "").split(" ")


def redundancy(recording: Recording, run_out: bool = True) -> dict[str, dict[str, Any]]:
    """Sensor -> how well the others tell it: rms of the estimate on runs left out, K, beside its own spread, K.

    run_out: judge each run by a relation that never saw it (needs two runs).
    """
    names = recording.names("temperature")
    values = {n: recording.array(n) for n in names}
    run = recording.run_codes()
    parts = np.unique(run) if run_out and np.unique(run).size > 1 else [None]
    out = {}
    for name in names:
        others = [n for n in names if n != name]
        table = np.column_stack([np.ones(len(recording)), *(values[n] for n in others)])
        good = np.isfinite(table).all(axis=1) & np.isfinite(values[name])
        error = np.full(len(recording), np.nan)
        for part in parts:
            judged = good if part is None else good & (run == part)
            fitted = good if part is None else good & (run != part)
            with one_thread():
                weights = np.linalg.lstsq(table[fitted], values[name][fitted], rcond=None)[0]
            error[judged] = values[name][judged] - table[judged] @ weights
        spread = float(np.nanstd(values[name][good]))
        left = float(np.sqrt(np.nanmean(error[good] ** 2)))
        out[name] = {"rms_estimate": left, "spread": spread, "replaceable": left < 0.25 * spread}
    return out
