"""Directions and runs of a positioning test, and velocities of a log, from the order of the rows."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from datetime import datetime, timedelta

import numpy as np

from errpipe.domain import components
from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import words
from errpipe.importing.columns import NO_SIDES
from errpipe.importing.proposed import Proposal

DENSE_ROWS = 500  # rows: a log, not a positioning test
FEWEST_VISITS = 6  # readings; fewer do not show which positions are targets
DENSE_PLACES = 100  # distinct commands: a log, not a positioning test
FEWEST_SAMPLES = 20  # rows: fewer do not show a motion
FASTEST_TARGETS = 0.1  # s between rows, by judgement: no axis stops at a target and is read in less

SHARED = 3  # visits with the same digits that make a position a target


def refuse_swapped(p: Proposal, command: str, actual: str) -> None:
    """Raise DataError if the actual position repeats exactly to the last digit, and the command does not.

    The names are swapped, or the machine was read at known gauge positions: only the user can decide.
    """
    x, y = p.data.get(command), p.data.get(actual)
    guessed = p.guesses.get(command) and p.guesses.get(actual)
    if x is None or y is None or not guessed or x.size < FEWEST_VISITS:
        return
    if words.is_reference_of_a_scale(command, actual):
        raise DataError(
            f"{command!r} beside {actual!r}: the commanded position, or an instrument that shows where the axis is? "
            f"Say --set {command}.role=command --set {actual}.role=actual, or the roles exchanged"
        )
    places, moves = np.unique(y[np.isfinite(y)]).size, float(np.mean(np.diff(y) != 0))
    if np.unique(x).size > 0.8 * x.size and places <= 0.5 * y.size and moves > 0.8:
        raise DataError(
            f"{actual!r} repeats the same {places} positions to the last digit, but {command!r} does not: are the "
            f"names swapped? Use --set {command}.role=actual --set {actual}.role=command; if a gauge was at these "
            f"positions and the machine was read, --set {command}.role=command --set {actual}.role=actual"
        )
    targets, visits = np.unique(x, return_counts=True)
    targets = targets[visits >= SHARED]
    swapped = np.isin(y, targets) & ~np.isin(x, targets)
    if swapped.sum() >= SHARED and swapped.sum() > 0.8 * np.sum(~np.isin(x, targets)):
        raise DataError(
            f"in {int(swapped.sum())} rows, from row {int(np.argmax(swapped)) + 1} on, {actual!r} has the targets of "
            f"the other rows and {command!r} does not: were the two exchanged there? Correct these cells, or remove "
            "the rows"
        )


def resolve_order(p: Proposal, axis: str) -> None:
    """Directions and runs of a test, or velocity, acceleration and an ideal simulation for a log."""
    if is_log(p, axis):
        _log_of_an_axis(p, axis)
    else:
        _directions_and_runs(p, axis)


def is_log(p: Proposal, axis: str | None = None) -> bool:
    """Whether the rows are samples of a moving axis in time, not targets."""
    command = p.first("command", axis) or p.first("position", axis)
    time = p.first("time")
    if time is None or time not in p.data or command not in p.data or p.rows < FEWEST_SAMPLES:
        return False
    places = np.unique(np.round(p.data[command], 4)).size
    if p.rows < DENSE_ROWS:
        return places > 0.5 * p.rows and float(np.nanmedian(np.diff(p.canonical(time)))) < FASTEST_TARGETS
    return places > DENSE_PLACES


def _log_of_an_axis(p: Proposal, axis: str) -> None:
    """Velocity, acceleration and direction from the command, and an ideal axis as the simulation."""
    command, time = p.first("command", axis), p.first("time")
    if command is None or time is None:
        return
    t, x = p.canonical(time), p.canonical(command)
    if np.isfinite(t).all() and np.isfinite(x).all() and np.all(np.diff(t) > 0):
        unit = "deg" if p.entries[command].get("unit") in ("deg", "rad") else "mm"
        v = np.gradient(x, t)
        if p.first("velocity", axis) is None:
            why = "derivative of the command"
            p.put(f"v_{axis}", np.round(v, 6), why, role="velocity", axis=axis, unit=f"{unit}/s")
        if p.first("acceleration", axis) is None:
            a = np.round(np.gradient(v, t), 4)
            p.put(f"a_{axis}", a, "second derivative of the command", role="acceleration", axis=axis, unit=f"{unit}/s2")
    error = next(n for n, e in p.entries.items() if e["role"] == "error")
    if p.first("simulated") is None:
        component, unit = p.entries[error]["component"], p.entries[error]["unit"]
        p.put(f"{component}_sim", None, role="simulated", component=component, unit=unit, derived={"constant": 0.0})
        p.guesses[f"{component}_sim"] = "the simulation is an ideal axis without deviation from its command"


THERE_AND_BACK = "; in words for the way there and back"  # a guess of a direction: up or down by the motion
FEWEST_OF_A_LABEL = 0.9  # minimum share of a label's rows on one side of the motion, to be that side's label


def _turn_there_and_back(p: Proposal, x: np.ndarray) -> None:
    """Correct directions named forward and reverse if the forward pass is downwards: `forward` from 0 to -500."""
    side, moves = p.first("direction"), motion_sides(x)
    if side not in p.data or moves is None or not p.guesses.get(side, "").endswith(THERE_AND_BACK):
        return
    against = float(np.mean(moves == -p.data[side]))
    if against >= FEWEST_OF_A_LABEL and np.unique(moves).size == 1:
        way = "rise" if moves[0] > 0 else "fall"
        raise DataError(
            f"column {side!r} names a forward or return pass, and the positions {way}: write + (approached from "
            f"below) or - (from above) instead, or use --set {side}.role=ignore"
        )
    if against >= FEWEST_OF_A_LABEL and np.unique(moves).size == 2:
        p.data[side] = -p.data[side]
        p.guesses[side] += "; the forward pass is downwards, as the positions fall there"


def set_side(p: Proposal, axis: str, text: str, why: str) -> None:
    """Set the side of all rows from a word; the rows of a pass that is listed in the opposite order are reversed."""
    way, listed = guessing.side(text), []
    place = p.first("command", axis) or p.first("position", axis)
    if way is None or place is None or place not in p.data:
        return
    run, x = p.first("run"), p.data[place]
    labels = np.asarray(p.data[run], dtype=str) if run in p.data else np.full(x.size, "")
    order = np.arange(x.size)
    for label in dict.fromkeys(labels.tolist()):
        rows = np.flatnonzero(labels == label)
        if rows.size > 1 and (way * np.diff(x[rows]) < 0).all():
            order[rows] = rows[::-1]
            listed.append(label)
    if listed and way > 0 and words.THERE_AND_BACK.fullmatch(words.plain(text)):
        raise DataError(
            f"{why}, and the positions fall: write + (approached from below) or - (from above) in a column of "
            "directions"
        )
    p.data = {n: [v[i] for i in order] if isinstance(v, list) else v[order] for n, v in p.data.items()}
    p.put("direction", np.full(x.size, way), why, role="direction", axis=axis)


def _directions_and_runs(p: Proposal, axis: str) -> None:
    place = p.first("command", axis) or p.first("position", axis)
    if place is None or place not in p.data:
        _runs_by_gaps(p)
        return
    if p.first("direction") is None and p.side is not None:
        set_side(p, axis, p.side, f"the header, or a line above it, states {p.side!r}")
    x = _counted_on(p, place)
    _turn_there_and_back(p, x)
    if p.first("direction") is None:
        _refuse_copied_rows(p, x)
        moves = motion_sides(x, p.data.get(p.first("run") or ""))
        _sides_of_labels(p, moves)
        if moves is not None and np.unique(moves).size == 2:
            why = "from the order of the positions: +1 where they rise"
            p.put("direction", moves, why, role="direction", axis=axis)
            _join_passes(p, moves)
    if p.first("run") is None:
        side = p.first("direction")
        runs = sweeps(x, p.data.get(side or ""))
        if len(set(runs)) > 1:
            why = "a new run each time the targets start again"
            p.put("run", runs, why, role="run")
    if p.first("direction") is None and _repeated(x, p.data.get(p.first("run") or "")):
        p.notes.append(
            "targets repeat within a run and no column states from which side: backlash cannot be "
            "distinguished from scatter"
        )


def _join_passes(p: Proposal, moves: np.ndarray) -> None:
    """Give `1L` and `1R` one label, `1`, in place, if all runs have two passes and each mark is one side."""
    run = p.first("run") or ""
    parts = [re.fullmatch(r"(\d{1,3})[ ._-]?([^\W\d_]{1,2})", str(v)) for v in p.data.get(run, [""])]
    labels = [(m[1], m[2]) for m in parts if m]
    marks = np.array([mark for _, mark in labels])
    of_mark = {mark: {*moves[marks == mark].tolist()} for mark in {*marks.tolist()}} if len(labels) == p.rows else {}
    if sorted(map(tuple, of_mark.values())) != [(-1.0,), (1.0,)] or len({*labels}) != 2 * len({r for r, _ in labels}):
        return
    p.data[run] = [number for number, _ in labels]
    p.guesses[run] += f"; {' and '.join(sorted(of_mark))} are the two sides of a run"


def sides_of_falling_runs(p: Proposal) -> None:
    """The side of each run of targets if positions of some or all runs fall and no column states a side.

    If all rise, nothing is added: targets are often listed in ascending order regardless of the approach.
    """
    error = p.first("error")
    axis = components.parse(p.entries[error]["component"]).axis if error is not None else None
    place = p.first("command", axis) or p.first("position", axis)
    if axis is None or place not in p.data or p.first("direction") is not None or is_log(p, axis):
        return
    x = _counted_on(p, place)
    labels = np.asarray(p.data.get(p.first("run") or "", [""] * x.size), dtype=str)
    side = np.zeros(x.size)
    for label in dict.fromkeys(labels.tolist()):
        rows = np.flatnonzero(labels == label)
        if rows.size > 1 and not np.isnan(x[rows]).any() and (np.unique(np.sign(np.diff(x[rows]))).size == 1):
            side[rows] = np.sign(x[rows[1]] - x[rows[0]])
    if (side != 0).all() and (side < 0).any():
        why = "the positions of a run fall: approached from above" + (", or rise: from below" if max(side) > 0 else "")
        p.put("direction", side, why, role="direction", axis=axis)


LONGEST_PAUSE = 3600.0  # s, by judgement: after a longer one in a drift the machine has cooled, and its zero may differ
PAUSE_OF_STEPS = 5.0  # times the 90th percentile of the steps, by judgement: longer is a pause, not a slow logger


def _runs_by_gaps(p: Proposal) -> None:
    """A run of a drift for each stretch without a pause, named by its date, or numbered."""
    time = p.first("time")
    if p.first("run") is not None or time is None:
        return
    t = p.canonical(time)
    if not np.isfinite(t).all() or t.size < 3:
        return
    steps = np.diff(t)
    pause = max(LONGEST_PAUSE, PAUSE_OF_STEPS * float(np.quantile(np.abs(steps), 0.9)))
    number = np.concatenate([[0], np.cumsum(np.abs(steps) > pause)])
    if number[-1] == 0:
        return
    labels = [str(n + 1) for n in range(number[-1] + 1)]
    if epoch := p.entries[time].get("epoch"):
        first = [float(t[number == n][0]) for n in np.unique(number)]
        starts = [datetime.fromisoformat(epoch) + timedelta(seconds=s) for s in first]
        dates = [f"{start:%Y-%m-%d}" for start in starts]
        labels = dates if len(set(dates)) == len(dates) else [f"{start:%Y-%m-%d %H:%M}" for start in starts]
    why = f"a new run after each pause of more than {pause / 3600:.2g} h"
    p.put("run", [labels[n] for n in number], why, role="run")


FEWEST_COPIED = 3  # rows equal to the rows before: fewer may be equal by chance on a coarse gauge


def _refuse_copied_rows(p: Proposal, x: np.ndarray) -> None:
    """Raise DataError if rows of a run repeat those right above to the last digit: their motion was not measured."""
    run = p.first("run")
    if run is None:
        return
    columns = [np.unique(np.asarray(v, dtype=str), return_inverse=True)[1] for v in p.data.values()]
    rows = np.stack(columns, axis=1)
    for shift in range(FEWEST_COPIED, x.size // 2 + 1):
        same = np.all(rows[shift:] == rows[:-shift], axis=1)
        for start in np.flatnonzero(same)[:1] if same.sum() >= shift else []:
            if same[start : start + shift].all() and np.ptp(x[start : start + shift]) > 0:
                raise DataError(
                    f"rows {start + shift + 1} to {start + 2 * shift} repeat the {shift} rows above them to the last "
                    "digit, in one run: copied? (remove them, or give each pass its own run)"
                )


def _repeated(x: np.ndarray, runs: list[str] | None) -> bool:
    """Whether most targets occur more than once in a run."""
    pairs = list(zip(runs or [""] * x.size, np.round(x, 6).tolist(), strict=True))
    return x.size > 3 and len(set(pairs)) <= 0.6 * len(pairs)


def _counted_on(p: Proposal, place: str) -> np.ndarray:
    """Positions unchanged; for an angle, continued where it passes 360 = 0."""
    x: np.ndarray = p.data[place]
    turns = p.entries[place].get("unit") in ("deg", "rad") and np.isfinite(x).all()
    return np.round(np.unwrap(p.canonical(place), period=360.0), 9) if turns else x


def motion_sides(x: np.ndarray, runs: Sequence[str] | None = None) -> np.ndarray | None:
    """+1 where positions rise, -1 where they fall; None if unordered.

    Readings of one visit are consecutive. At the reversal, twice as many readings as elsewhere are two visits:
    the second half belongs to the return pass. The first target of a run has the same side as the next one.
    """
    first = np.flatnonzero(np.r_[True, np.diff(x) != 0])
    places, readings = x[first], np.diff(np.r_[first, x.size])
    step = np.sign(np.diff(places))
    if not step.any():
        return None
    far = np.flatnonzero(np.abs(np.diff(places)) > 0.5 * np.ptp(x))
    for i in far if far.size < step.size else []:
        if i + 1 < step.size and step[i + 1] == -step[i]:
            step[i] = 0  # return to the first target, for another pass in the same direction
    way = np.r_[step[np.flatnonzero(step)[0]], step]
    labels = np.asarray([""] * x.size if runs is None else runs, dtype=str)
    begins = 1 + np.flatnonzero(labels[1:] != labels[:-1])
    if begins.size + 1 == np.unique(labels).size:
        way[np.isin(first, begins)] = 0
    for i in np.flatnonzero(way == 0):
        later = way[i + 1 :][way[i + 1 :] != 0]
        way[i] = later[0] if later.size else way[i - 1]
    out = np.repeat(way, readings)
    for i in np.flatnonzero((way[1:] == -way[:-1]) & (readings[:-1] >= 2 * np.median(readings))):
        out[first[i] + readings[i] // 2 : first[i + 1]] = way[i + 1]
    return out if np.count_nonzero(np.diff(way)) <= places.size / 3 else None


FEWEST_OF_A_LABEL = 0.9  # minimum share of a label's rows on one side of the motion, to be that side's label


def _sides_of_labels(p: Proposal, moves: np.ndarray | None) -> None:
    """Raise DataError if a direction column has two labels that neither words nor the motion explain."""
    unread = [n for n, why in p.guesses.items() if why == NO_SIDES and n in p.data]
    place = p.first("command") or p.first("position")
    lost = place in p.data and (moves is None or np.unique(moves).size < 2)
    unread += [n for n in p.entries if lost and place is not None and _may_be_sides(p, n, p.data[place])]
    for name in unread:
        labels = np.array([str(v).removesuffix(".0") for v in p.data[name]])
        names = [str(n) for n in np.unique(labels) if n not in ("", "nan")]
        if len(names) != 2:
            continue
        rising = [0.0 if moves is None else float(np.mean(moves[labels == n] > 0)) for n in names]
        if max(rising) < FEWEST_OF_A_LABEL or min(rising) > 1.0 - FEWEST_OF_A_LABEL:
            raise DataError(
                f"column {name!r} has {names[0]!r} and {names[1]!r}, but the order of the rows does not show which "
                f"of them is from below: write + (from below) and -, or use --set {name}.role=ignore"
            )
        p.guesses[name] = f"{names[int(np.argmax(rising))]!r} is upwards, as the positions rise there"


def _may_be_sides(p: Proposal, name: str, x: np.ndarray) -> bool:
    """Whether a column of unknown words has two of them, both at nearly every target."""
    if p.guesses.get(name) != guessing.UNKNOWN or not isinstance(p.data.get(name), list):
        return False
    words_of = np.array(p.data[name], dtype=str)
    names, targets = np.unique(words_of[words_of != ""]), np.unique(x).size
    at = [np.unique(x[words_of == n]).size for n in names]
    return len(at) == 2 and targets > 2 and min(at) >= FEWEST_OF_A_LABEL * targets


def visits(*columns: np.ndarray) -> list[str]:
    """How often the values of each row have occurred so far: a target, approached from one side; counted from 1."""
    seen: Counter[tuple[float, ...]] = Counter()
    out = []
    for row in zip(*(x.tolist() for x in columns), strict=True):
        seen[row] += 1
        out.append(str(seen[row]))
    return out


def sweeps(x: np.ndarray, side: np.ndarray | None) -> list[str]:
    """Labels of the runs: a pass up and a pass down are one run; without a return pass, each pass is one."""
    way = motion_sides(x) if side is None else side
    if way is None:
        return ["1"] * x.size
    again = visits(np.round(x, 6), way)
    if _repeated(x[: x.size // 2], None) and len(set(again)) > 1:
        return again  # several readings per target before the next: the first, second, ... visit of each
    jumps = np.r_[False, np.diff(way) != 0]
    if np.unique(way).size < 2:
        span = np.ptp(x) or 1.0
        return [str(1 + k) for k in np.cumsum(np.r_[False, np.abs(np.diff(x)) > 0.5 * span])]
    return [str(1 + k // 2) for k in np.cumsum(jumps)]
