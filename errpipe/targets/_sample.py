"""A table sampled as a machine is measured: curves in both directions, per kelvin, and on a grid of two axes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from decimal import Decimal

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.table import CompensationTable, Output
from errpipe.errors import GateError
from errpipe.guard.in_table import without_guard
from errpipe.tables import batch
from errpipe.targets._base import KEPT_BACKLASH, TURN, ByHand, Curve, Line, Plane, Points, is_turn, unit_of

SETTLED = 1e9  # s between rows: every lag has reached its operand
RUN_UP = 2.0  # mm (deg) before the first position, so that the direction is known there
PER_KELVIN = 2.0  # K on either side for a slope
MIN_THERMAL_UM = 0.01  # per kelvin over the travel; less is left out
MAX_CURVE_INTERVALS = 4000  # intervals at which a curve is compared with the points written
MAX_POINTS = 20_000  # of any control's table
# Into which a turn is divided: steps are whole micrometres (thousandths of a degree), and short binary fractions.
TURN_INTERVALS = sorted(part << n for part in (1, 3, 5, 9, 15, 45) for n in range(7))
MIN_LOST_MOTION = 1e-4  # mm (deg) of lost motion: a tenth of a micrometre
# What controllers take, mm and deg, per correction unit of a table.
MACHINE_UNITS = {"mm": 1.0, "um": 1e-3, "deg": 1.0, "urad": math.degrees(1e-6), "rad": math.degrees(1.0)}


def outputs_by_axis(table: CompensationTable) -> dict[str, tuple[Output, ...]]:
    """Axis letter -> its outputs, whose corrections add up; outputs that move no axis are left out."""
    by_axis: dict[str, tuple[Output, ...]] = {}
    for output in table.outputs:
        if output.axis:
            by_axis[output.axis] = (*by_axis.get(output.axis, ()), output)
    return by_axis


def moved_axes(table: CompensationTable, target: str) -> dict[str, tuple[Output, ...]]:
    """`outputs_by_axis`. Raises GateError of the target where nothing moves an axis, or not in mm or deg."""
    by_axis = outputs_by_axis(table)
    if not by_axis:
        raise GateError(f"{target}: no output of the table moves an axis")
    for axis, outputs in by_axis.items():
        units = sorted({o.correction_unit for o in outputs})
        if units not in (["mm"], ["deg"]):
            raise GateError(f"{target}: corrections of {axis} in {' and '.join(units)} (mm or deg)")
    return by_axis


def positions_of(table: CompensationTable) -> dict[str, str]:
    """Axis letter -> name of the input with its position."""
    return {i.axis: i.name for i in table.inputs if i.kind == "position"}


def axes_of(table: CompensationTable) -> list[str]:
    """Axes as files number them: X, Y, Z and what the table reads or moves, in the order X Y Z A B C U V W.

    An axis that was measured alone would else have the first axis' number. X and Z without Y are a lathe's: no Y.
    """
    letters = set(positions_of(table)) | set(outputs_by_axis(table))
    there = {letter[0] for letter in letters}
    if "Y" in there or not {"X", "Z"} <= there:
        letters |= set("XYZ") - there
    return sorted(letters, key=lambda letter: ("XYZABCUVW".find(letter[0]), letter))


def axes_own_first(table: CompensationTable, axis: str) -> list[str]:
    """Letters of all axes whose position the table reads, `axis` itself first."""
    letters = list(positions_of(table))
    return [letter for letter in letters if letter == axis] + [letter for letter in letters if letter != axis]


def sensors_of(table: CompensationTable) -> list[str]:
    """Names of the temperature-like inputs."""
    return [i.name for i in table.inputs if i.kind == "sensor"]


def span(table: CompensationTable, axis: str) -> tuple[float, float]:
    """Range of the profiles over an axis, mm (deg); its plausible range if there is none."""
    name = positions_of(table)[axis]
    own = [p for p in table.profiles if p.input == name]
    if chosen := [p for p in own if not p.periodic] or own:
        return min(p.start for p in chosen), max(p.end for p in chosen)
    channel = next(i for i in table.inputs if i.name == name)
    return channel.low, channel.high


def turns(table: CompensationTable, axis: str) -> bool:
    """Whether an axis turns on: a rotary one whose range is one whole turn."""
    return is_rotary(axis) and is_turn(np.array(span(table, axis)))


def reference_readings(table: CompensationTable) -> dict[str, float]:
    """Readings of the reference state: axes at mid travel, everything else at its default."""
    readings = {i.name: i.default for i in table.inputs if not i.optional}
    for axis, name in positions_of(table).items():
        low, high = span(table, axis)
        readings[name] = (low + high) / 2
    return readings


def corrections(table: CompensationTable, axis: str, states: Mapping[str, np.ndarray], side: np.ndarray) -> np.ndarray:
    """Correction of one axis, mm (deg), in settled states, each approached from its side; shape (n,).

    states: input name -> (n,); inputs not named stand as in `reference_readings`. References (latched at the start)
    are taken in the middle state.
    """
    outputs = outputs_by_axis(table)[axis]
    start, n = reference_readings(table), side.size
    moving = set(positions_of(table).values())
    columns = {name: np.repeat(value, 4 * n) for name, value in start.items()}
    for name, values in states.items():
        rows = columns[name].reshape(n, 4)
        there = np.asarray(values, dtype=float)
        rows[:, 1:] = there[:, None]
        if name in moving:
            rows[:, 1] = rows[:, 2] = there - RUN_UP * side
    run = np.repeat(np.arange(n), 4)
    time = np.tile(np.array([0.0, SETTLED, 2 * SETTLED, 3 * SETTLED]), n)
    replay = batch.evaluate(without_guard(table), columns, time, run)
    settled = {o.name: -replay.deviation[o.name].reshape(n, 4)[:, 3] for o in outputs}
    return np.sum([settled[o.name] * (o.factor * MACHINE_UNITS[o.correction_unit]) for o in outputs], axis=0)


def curve(table: CompensationTable, axis: str, over: str, points: np.ndarray, *, relative: bool = False) -> Curve:
    """Correction of `axis` along `over`, other inputs in the middle; relative: counted from the middle state."""
    name = positions_of(table)[over]
    up = corrections(table, axis, {name: points}, np.ones(points.size))
    down = corrections(table, axis, {name: points}, -np.ones(points.size))
    if relative:
        there = np.full(1, reference_readings(table)[name])
        zero = sum(corrections(table, axis, {name: there}, np.array([s])) for s in (1.0, -1.0)) / 2
        up, down = up - zero, down - zero
    return Curve(axis, over, points, up, down)


def at_nodes(table: CompensationTable, axis: str, over: str, x: np.ndarray, *, relative: bool = False) -> Curve:
    """`curve` on a grid that may reach beyond the range of an axis.

    The first node beyond an end extrapolates so that interpolation is exact at the end; further nodes hold its value.
    Over an axis that turns on the curve repeats, and closes.
    """
    low, high = span(table, over)
    if turns(table, over):
        turned = curve(table, axis, over, low + np.mod(x - low, TURN), relative=relative)
        return Curve(axis, over, x, turned.up, turned.down)
    inside = curve(table, axis, over, np.clip(x, low, high), relative=relative)
    sides = [_beyond(_beyond(v, x, high), -x, -low, backwards=True) for v in (inside.up, inside.down)]
    return Curve(axis, over, x, sides[0], sides[1])


def _beyond(values: np.ndarray, x: np.ndarray, end: float, *, backwards: bool = False) -> np.ndarray:
    """Values of nodes beyond `end` in the direction of rising x, which hold the value at the end as they come in."""
    if backwards:
        return _beyond(values[::-1], x[::-1], end)[::-1]
    (outside,) = np.nonzero(x > end + 1e-9)
    if outside.size == 0 or outside[0] == 0 or end - x[outside[0] - 1] < 1e-6 * (x[outside[0]] - x[outside[0] - 1]):
        return values
    first = outside[0]
    rise = (values[first] - values[first - 1]) * (x[first] - x[first - 1]) / (end - x[first - 1])
    out = values.copy()
    out[first:] = values[first - 1] + rise
    return out


def uniform(table: CompensationTable, axis: str, over: str, max_points: int, error_um: float) -> tuple[Points, float]:
    """The coarsest uniform grid of at most `max_points` points within `error_um`, and its largest error in um.

    A grid of the table itself is used where no coarser one suffices: its nodes are the measured targets. Where even
    `max_points` points do not suffice, they are given with the error they leave.
    """
    low, high = span(table, over)
    fine = np.linspace(low, high, MAX_CURVE_INTERVALS + 1)
    dense = curve(table, axis, over, fine)

    def interpolation_error_um(points: Points) -> float:
        grid = points.positions()
        gaps = (np.interp(fine, grid, np.interp(grid, fine, v)) - v for v in (dense.up, dense.down))
        return 1e3 * max(float(np.abs(gap).max()) for gap in gaps)

    for count in _counts(max_points, turns(table, over)):
        points = Points(low, (high - low) / (count - 1), count)
        if interpolation_error_um(points) <= error_um:
            break
    for own in _own_grids(table, over):
        if own.count <= points.count and interpolation_error_um(own) <= error_um:
            return own, interpolation_error_um(own)
    return points, interpolation_error_um(points)


def _counts(max_points: int, turn: bool) -> Iterator[int]:
    """Numbers of points to try, ascending, at most `max_points`."""
    if turn:
        yield from (n + 1 for n in TURN_INTERVALS if n < max_points)
        return
    count = 2
    while count < max_points:
        yield count
        count = max(count + 1, int(count * 1.25))
    yield max_points


def _own_grids(table: CompensationTable, over: str) -> list[Points]:
    """Grids of the table's profiles over the whole range of an axis, the coarsest first."""
    name = positions_of(table)[over]
    low, high = span(table, over)
    grids = {Points(p.start, p.step, len(p.values)) for p in table.profiles if p.input == name}
    whole = [g for g in grids if np.allclose((g.positions()[0], g.positions()[-1]), (low, high))]
    return sorted(whole, key=lambda g: g.count)


def exact(points: Points) -> Points:
    """The grid on binary fractions, a little coarser and begun a little earlier: (end - start) / step is whole.

    To the bit: a controller that divides finds the number of intervals, not one fewer.
    """
    unit = 2.0 ** (math.floor(math.log2(points.step)) - 10)  # at most a thousandth coarser
    start = math.floor(points.start / unit + 1e-6) * unit
    end = points.start + points.step * (points.count - 1)
    step = math.ceil((end - start) / (points.count - 1) / unit - 1e-6) * unit
    return Points(start, step, points.count)


def decimal(value: float) -> str:
    """All decimal digits of a binary fraction."""
    return f"{Decimal(value + 0.0).normalize():f}"


def spread(low: float, high: float, count: int) -> np.ndarray:
    """So many places between two ends, those among them, in step with no wave: multiples of the golden section."""
    return np.sort(np.r_[low, high, low + (high - low) * (np.arange(1, count - 1) * 0.6180339887498949 % 1.0)])


def reach(table: CompensationTable, axis: str) -> tuple[float, float]:
    """`span`, or (0, 0) for an axis whose position the table does not read."""
    return span(table, axis) if axis in positions_of(table) else (0.0, 0.0)


def changes_along(table: CompensationTable, axis: str, over: str, threshold_um: float = 0.01) -> bool:
    """Whether the correction of `axis` changes along `over` by more than `threshold_um`."""
    sampled = curve(table, axis, over, spread(*span(table, over), 301))
    largest = max(np.ptp(sampled.up), np.ptp(sampled.down), np.abs(sampled.up - sampled.down).max())
    return float(largest) * 1e3 > threshold_um


def lost_motion(table: CompensationTable) -> dict[str, float]:
    """Axis -> how much further it is pushed upwards than downwards, mm (deg), the mean over its travel.

    Axes where this is below `MIN_LOST_MOTION` are left out.
    """
    own = [axis for axis in outputs_by_axis(table) if axis in positions_of(table)]
    means = {axis: float(_reversal_values(table, axis).mean()) for axis in own}
    return {axis: value for axis, value in means.items() if abs(value) >= MIN_LOST_MOTION}


def backlash(table: CompensationTable, target: str, letters: str = "") -> dict[str, float]:
    """Lost motion of the axes (of those in `letters`), mm (deg). Raises GateError for none or a negative one."""
    out = backlash_if_any(table, target, letters)
    if not out:
        raise GateError(f"{target}: no axis of the table has lost motion{of_other_axes(table, letters)}")
    return out


def of_other_axes(table: CompensationTable, letters: str) -> str:
    """End of a refusal: which axes have lost motion but none of the names that a format has; "" for none."""
    others = [axis for axis in lost_motion(table) if letters and axis not in letters]
    return f" of those that the format has ({' '.join(letters)}; found: {', '.join(others)})" if others else ""


def backlash_if_any(table: CompensationTable, target: str, letters: str = "") -> dict[str, float]:
    """As `backlash`, nothing if there is none."""
    out = {axis: value for axis, value in lost_motion(table).items() if not letters or axis in letters}
    for axis, value in out.items():
        if value < 0:
            size = f"{-1e3 * value:.3g} um" if unit_of(axis) == "mm" else f"{-value:.3g} deg"
            raise GateError(f"{target}: {axis} would have to be pushed back by {size} at reversals")
    return out


def depends_on_direction(table: CompensationTable, axis: str) -> bool:
    """Whether the correction of an axis over its own position depends on the direction of travel."""
    return axis in positions_of(table) and float(np.abs(_reversal_values(table, axis)).max()) > 0.0


def _reversal_values(table: CompensationTable, axis: str) -> np.ndarray:
    """Correction upwards less that downwards at 41 places with room to run up to each, mm (deg)."""
    c = curve(table, axis, axis, np.linspace(*span(table, axis), 43)[1:-1])
    return c.up - c.down


def backlash_by_hand(
    table: CompensationTable, axis: str, parameter: str, lost: float | None, held: str = "", remark: str = ""
) -> ByHand:
    """What becomes of a control's own backlash value, in words.

    parameter: its name, with the axis; lost: the value to enter, mm (deg); None where the files hold both directions,
    then `held` says what it must be; remark: added to the value.
    """
    if not depends_on_direction(table, axis):
        return ByHand(f"{parameter} {KEPT_BACKLASH}")
    if lost is None:
        return ByHand(f"{parameter} {held}")
    part = reversal(axis, lost, *span(table, axis)) if lost else None
    return ByHand(f"{parameter} = {lost + 0.0:.4f} {unit_of(axis)}{remark}", part)


def reversal(axis: str, lost: float, low: float, high: float) -> Curve:
    """Deviation by a reversal error: plus or minus half of it by direction, mm (deg)."""
    half = np.full(2, lost / 2)
    return Curve(axis, axis, np.array([low, high]), half, -half)


def lost_motions(pairs: Iterable[tuple[str, float]]) -> tuple[Curve, ...]:
    """The lost motion that a controller with a backlash value adds to axes, at any position."""
    return tuple(reversal(axis, lost, 0.0, 1.0) for axis, lost in pairs)


def around_zero(low: float, high: float, step: float) -> np.ndarray:
    """Whole multiples of a step from at most 0 and `low` to at least 0 and `high`, one below 0 in any case.

    Raises GateError if the travel is so many steps from 0 that no control has enough points.
    """
    first, last = min(-1, math.floor(low / step + 1e-9)), max(0, math.ceil(high / step - 1e-9))
    if last - first > MAX_POINTS:
        raise GateError(f"{last - first} points of {step:g} lie between the reference position and the ends of travel")
    return np.arange(first, last + 1)


def line(table: CompensationTable, axis: str, sensor: str) -> Line:
    """Straight line over the axis' own position, per kelvin of a sensor, in the settled state."""
    low, high = reach(table, axis)
    x = np.linspace(low, high, 41)
    zero = float(x.mean())
    base = reference_readings(table)[sensor]
    states = {positions_of(table)[axis]: x} if axis in positions_of(table) else {}
    hot, cold = (
        corrections(table, axis, {**states, sensor: np.full(x.size, base + step)}, np.ones(x.size))
        for step in (PER_KELVIN, -PER_KELVIN)
    )
    per_kelvin = (hot - cold) / (2 * PER_KELVIN)
    if high > low:
        slope, level = np.polyfit(x - zero, per_kelvin, 1)
    else:
        slope, level = 0.0, float(per_kelvin.mean())
    return Line(axis, sensor, base, float(level), float(slope), zero)


def counts_from_start(table: CompensationTable, axis: str, sensor: str) -> bool:
    """Whether the correction of an axis counts a sensor, in part at least, from its reading at the start of a run."""
    warm = reference_readings(table)[sensor] + PER_KELVIN
    inputs = tuple(i.model_copy(update={"default": warm}) if i.name == sensor else i for i in table.inputs)
    low, high = reach(table, axis)
    states = {sensor: np.full(2, warm)}
    if axis in positions_of(table):
        states[positions_of(table)[axis]] = np.array([low, high])
    cold_start, warm_start = (
        corrections(one, axis, states, np.ones(2)) for one in (table, table.model_copy(update={"inputs": inputs}))
    )
    return float(np.abs(warm_start - cold_start).max()) * 1e3 >= MIN_THERMAL_UM * PER_KELVIN


def warm_lines(table: CompensationTable, target: str) -> list[Line]:
    """The line of every axis and sensor that move together. Raises GateError of the target if there are none."""
    lines = []
    for axis in outputs_by_axis(table):
        low, high = reach(table, axis)
        for fitted in (line(table, axis, sensor) for sensor in sensors_of(table)):
            if 1e3 * (abs(fitted.level) + abs(fitted.slope) * (high - low) / 2) >= MIN_THERMAL_UM:
                lines.append(fitted)
    if not lines:
        raise GateError(f"{target}: no axis of the table moves with a temperature")
    return lines


def evenly_spaced(table: CompensationTable, axis: str, count: int) -> Points:
    """So many points over the range of an axis."""
    low, high = span(table, axis)
    return Points(low, (high - low) / (count - 1), count)


def height_map(table: CompensationTable, count: int) -> Plane | None:
    """Z over so many points along X and along Y; None for a table that does not correct Z, or reads no X or Y."""
    if "Z" not in outputs_by_axis(table) or not {"X", "Y"} <= set(positions_of(table)):
        return None
    return plane(table, "Z", ("X", "Y"), (evenly_spaced(table, "X", count), evenly_spaced(table, "Y", count)))


def plane(table: CompensationTable, axis: str, over: tuple[str, str], points: tuple[Points, Points]) -> Plane:
    """Correction of `axis` on a grid over two axes, mean of both directions of approach."""
    names = positions_of(table)
    grids = [p.positions() for p in points]
    a, b = (g.ravel() for g in np.meshgrid(*grids, indexing="ij"))
    states = {names[over[0]]: a, names[over[1]]: b}
    mean = (corrections(table, axis, states, np.ones(a.size)) + corrections(table, axis, states, -np.ones(a.size))) / 2
    return Plane(axis, over, grids[0], grids[1], mean.reshape(points[0].count, points[1].count))
