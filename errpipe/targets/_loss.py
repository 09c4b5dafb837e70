"""What a format loses of a table: a bound over all settled states inside validity, and rms over random ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from itertools import product

import numpy as np

from errpipe.domain.components import is_rotary
from errpipe.domain.machine import LETTERS, PARALLEL_AXIS
from errpipe.domain.table import CompensationTable
from errpipe.fitting.statistics import rms
from errpipe.guard.in_table import without_guard
from errpipe.tables import maximum
from errpipe.tables.expansion import SIDE, Expansion, Term, Terms, collected, scaled
from errpipe.targets import _sample
from errpipe.targets._base import Curve, Line, Plane, ReadBack
from errpipe.targets._whole import WholeTable

STATES = 2000  # random states for the rms
AT_ENDS = 0.3  # share of them at an end of each validity range
MUCH, LITTLE = 0.05, 0.5  # share, and um: files that are worse than none by less are not remarked (by judgement)
# Share of `validation.machine.MIN_IMPROVEMENT`, and um that a format may round: more is remarked by `turning`.
TURNS_BY, ROUNDED = 0.01, 0.1
UM = 1e3  # per mm (thousandths of a degree per degree)
DIRECTIONS = LETTERS | {letter: LETTERS[PARALLEL_AXIS[letter]] for letter in "UVW"}
Mean = tuple[np.ndarray, float]  # values and a mean of others
# Positions of axes, each (n,) -> linear axes, motion of the tool point per mm of each (n, 3, axes), and the tool point
# (n, 3) in mm, in the workpiece's frame.
Motion = Callable[[Mapping[str, np.ndarray]], tuple[tuple[str, ...], np.ndarray, np.ndarray]]


def loss_unit(axis: str) -> str:
    """Unit of the losses of an axis: a thousandth of mm or deg."""
    return "deg/1000" if is_rotary(axis) else "um"


@dataclass(frozen=True)
class Loss:
    """Of one axis, um (or thousandths of a degree): between files and table, and of the table itself.

    bound: no settled state inside travel and validity, approached from either side, differs by more; largest, rms: on
    STATES random ones; table_rms: what the table corrects on them. constant: mean difference over the travel, without
    which these are stated where setting the zero of the axis takes it: of a linear axis that no sensor moves.
    """

    axis: str
    bound: float
    largest: float
    rms: float
    table_rms: float
    constant: float = 0.0


def losses(table: CompensationTable, read: ReadBack) -> list[Loss]:
    """Per axis, difference between the files as the controller reads them and the table."""
    compared, out = list(_compared(table, read)), []
    zeros = {axis: constant for axis, (_, constant), _, zero_is_set in compared if zero_is_set}
    by_axis = bounds(table, read, zeros)
    for axis, (gap, constant), (want, level), zero_is_set in compared:
        if zero_is_set:
            gap, want = gap - constant, want - level
        largest = float(np.abs(gap).max())
        out.append(Loss(axis, by_axis[axis].bound, largest, rms(gap), rms(want), zeros.get(axis, 0.0)))
    return out


def harmed(table: CompensationTable, read: ReadBack) -> dict[str, tuple[float, float]]:
    """Axis -> rms with and without the files, um (deg/1000), where they do harm in the mean of all states.

    Both without the constant that setting the zero in the middle state takes.
    """
    both = {a: (rms(gap - lost), rms(want - level)) for a, (gap, lost), (want, level), _ in _compared(table, read)}
    return {axis: (left, without) for axis, (left, without) in both.items() if left > without + LITTLE}


def _compared(table: CompensationTable, read: ReadBack) -> Iterator[tuple[str, Mean, Mean, bool]]:
    """Axis, files minus table and table on random states with their means in the middle state; whether a zero is set.

    That is so for a linear axis that positions alone move: setting it takes a constant. Thermal growth is none.
    """
    states, side = _states(table, np.random.default_rng(1))
    names, start = _sample.positions_of(table).values(), _sample.reference_readings(table)
    usual = {name: states[name] if name in names else np.full(STATES, v) for name, v in start.items()}
    for axis in _sample.outputs_by_axis(table):
        (gap, want), (lost, level) = (_difference(table, read, axis, at, side) for at in (usual | states, usual))
        by_positions = np.allclose(want, level, atol=1e-6) and np.ptp(want) > 0.0 and not is_rotary(axis)
        yield axis, (gap, float(lost.mean())), (want, float(level.mean())), bool(by_positions)


def _difference(
    table: CompensationTable, read: ReadBack, axis: str, states: Mapping[str, np.ndarray], side: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Files minus table, and the table, um (deg/1000), in states of all inputs."""
    at = {letter: states[name] for letter, name in _sample.positions_of(table).items()}
    want = UM * _sample.corrections(table, axis, states, side)
    return UM * read.correction(axis, at, side, states) - want, want


def worse_than_none(table: CompensationTable, read: ReadBack) -> list[str]:
    """Per axis, the end of a sensor's validity at which the files harm most, over the travel, other sensors as usual.

    A file without temperatures has the curve of one thermal state, and in another it may act the wrong way.
    """
    names, start = _sample.positions_of(table), _sample.reference_readings(table)
    places = {names[a]: np.tile(np.linspace(*ends, STATES // 2), 2) for a, ends in travel(table).items()}
    usual = {n: np.full(STATES, v) for n, v in start.items()} | places
    side, worst = np.repeat([1.0, -1.0], STATES // 2), dict[str, tuple[float, str]]()
    ends = [(i.name, v) for i in table.inputs if i.kind == "sensor" and not i.optional for v in i.valid or ()]
    for axis, (sensor, reading) in product(_sample.outputs_by_axis(table), ends):
        left, without = map(rms, _difference(table, read, axis, usual | {sensor: np.full(STATES, reading)}, side))
        if left - without > max(MUCH * without + LITTLE, worst.get(axis, (0.0, ""))[0]):
            where = f"worse than without these files where {sensor} = {reading:.4g} degC"
            figures = f"{left:.3g} instead of {without:.3g} {loss_unit(axis)} rms"
            worst[axis] = left - without, f"{axis}: {where}: {figures}; they hold the curve of one thermal state"
    return [sentence for _, sentence in worst.values()]


def turning(table: CompensationTable, read: ReadBack, motion: Motion | None = None) -> dict[str, tuple[float, float]]:
    """Linear axis -> rms with and without files, um, of a part in its best-fitting pose, where it is worse with them.

    A part is set up on the machine, which absorbs a rigid motion (ISO 230-1), and axes are set to zero. Files that
    correct a squareness along one axis only turn the part, and another axis gets worse. motion: of the machine; left
    out: axes along X, Y, Z, and nothing is said of a table with rotary axes. Temperatures are as usual.
    """
    known, outputs = _sample.positions_of(table), _sample.outputs_by_axis(table)
    along = all(axis[0] in DIRECTIONS for axis in (*known, *outputs))
    if len(known) < 2 or not (motion or along):
        return {}
    states, side = _states(table, np.random.default_rng(1))
    at = {axis: states[known[axis]] if axis in known else np.zeros(STATES) for axis in {**known, **outputs}}
    usual = {n: np.full(STATES, v) for n, v in _sample.reference_readings(table).items()}
    axes, per_mm, point = (motion or _cartesian)(at)
    left, without = np.zeros((2, STATES, len(axes)))
    for n, axis in enumerate(axes):
        if axis in outputs:
            gap, want = _difference(table, read, axis, usual | {name: states[name] for name in known.values()}, side)
            left[:, n], without[:, n] = gap, -want
    turns = np.stack([np.cross(about, point - point.mean(axis=0)) for about in np.eye(3)], axis=2)
    shifts = np.broadcast_to(np.eye(3), (STATES, 3, 3))
    free = np.concatenate([shifts, turns, per_mm], axis=2).reshape(3 * STATES, -1)
    both = np.stack([np.einsum("nia,na->ni", per_mm, e).ravel() for e in (left, without)], axis=1)
    both -= free @ np.linalg.lstsq(free, both, rcond=None)[0]
    of_axes = np.linalg.pinv(per_mm) @ both.reshape(STATES, 3, 2)
    sizes = np.sqrt(np.mean(of_axes**2, axis=0))
    worse = sizes[:, 0] > (1.0 + TURNS_BY) * sizes[:, 1] + ROUNDED
    return {axis: (float(a), float(b)) for axis, (a, b), w in zip(axes, sizes, worse, strict=True) if w}


def _cartesian(at: Mapping[str, np.ndarray]) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
    """`Motion` of axes along X, Y, Z by their letters."""
    directions = np.array([DIRECTIONS[axis[0]] for axis in at])
    per_mm = np.broadcast_to(directions.T, (STATES, 3, len(at)))
    return tuple(at), per_mm, np.stack(list(at.values()), axis=1) @ directions


def _states(table: CompensationTable, rng: np.random.Generator) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Random settled states, and the side each is approached from.

    Positions are uniform over the travel: its ends are points of most files, which lose nothing there. Other inputs are
    often at an end of their validity.
    """
    side = np.where(rng.random(STATES) < 0.5, 1.0, -1.0)

    def drawn(low: float, high: float) -> np.ndarray:
        at = rng.random(STATES)
        inside = low + (high - low) * rng.random(STATES)
        return np.where(at < AT_ENDS / 2, low, np.where(at > 1 - AT_ENDS / 2, high, inside))

    names = _sample.positions_of(table)
    states = {names[axis]: rng.uniform(*ends, STATES) for axis, ends in travel(table).items()}
    known = [i for i in table.inputs if i.valid is not None and not i.optional and i.name not in states]
    states |= {i.name: drawn(*i.valid) for i in known if i.valid is not None}
    return states, side


def travel(table: CompensationTable) -> dict[str, tuple[float, float]]:
    """Axis -> range of the loss: its profiles' range inside validity, with room to run up to each point."""
    out = {}
    for i in table.inputs:
        if i.kind == "position":
            low, high = _sample.span(table, i.axis)
            valid = i.valid or (low, high)
            low = max(low, valid[0], i.low + _sample.RUN_UP)
            out[i.axis] = low, max(low, min(high, valid[1], i.high - _sample.RUN_UP))
    return out


def bounds(table: CompensationTable, read: ReadBack, less: Mapping[str, float]) -> dict[str, maximum.Maximum]:
    """Axis -> bound of the difference between files and table, less a constant, um."""
    axes = _sample.outputs_by_axis(table)
    if isinstance(read, WholeTable) and read.table == table:
        return dict.fromkeys(axes, maximum.Maximum(0.0, 0.0))
    more: dict[str, list[np.ndarray]] = {}
    for axis, grid in read.grids():
        more.setdefault(axis, []).append(grid)
    tables = [table, *([read.table] if isinstance(read, WholeTable) else [])]
    expansion = Expansion(travel(table), more, tables, run_up=_sample.RUN_UP)
    out, by_table = {}, _moved(expansion, table)
    if isinstance(read, WholeTable):
        by_files = _moved(expansion, read.table)
    else:
        by_files = {axis: _read(expansion, table, read, axis) for axis in axes}
    for axis in axes:
        constant = Term(-less.get(axis, 0.0))
        gap = [*scaled(by_files.get(axis, []), UM), *scaled(by_table[axis], -UM), constant]
        out[axis] = maximum.largest(collected(gap), expansion.knots)
    return out


def _moved(expansion: Expansion, table: CompensationTable) -> dict[str, Terms]:
    """Axis -> correction of a table, mm (deg)."""
    deviation = expansion.outputs(without_guard(table), _sample.reference_readings(table))
    return {
        axis: [
            x for o in outputs for x in scaled(deviation[o.name], -o.factor * _sample.MACHINE_UNITS[o.correction_unit])
        ]
        for axis, outputs in _sample.outputs_by_axis(table).items()
    }


def _read(expansion: Expansion, table: CompensationTable, read: ReadBack, axis: str) -> Terms:
    """Correction of one axis by files, mm (deg)."""
    out: Terms = []
    for c in read.curves:
        out += _curve(expansion, c) if c.axis == axis else []
    for p in read.planes:
        out += _plane(expansion, p) if p.axis == axis else []
    for q in read.products:
        if q.axis == axis:
            first, second = map(expansion.curve, q.over, q.positions, q.values)
            out += expansion.product([first], [second])
    for line in read.lines:
        out += _line(expansion, table, line) if line.axis == axis else []
    return out


def _curve(expansion: Expansion, c: Curve) -> Terms:
    """Mean of both directions, and half their difference times the side."""
    half = expansion.curve(c.over, c.positions, (c.up - c.down) / 2)
    mean = expansion.curve(c.over, c.positions, (c.up + c.down) / 2)
    return [mean, Term(half.factor, half.curves, (SIDE + c.over,))]


def _plane(expansion: Expansion, p: Plane) -> Terms:
    """Bilinear: for each position of the first axis a hat over it times the row over the second."""
    out = []
    for hat, row in zip(np.eye(p.first.size), p.values, strict=True):
        if row.any():
            first, second = expansion.curve(p.over[0], p.first, hat), expansion.curve(p.over[1], p.second, row)
            out.append(Term(1.0, {**first.curves, **second.curves}))
    return out


def _line(expansion: Expansion, table: CompensationTable, line: Line) -> Terms:
    """(reading - reference) x (level + slope x (position - zero))."""
    channel = table.inputs[table.input_index(line.sensor)]
    along: Mapping[str, np.ndarray] = expansion.knots
    way = [Term(line.slope, {line.axis: along[line.axis] - line.zero})] if line.axis in along and line.slope else []
    return expansion.product([*expansion.input(channel), Term(-line.reference)], [Term(line.level), *way])


def at_most(bound: float) -> str:
    """A bound in three digits that are not below it."""
    unit = 10.0 ** (math.floor(math.log10(bound)) - 2) if bound > 0 else 1.0
    return f"{math.ceil(bound / unit - 1e-9) * unit:.3g}"
