"""Checks of a recording's other columns: axes, directions, runs, time, temperatures, copied columns."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import pairwise

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import Recording
from errpipe.validation import outlying_runs
from errpipe.validation.plausibility_finding import Finding

MIN_MOVES = 10  # steps or rows; with fewer a check reports nothing
AT_REST = 1e-3  # of the largest travel: an axis that moves less is at rest
MAX_SPEED = {"mm": 10_000.0, "deg": 36_000.0}  # mm/s (linear motors reach 5 m/s), deg/s (100 rev/s)
ROOM = (-30.0, 150.0)  # degC: range of a machine tool's sensor
COPY = 1e-6  # of its range: largest rms residual of an affine copy
OUTSIDE = 0.1  # of the travel: tolerance of positions beyond a travel that was stated as a round number
INCH = 25.4  # mm
SWEEPS = 0.25  # of the moves: with fewer reversals the targets are measured in sweeps, not in a random order
BOTH_WAYS = 0.2  # threshold: share of the steps in one direction, from which the rows are in the order of the motion
COLDEST = 55.0  # degC: upper limit of the coldest part of a machine
STEP, STEP_GAP = 15.0, 600.0  # K from one row to the next, s between them: faster than anything but a heater
RETURN = 0.2  # of the step: tolerance with which a failed sensor returns to its level; a heated bed cools slowly


def axis_of_component(recording: Recording) -> Iterator[Finding]:
    """A component of an axis whose position is not recorded, or constant while another axis moves."""
    travels = {}
    for role in ("command", "position"):
        for name in recording.names(role):
            values = recording.array(name)
            if np.isfinite(values).any():
                travels[str(recording.manifest.columns[name].axis)] = float(np.nanmax(values) - np.nanmin(values))
    if not travels:
        return
    moving = max(travels, key=lambda axis: travels[axis])
    for name in recording.names("error"):
        component = components.parse(str(recording.manifest.columns[name].component))
        motion = component.is_straightness or component.kind in ("positioning", "angular positioning")
        if not motion or component.axis is None:
            continue
        own_travel = travels.get(component.axis)
        if own_travel is None:
            has = f"no column holds the position of {component.axis} (found: {', '.join(sorted(travels))})"
            yield Finding("wrong-axis", name, f"{component.name}: {has}", _renamed(component, moving))
        elif own_travel < AT_REST * travels[moving]:
            rests = f"{component.axis} moves {own_travel:.3g} while {moving} moves {travels[moving]:.4g}"
            yield Finding("wrong-axis", name, f"{component.name}: {rests}", _renamed(component, moving))


def _renamed(component: components.Component, axis: str) -> str:
    if component.kind in ("positioning", "angular positioning"):
        return f"component {components.positioning(axis)}"
    return f"component E{component.direction}{axis}, or the axis of the position column"


def direction_against_motion(recording: Recording) -> Iterator[Finding]:
    """A direction opposite to the change of the position from row to row."""
    for side in recording.names("direction"):
        axis = recording.manifest.columns[side].axis
        place = recording.name("command", axis=axis) or recording.name("position", axis=axis)
        if place is None:
            continue
        x, d, run = recording.array(place), recording.array(side), recording.run_codes()
        good = np.isfinite(x) & np.isfinite(d)
        x, d, run = x[good], d[good], run[good]
        if x.size < MIN_MOVES:
            continue
        step = np.where(np.diff(run) == 0, np.diff(x), 0.0)
        moved = np.abs(step) > AT_REST * np.ptp(x)
        if moved.sum() < MIN_MOVES:
            continue
        if np.unique(d).size < 2:
            if BOTH_WAYS < (falling := float(np.mean(step[moved] < 0))) < 1 - BOTH_WAYS:
                evidence = f"it states one side throughout, and {place} falls in {100 * falling:.0f} % of the steps"
                yield Finding("direction-not-of-motion", side, evidence, "a column that was not logged", "ask")
            continue
        if run[0] != run[-1] and x.size < DENSE_ROWS and np.all(np.diff(x) > 0):
            evidence = f"{place} rises from row to row through all runs, and yet it changes"
            yield Finding("direction-not-of-motion", side, evidence, "another position (this one counts the rows)")
            continue
        same = np.sign(step[moved]) == d[1:][moved]
        agree = float(np.mean(same))
        rising = float(np.mean(step[moved] > 0))
        sweeps = np.count_nonzero(np.diff(np.sign(step[moved]))) < SWEEPS * moved.sum()
        sweeps &= BOTH_WAYS < rising < 1 - BOTH_WAYS  # a table sorted by targets rises from first to last on both sides
        if agree <= 0.1:
            evidence = f"it is the opposite of the motion of {place} in {100 * (1 - agree):.0f} % of the steps"
            yield Finding("reversed-direction", side, evidence, "+1 when approached from below (the position rises)")
        elif agree < 0.75 and sweeps:
            evidence = (
                f"the axis sweeps up and down, but it follows the motion of {place} in {100 * agree:.0f} % of the steps"
            )
            yield Finding("direction-not-of-motion", side, evidence, "another column, or the sign of the motion")
        elif against := _runs_against_motion(run[1:][moved], same):
            labels = ", ".join(recording.run_labels()[k] for k in against)
            evidence = f"in run {labels} it is the opposite of the motion of {place}, and not in the others"
            yield Finding("reversed-direction", side, evidence, "+1 when approached from below (the position rises)")


def _runs_against_motion(run: np.ndarray, same: np.ndarray) -> list[int]:
    """Codes of runs in which a direction contradicts the motion, while the others follow it; run, same: (moves,)."""
    codes = np.unique(run)
    agree = np.array([same[run == k].mean() for k in codes])
    moves = np.array([np.sum(run == k) for k in codes])
    against = (agree <= 0.1) & (moves >= MIN_MOVES)
    return codes[against].tolist() if np.all(agree[~against] >= 1 - BOTH_WAYS / 2) else []


def travel(recording: Recording) -> Iterator[Finding]:
    """Positions beyond the stated travel, or in so small a part of it that the unit is wrong."""
    for axis, facts in recording.manifest.constants.items():
        name = recording.name("command", axis=axis) or recording.name("position", axis=axis)
        if facts.role != "axis" or facts.travel is None or name is None:
            continue
        x = recording.array(name)
        low, high = sorted(facts.travel)
        if not np.isfinite(x).any() or high <= low:
            continue
        margin = OUTSIDE * (high - low)
        extent = (float(np.nanmin(x)), float(np.nanmax(x)))
        if extent[0] < low - margin or extent[1] > high + margin:
            evidence = (
                f"positions from {extent[0]:.6g} to {extent[1]:.6g} leave the travel {low:g} to {high:g} of {axis}"
            )
            ratio = max(abs(extent[0]), abs(extent[1])) / max(abs(low), abs(high), 1e-12)
            yield Finding("outside-travel", name, evidence, _other_unit(ratio))
        elif 0 < extent[1] - extent[0] < 1.2 / INCH * (high - low):
            share = 100 * (extent[1] - extent[0]) / (high - low)
            evidence = f"positions span {extent[1] - extent[0]:.4g}, {share:.2g} % of the travel of {axis}"
            yield Finding("outside-travel", name, evidence, "positions in inch or m that were declared as mm")


def _other_unit(ratio: float) -> str:
    if ratio > 300:
        return "positions in um that were declared as mm, or a travel in m"
    if ratio > 5:
        return "positions in mm that were declared as inch, or a travel in inch"
    return "another axis, or another zero of the travel"


def run_per_row(recording: Recording) -> Iterator[Finding]:
    """A run column with a new label in every row: held-out runs would be single rows."""
    name = recording.name("run")
    rows = len(recording)
    if name is not None and rows >= MIN_MOVES and len(recording.run_labels()) > 0.9 * rows:
        evidence = f"{len(recording.run_labels())} labels in {rows} rows"
        yield Finding("run-per-row", name, evidence, "another column (this one looks like a row number)")


def speed(recording: Recording) -> Iterator[Finding]:
    """An implausibly fast axis: time in another unit, or position in another unit."""
    time = recording.name("time")
    if time is None:
        return
    t, run = recording.array(time), recording.run_codes()
    for name in recording.names("position"):
        x, unit = recording.array(name), recording.manifest.columns[name].unit or "mm"
        with np.errstate(divide="ignore", invalid="ignore"):
            rate = np.abs(np.diff(x) / np.diff(t))[np.diff(run) == 0]
        rate = rate[np.isfinite(rate) & (rate > 0)]
        if rate.size >= MIN_MOVES and float(np.median(rate)) > MAX_SPEED.get(unit, np.inf):
            evidence = f"half of all steps of {name} are faster than {np.median(rate):.4g} {unit}/s"
            yield Finding(
                "too-fast", time, evidence, "a time in ms, min or h that was declared as s, or a position in um"
            )


def temperatures(recording: Recording) -> Iterator[Finding]:
    """A temperature in kelvin, in tenths, or a column that is not a temperature."""
    for name in recording.names("temperature"):
        t = recording.array(name)
        t = t[np.isfinite(t)]
        if not t.size:
            continue
        low, high = float(t.min()), float(t.max())
        if ROOM[0] <= low and high <= ROOM[1]:
            yield from _steps(recording, name)
            continue
        evidence = f"readings from {low:.5g} to {high:.5g} degC"
        if low > 100 and high < 400:
            meant = "tenths of a degree" if low < 250 or high > 340 else "K, or tenths of a degree"
        elif low > 1500 and high < 4000:
            meant = "hundredths of a degree"
        elif _kelvin_in_part(t):
            meant = "degC in some rows and K in others (one unit in all of them)"
        else:
            meant = "another column, or a sensor that failed (clean it, or give the column the role ignore)"
        yield Finding("temperature-range", name, evidence, meant)


def _kelvin_in_part(t: np.ndarray) -> bool:
    """Whether finite readings are in a shop's range, degC, after subtracting 273.15 from the hot ones."""
    hot = t > ROOM[1]
    rest = np.where(hot, t - 273.15, t)
    return bool(hot.any() and (t[hot] > 250.0).all() and rest.min() >= ROOM[0] and rest.max() <= ROOM[1])


def _steps(recording: Recording, name: str) -> Iterator[Finding]:
    """A temperature that leaves its level from one row of a run to the next, and returns as suddenly."""
    t, time, run = recording.array(name), recording.name("time"), recording.run_codes()
    gap = np.diff(recording.array(time)) if time else np.zeros(t.size - 1)
    steps = np.where((np.diff(run) == 0) & (gap < STEP_GAP), np.diff(t), 0.0)
    sudden = np.flatnonzero(np.abs(np.nan_to_num(steps)) > STEP)
    for away, back in pairwise(sudden):
        if steps[away] * steps[back] < 0 and abs(t[back + 1] - t[away]) < RETURN * abs(steps[away]):
            evidence = f"a step of {abs(steps[away]):.3g} K between row {away + 1} and the next, and back as suddenly"
            meant = "a sensor that lost contact or power (clean it, or ignore it)"
            yield Finding("temperature-jump", name, evidence, meant, "ask")  # fits give such rows no leverage
            return


def all_in_fahrenheit(recording: Recording) -> Iterator[Finding]:
    """Every temperature above the limit of a machine's coldest part: degF."""
    names = recording.names("temperature")
    lows = [np.nanmin(t) for n in names if np.isfinite(t := recording.array(n)).any()]
    if lows and COLDEST < min(lows) < ROOM[1]:
        evidence = f"no temperature is below {min(lows):.4g} degC"
        yield Finding("temperature-range", names[0], evidence, "degF that was declared as degC")


def fahrenheit(recording: Recording) -> Iterator[Finding]:
    """A temperature that follows another one with a factor of 1.8: degF and degC."""
    names = recording.names("temperature")
    for name in names:
        t = recording.array(name)
        for other in names:
            u = recording.array(other)
            good = np.isfinite(t) & np.isfinite(u)
            if name == other or good.sum() < MIN_MOVES:
                continue
            if float(np.median(t[good])) > 50 and np.abs(t[good] - (1.8 * u[good] + 32)).max() < 4.0:
                evidence = f"it is 1.8 times {other} plus 32"
                yield Finding("temperature-range", name, evidence, "degF that was declared as degC")
                break
            if _is_cold_in_fahrenheit(t[good], u[good]):
                cold = float(t[good][np.argmin(u[good])])
                evidence = f"it is {cold:.3g} degC where {other} is coldest, {np.min(u[good]):.3g} degC"
                yield Finding("temperature-range", name, evidence, "degF that was declared as degC")
                break


COLD_START, WARMING = 3.0, 1.0  # K: between two sensors of a cold machine; smallest rise of one that warms up
MIN_CORRELATION = 0.9  # correlation of two sensors that warm up together


def _is_cold_in_fahrenheit(t: np.ndarray, other: np.ndarray) -> bool:
    """Whether a sensor that is never cool reads, in degF, the temperature of another one in degC when that is coldest.

    Both must warm up together: a heated bed or a hot motor does not follow its room.
    """
    celsius = (t - 32) / 1.8
    if np.min(t) < COLDEST or np.max(other) > COLDEST or np.ptp(celsius) < WARMING or np.ptp(other) == 0:
        return False
    together = float(np.corrcoef(_spread(celsius), _spread(other))[0, 1]) > MIN_CORRELATION
    return together and abs(celsius[np.argmin(other)] - np.min(other)) < COLD_START


def temperature_of_position(recording: Recording) -> Iterator[Finding]:
    """A 'temperature' that follows the position within every run: exchanged columns."""
    places = [n for role in ("command", "position") for n in recording.names(role)]
    run = recording.run_codes()
    for name in recording.names("temperature"):
        t = recording.array(name)
        for place in places:
            x = recording.array(place)
            good = np.isfinite(t) & np.isfinite(x)
            matches = []
            for k in np.unique(run[good]):
                rows = good & (run == k)
                turns = np.count_nonzero(np.diff(np.sign(np.diff(x[rows]))))
                if rows.sum() >= MIN_MOVES and turns and np.ptp(t[rows]) > 2.0 and np.ptp(x[rows]) > 0:
                    matches.append(abs(float(np.corrcoef(_spread(t[rows]), _spread(x[rows]))[0, 1])))
            if matches and float(np.median(matches)) > 0.8:
                evidence = f"it follows {place} back and forth (correlation {np.median(matches):.2f} within the runs)"
                yield Finding("not-a-temperature", name, evidence, "the columns of temperature and deviation swapped")
                break


def _spread(values: np.ndarray) -> np.ndarray:
    """Varying values, as differences from their mean in units of their range: avoids overflow and underflow."""
    return (values - values.mean()) / np.ptp(values)


DENSE_ROWS = 500  # as in the import: more are a log of an axis


def copies(recording: Recording) -> Iterator[Finding]:
    """An error column that is another column times a constant."""
    roles = ("position", "command", "temperature", "time", "feed", "spindle_speed", "velocity")
    for name in recording.names("error"):
        d = recording.array(name)
        for other in (n for role in roles for n in recording.names(role)):
            u = recording.array(other)
            good = np.isfinite(d) & np.isfinite(u)
            if good.sum() < MIN_MOVES or np.ptp(u[good]) == 0 or np.ptp(d[good]) == 0:
                continue
            x, y = _spread(u[good]), _spread(d[good])
            slope = float(x @ y) / float(x @ x)
            levels = np.unique(u[good]).size
            if levels > 5 and float(np.sqrt(np.mean((y - slope * x) ** 2))) < COPY:
                slope *= float(np.ptp(d[good])) / float(np.ptp(u[good]))
                evidence = f"it is {other} times {slope:.6g} and a constant, row for row"
                yield Finding(
                    "copy-of-column", name, evidence, "another column: this one contains no independent measurement"
                )
                break


REFERENCE = (0.5, 1 / 3)  # of the runs, from the first: reference for the others
APART = 2.0  # K between two sensors; below it an exchange is neither certain nor relevant


def sensors_of_some_runs(recording: Recording) -> Iterator[Finding]:
    """Temperatures that from some run on are exchanged, or in another unit, compared with the runs before."""
    run = recording.run_codes()
    order = list(dict.fromkeys(run.tolist()))
    for share in REFERENCE:
        outliers = outlying_runs.outliers_from_a_run_on(recording, np.isin(run, order[: int(share * len(order))]))
        if not outliers:
            continue
        names, labels = outliers[0].what.split(" and "), {o.run for o in outliers}
        rows = np.isin(run, [c for c in order if recording.run_labels()[c] in labels])
        evidence = f"{outliers[0].says} from run {outliers[0].run} on, in {len(outliers)} runs"
        if len(names) == 1:
            yield Finding("temperature-range", names[0], evidence, "another unit in part of the file", "ask")
        elif np.nanmedian(np.abs(recording.array(names[0])[rows] - recording.array(names[1])[rows])) > APART:
            yield Finding("exchanged-sensors", outliers[0].what, evidence, "plugs that were exchanged", "ask")
        return


CHECKS: tuple[Callable[[Recording], Iterator[Finding]], ...] = (
    *(axis_of_component, direction_against_motion, travel, run_per_row, speed),
    *(temperatures, all_in_fahrenheit, fahrenheit, temperature_of_position, sensors_of_some_runs, copies),
)
