"""Positioning figures of a linear or rotary axis after ISO 230-2:2014, clause 4.

    x_ij = P_ij - P_i           deviation at target i in cycle j, up (coming from below) and down
    mean_i, s_i                 mean and standard deviation (n - 1) of each direction at target i
    B_i  = mean_up - mean_down  reversal; B = max |B_i|, mean B = average of B_i
    R_i  = 4 s_i                one direction; both: max(2 s_up + 2 s_down + |B_i|, R_up, R_down); R = max R_i
    E    = max mean - min mean  systematic deviation of one direction, or over both (E); M the same of (up + down) / 2
    A    = max(mean + 2 s) - min(mean - 2 s), one direction, or over both

The expanded uncertainty of annex A is not computed: it needs the uncertainty budget of the measuring set-up.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import FrozenModel, Recording
from errpipe.errors import DataError

MIN_CYCLES = 2  # of one target and direction: with fewer, s is undefined. The standard requires 5.
SAME_TARGET = 1e-3  # mm or deg: readings this close belong to one target
NAMES = {1: "up", -1: "down"}
ONE_STATE = 2.0  # K between medians of runs: 12 um over a metre of steel and scale, more than most R_i (by judgement)


class Direction(FrozenModel):
    """Figures of one direction of approach. Lists run over `targets`; um (urad for a rotary axis)."""

    targets: tuple[float, ...]
    cycles: tuple[int, ...]
    mean: tuple[float, ...]
    s: tuple[float, ...]
    R_i: tuple[float, ...]
    R: float
    E: float
    A: float


class Report(FrozenModel):
    """ISO 230-2 figures of one axis. `unit` applies to every figure but `targets` (mm, deg).

    Bidirectional figures are None if only one direction was measured.
    """

    axis: str
    component: str
    unit: str
    targets: tuple[float, ...]
    cycles: int
    up: Direction | None = None
    down: Direction | None = None
    B_i: tuple[float, ...] | None = None
    B: float | None = None
    B_mean: float | None = None
    R_i: tuple[float, ...] | None = None
    R: float | None = None
    E: float | None = None
    M: float | None = None
    A: float | None = None
    notes: tuple[str, ...] = ()


def figures(recording: Recording, axis: str | None = None, component: str | None = None) -> Report:
    """ISO 230-2 figures of a recording's positioning deviation (or of a named component).

    Rows without a deviation are ignored; the direction column states the direction of a row.
    Raises DataError if targets or cycles do not suffice.
    """
    component = component or _positioning(recording)
    axis = axis or str(components.parse(component).axis)
    position, side, deviation = _rows(recording, axis, component)
    targets, index = _targets(position)
    tables = {
        d: [deviation[(side == d) & (index == k)] for k in range(targets.size)] for d in NAMES if np.any(side == d)
    }
    directions = {d: _one_direction(targets, readings, component, NAMES[d]) for d, readings in tables.items()}
    cycles = min(min(d.cycles) for d in directions.values())
    facts: dict[str, Any] = {
        "axis": axis,
        "component": component,
        "unit": components.unit(component),
        "targets": tuple(targets.tolist()),
        "cycles": cycles,
        "notes": (*_notes(targets, cycles), *_thermal_states_note(recording)),
    }
    facts |= {NAMES[d]: direction for d, direction in directions.items()}
    if len(directions) == 2:
        facts |= _both_directions(directions[1], directions[-1])
    return Report(**facts)


def _positioning(recording: Recording) -> str:
    candidates = [
        c for c in recording.components() if components.parse(c).kind in ("positioning", "angular positioning")
    ]
    if len(candidates) != 1:
        raise DataError(
            f"ISO 230-2 needs one positioning deviation, such as EXX (found: {', '.join(candidates) or 'none'}; "
            f"the recording holds {', '.join(recording.components()) or 'no response'})"
        )
    return candidates[0]


def _rows(recording: Recording, axis: str, component: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Target positions, directions of approach and deviations of the rows with a reading."""
    where = recording.name("command", axis=axis) or recording.name("position", axis=axis)
    side = recording.name("direction", axis=axis)
    error = recording.name("error", component=component)
    for name, what in ((where, f"position of {axis}"), (side, f"direction of {axis}"), (error, f"error {component}")):
        if name is None:
            raise DataError(f"ISO 230-2: the recording has no column for the {what}")
    columns = [recording.array(str(n)) for n in (where, side, error)]
    kept = np.all(np.isfinite(columns), axis=0)
    if not kept.any():
        raise DataError(f"ISO 230-2: no row has position, direction and {component}")
    return tuple(c[kept] for c in columns)  # type: ignore[return-value]


def _targets(position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Targets, ascending, and the target number of each row: readings within 1 um belong to one target."""
    order = np.argsort(position, kind="stable")
    number = np.zeros(position.size, dtype=int)
    number[order] = np.cumsum(np.r_[False, np.diff(position[order]) > SAME_TARGET])
    targets = np.array([np.median(position[number == k]) for k in range(number.max() + 1)])
    if targets.size > position.size / 2:
        raise DataError(
            f"ISO 230-2: {position.size} readings at {targets.size} positions: not a test that repeats its targets"
        )
    return targets, number


def _one_direction(targets: np.ndarray, readings: list[np.ndarray], component: str, name: str) -> Direction:
    few = [k for k, r in enumerate(readings) if r.size < MIN_CYCLES]
    if few:
        raise DataError(
            f"ISO 230-2: {component} at target {targets[few[0]]:g} has {readings[few[0]].size} reading(s) going {name}"
            f" (allowed: at least {MIN_CYCLES}, the standard requires 5)"
        )
    mean = np.array([r.mean() for r in readings])
    s = np.array([r.std(ddof=1) for r in readings])
    return Direction(
        targets=tuple(targets.tolist()),
        cycles=tuple(r.size for r in readings),
        mean=tuple(mean.tolist()),
        s=tuple(s.tolist()),
        R_i=tuple((4 * s).tolist()),
        R=float(4 * s.max()),
        E=float(np.ptp(mean)),
        A=float((mean + 2 * s).max() - (mean - 2 * s).min()),
    )


def _both_directions(up: Direction, down: Direction) -> dict[str, Any]:
    mean_up, mean_down, s_up, s_down = (np.array(v) for v in (up.mean, down.mean, up.s, down.s))
    reversal = mean_up - mean_down
    spread = np.max([2 * s_up + 2 * s_down + np.abs(reversal), 4 * s_up, 4 * s_down], axis=0)
    means, spreads = np.r_[mean_up, mean_down], 2 * np.r_[s_up, s_down]
    return {
        "B_i": tuple(reversal.tolist()),
        "B": float(np.abs(reversal).max()),
        "B_mean": float(reversal.mean()),
        "R_i": tuple(spread.tolist()),
        "R": float(spread.max()),
        "E": float(np.ptp(means)),
        "M": float(np.ptp((mean_up + mean_down) / 2)),
        "A": float((means + spreads).max() - (means - spreads).min()),
    }


def _notes(targets: np.ndarray, cycles: int) -> tuple[str, ...]:
    notes = []
    if cycles < 5:
        notes.append(f"{cycles} cycles; ISO 230-2 requires 5")
    length = float(np.ptp(targets))
    if targets.size < 5 or (length <= 2000 and targets.size < 5 * length / 1000):
        notes.append(f"{targets.size} targets over {length:g}; ISO 230-2 requires 5 per metre and at least 5")
    steps = np.diff(targets)
    if steps.size > 1 and np.ptp(steps) < 1e-3 * steps.mean():
        notes.append(
            "Equal steps between targets: a periodic error of that length, or a fraction of it, is not detected"
        )
    return tuple(notes)


def _thermal_states_note(recording: Recording) -> list[str]:
    """A note if the runs were made in several thermal states, whose spread then counts as repeatability."""
    run, names = recording.run_codes(), recording.names("temperature")
    medians = {
        n: [np.nanmedian(v) for k in np.unique(run) if np.isfinite(v := recording.array(n)[run == k]).any()]
        for n in names
    }
    span = {n: float(np.ptp(values)) for n, values in medians.items() if values}
    widest = max(span, key=lambda n: span[n], default=None)
    if widest is None or span[widest] <= ONE_STATE:
        return []
    return [
        f"{widest} differs by {span[widest]:.2g} K between runs: R and A hold what that moves; "
        "ISO 230-2 takes the runs of one thermal state"
    ]
