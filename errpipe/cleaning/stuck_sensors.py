"""Sensors without information: dead ones are set aside, stuck stretches are blanked.

Healthy slow sensors with a coarse resolution are constant for a while. A stretch is stuck only where it is much
longer than the sensor's others, and if the other sensors predict that it should have moved.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

import numpy as np

from errpipe.cleaning._base import Action, Rule, resolution, sensors
from errpipe.domain.recording import Recording
from errpipe.drivers.between_readings import rows_between
from errpipe.errors import DataError
from errpipe.kernels.events import stretches
from errpipe.yamlfile import quantity

SENTINELS = (0.0, -999.0, -9999.0, 999.9, 9999.0, 85.0, -127.0, -242.0, 850.0)  # what loggers and converters write
# for a broken sensor: 0, "no value" marks, a 1-wire chip's 85 and -127, a platinum resistor's open and short ends
MIN_SENTINEL_OFFSET = 5.0  # K, hPa or %: a sentinel stands at least this far off the readings around it
LONGER = 4.0  # a stuck stretch is this many times as long as the longest that is not
MIN_STUCK_ROWS = 20  # rows: a shorter stretch is not judged
ALONE_LONGER, ALONE_SHORTEST = 8.0, 60  # where no other sensor can be compared, only an extreme stretch counts
MAX_STRETCHES = 5  # of one sensor; more standing still than that is its nature
MOVED = 4.0  # display steps, or scatters of the estimate, by which the others say that it should have moved
RELATED = 0.5  # share of a sensor's variance that the others must explain to be compared with it
MAX_NAMED = 5  # sensors in a message
DEAD_SHARE = 0.3  # of a sensor's cells stuck: the rest is not worth the risk
# What a sensor may show, or a person may write in every row of a short test: in degC, hPa, %.
PLAUSIBLE = {"temperature": (5.0, 45.0), "pressure": (600.0, 1100.0), "humidity": (1.0, 100.0)}
CALM = 1.0  # K, hPa or %: where no sensor of its kind leaves this span, a constant one is not a failure


class StuckSensors(Rule):
    """Set aside sensors that are empty, constant or mostly stuck; blank stuck and sentinel stretches of others.

    A constant plausible value is not a failure if no sensor of its kind changed, as in a short test.
    """

    rule: Literal["stuck_sensors"] = "stuck_sensors"
    empty: float = quantity("1", "A sensor with a larger share of empty cells is set aside.", 0.5, gt=0, le=1)
    most: float = quantity("1", "Refuse to set aside more than this share of the sensors as failed.", 0.7, gt=0, le=1)

    def find(self, recording: Recording) -> list[Action]:
        """Columns to set aside and cells to blank. Raises DataError beyond the stated share."""
        names = sensors(recording)
        columns = {n: recording.array(n) for n in names}
        dead = {n: reason for n in names if (reason := self._dead(columns[n]))}
        alive = {n: v for n, v in columns.items() if n not in dead}
        actions = []
        for name, values in alive.items():
            rows, reason = _sentinels(values)
            if not rows.size:
                others = [v for n, v in alive.items() if n != name]
                rows, reason = _stuck(values, others)
            if rows.size > DEAD_SHARE * np.isfinite(values).sum():
                dead[name] = f"{reason}, in {rows.size} of {values.size} rows"
            elif rows.size:
                actions.append(Action("blank cells", reason, column=name, rows=rows))
        set_aside = [Action("set column aside", dead[n], column=n) for n in names if n in dead]
        failed = [a for a in set_aside if not _may_stand_still(recording, str(a.column), alive)]
        if len(failed) > self.most * len(names):
            which = "; ".join(f"{action.column} {action.reason}" for action in failed[:MAX_NAMED])
            raise DataError(
                f"clean, {self.rule}: would set aside {len(failed)} of {len(names)} sensors, more than its share of"
                f" {100 * self.most:g} % ({which}). Give their columns `role: ignore`, or raise `most`."
            )
        return [*set_aside, *actions]

    def _dead(self, values: np.ndarray) -> str:
        """Why a whole column is dead, or ''."""
        finite = values[np.isfinite(values)]
        if finite.size == 0:
            return "holds no value"
        if _rows_with_reading(values) < (1 - self.empty) * values.size:
            return f"empty in {values.size - finite.size} of {values.size} rows"
        if finite.size >= MIN_STUCK_ROWS and np.ptp(finite) == 0.0:
            return f"shows {finite[0]:g} in every row"
        return ""


def _may_stand_still(recording: Recording, name: str, alive: Mapping[str, np.ndarray]) -> bool:
    """Whether a sensor that shows one plausible value in every row is no failure: none of its kind moved either."""
    values, role = recording.array(name), recording.manifest.columns[name].role
    finite = values[np.isfinite(values)]
    low, high = PLAUSIBLE[role]
    if not finite.size or np.ptp(finite) > 0.0 or not low <= finite[0] <= high:
        return False
    same_role = [v for n, v in alive.items() if recording.manifest.columns[n].role == role]
    return all(np.nanmax(v) - np.nanmin(v) <= CALM for v in same_role)


def _rows_with_reading(values: np.ndarray) -> int:
    """Rows with a reading; of a sensor logged less often also those up to the next one, at its usual rate."""
    steps = np.diff(np.r_[np.flatnonzero(np.isfinite(values)), values.size])
    return int(np.minimum(steps, rows_between(values)).sum())


def _sentinels(values: np.ndarray) -> tuple[np.ndarray, str]:
    """Rows that hold a broken sensor's mark, far off all other readings."""
    for mark in SENTINELS:
        rows = np.flatnonzero(values == mark)
        rest = values[np.isfinite(values) & (values != mark)]
        if (
            rows.size
            and rest.size
            and (mark < rest.min() - MIN_SENTINEL_OFFSET or mark > rest.max() + MIN_SENTINEL_OFFSET)
        ):
            return rows, f"shows {mark:g}, a broken sensor's mark"
    return np.zeros(0, dtype=np.int64), ""


def _stuck(values: np.ndarray, others: list[np.ndarray]) -> tuple[np.ndarray, str]:
    """Rows of stretches in which the sensor is constant although it should change."""
    rows = np.flatnonzero(np.isfinite(values))
    y = values[rows]
    if y.size < 2 * MIN_STUCK_ROWS:
        return rows[:0], ""
    starts, ends = _constant(y)
    lengths = ends - starts
    order = np.argsort(-lengths, kind="stable")
    ranked = np.r_[lengths[order], 1.0]  # every other row stands alone
    for count in range(1, min(MAX_STRETCHES, ranked.size - 1) + 1):
        ratio = ranked[count - 1] / ranked[count]
        if ranked[count - 1] < MIN_STUCK_ROWS:
            break
        if ratio < LONGER:
            continue
        chosen = np.sort(order[:count])
        inside = np.zeros(y.size, dtype=bool)
        for k in chosen:
            inside[starts[k] : ends[k]] = True
        if inside.all():  # one reading per run: constant by definition
            continue
        comparable, moved = _should_have_moved(y, [o[rows] for o in others], inside, starts[chosen], ends[chosen])
        if comparable and not moved.all():
            continue
        if not comparable and (ratio < ALONE_LONGER or ranked[count - 1] < ALONE_SHORTEST):
            continue
        longest = int(lengths[chosen].max())
        why = "while the other sensors moved" if comparable else f"{ratio:.0f} times as long as any other stretch"
        return rows[inside], f"frozen for up to {longest} rows, {why}"
    return rows[:0], ""


def _constant(y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends (half open) of the stretches of equal values, longer than one row."""
    starts, ends = stretches(y[1:] == y[:-1])
    return starts, ends + 1


def _should_have_moved(
    y: np.ndarray, others: list[np.ndarray], inside: np.ndarray, starts: np.ndarray, ends: np.ndarray
) -> tuple[bool, np.ndarray]:
    """Are there sensors to compare with? And for each stretch: do they predict that it should have moved?"""
    usable = [o for o in others if np.isfinite(o).mean() > 0.9]
    if not usable:
        return False, np.zeros(starts.size, dtype=bool)
    held = [np.where(np.isfinite(o), o, np.nanmedian(o)) for o in usable]
    design = np.column_stack([np.ones(y.size), *held])
    fit, *_ = np.linalg.lstsq(design[~inside], y[~inside], rcond=1e-8)
    estimate = design @ fit
    residual = (y - estimate)[~inside]
    variance = np.var(y[~inside])
    if variance == 0 or np.var(residual) > (1 - RELATED) * variance:
        return False, np.zeros(starts.size, dtype=bool)
    scale = max(resolution(y), float(np.std(residual)))
    moves = np.array(
        [np.subtract(*np.percentile(estimate[s:e], [97.5, 2.5])) for s, e in zip(starts, ends, strict=True)]
    )
    return True, moves > MOVED * scale
