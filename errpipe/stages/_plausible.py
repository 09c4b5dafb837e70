"""Plausibility checks before export, and one sentence per axis on the effect of the correction."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.domain.error_model import ErrorModel
from errpipe.domain.recording import Recording
from errpipe.domain.table import CompensationTable
from errpipe.fitting.components import evaluate
from errpipe.stages import _inputs
from errpipe.tables import bounds
from errpipe.tables.limits import MAX_MAGNITUDE
from errpipe.targets import _sample
from errpipe.validation import plausibility

PLACES = 41  # positions along an axis at which corrections are evaluated for the largest
NOT_MEASURED = re.compile(r"(\w+) not measured from (\S+) to (\S+) deg")  # `interpolated_turn`
SAME = 1e-6  # mm (deg): corrections of both sides that differ by less are one
UNBOUNDED = (-1e5, 1e5)  # mm: the plausible range of a position (`_inputs.CHANNELS`) where no profile has an end


def refuse(recording: Recording, model: ErrorModel, allow: Sequence[str], limit: float | None) -> list[str]:
    """Notes on what was allowed or should be checked. Raises GateError for an implausible recording or correction."""
    results = plausibility.findings(recording)
    travels = _inputs.travel(model)
    for name, values in evaluate(model, recording).items():
        component = components.parse(name)
        finite = values[np.isfinite(values)]
        low, high = travels.get(component.axis or "", (0.0, 0.0))
        largest = float(np.abs(finite).max()) if finite.size else 0.0
        over = plausibility.too_large(name, largest, component.unit, high - low, limit)
        results += [over] if over is not None else []
    return plausibility.refuse(results, allow)


def refuse_table(table: CompensationTable, allow: Sequence[str], limit: float | None) -> None:
    """Raises GateError if a table moves an axis further than a machine tool can be wrong.

    Judged by samples over the profiles' range; by bounds where they and the table's limits leave more than any machine
    is wrong by, such as a correction that follows a position without a profile.
    """
    results = []
    reach = {r.name: r.deviation for r in bounds.outputs(table)}
    for axis, outputs in _sample.outputs_by_axis(table).items():
        rotary = components.is_rotary(axis)
        size = _largest(table, axis).size
        low, high = _sample.reach(table, axis)
        travel = None if (low, high) == UNBOUNDED else high - low
        value = np.deg2rad(size) * 1e6 if rotary else 1e3 * size
        bound = sum(min(reach[o.name], o.magnitude or math.inf) for o in outputs)
        value = max(value, bound) if bound > MAX_MAGNITUDE else value
        over = plausibility.too_large(axis, value, "urad" if rotary else "um", travel, limit)
        results += [over] if over is not None else []
    plausibility.refuse(results, allow)


class _LargestCorrection:
    """The largest correction of an axis, mm (deg), and its sentence; the first one of nearly equal size is used."""

    def __init__(self, axis: str) -> None:
        self.axis, self.size, self.sentence = axis, 0.0, ""

    def over(self, name: str, at: np.ndarray, both: Mapping[float, np.ndarray], unit: str | None = None) -> None:
        """Take corrections at places of another axis or sensor into account, by side of approach (0: of no side)."""
        for side, corrections in both.items():
            k = int(np.argmax(np.abs(corrections)))
            if abs(corrections[k]) > 1.01 * self.size:
                self.size = float(abs(corrections[k]))
                of = side if side and abs(float(both[side][k] - both[-side][k])) > SAME else 0.0
                self.sentence = _sentence(self.axis, name, float(at[k]), of, -float(corrections[k]), unit)


def _largest(table: CompensationTable, axis: str) -> _LargestCorrection:
    """Of the corrections of an axis in the reference state."""
    names, out = _sample.positions_of(table), _LargestCorrection(axis)
    for over in _sample.axes_own_first(table, axis):
        low, high = _sample.span(table, over)
        if (low, high) == UNBOUNDED:
            continue
        grid = np.linspace(low, high, PLACES)
        sides = {s: _sample.corrections(table, axis, {names[over]: grid}, np.full(PLACES, s)) for s in (1.0, -1.0)}
        out.over(over, grid, sides)
    for i in table.inputs:
        if i.valid is not None and i.name not in names.values():
            ends = np.array(i.valid)
            out.over(i.name, ends, {0.0: _sample.corrections(table, axis, {i.name: ends}, np.ones(2))}, i.unit or "")
    return out


def of_table(table: CompensationTable) -> list[str]:
    """One sentence for each axis that a table moves: where its correction is largest, and its direction."""
    largest = [sentence for axis in _sample.outputs_by_axis(table) if (sentence := _largest(table, axis).sentence)]
    return [*_without_slew_limit(table), *largest, *not_measured(table)]


def _without_slew_limit(table: CompensationTable) -> list[str]:
    """A sentence for outputs without a slew limit, which every table compiled by errpipe has."""
    free = ", ".join(o.name for o in table.outputs if o.slew is None)
    sentence = (
        f"{free}: the table states no slew: where a position, a direction or a sensor jumps, an evaluator of the whole "
        "table moves the axis as far in one cycle; compile the table again with a slew before it runs"
    )
    return [sentence] if free else []


def not_measured(table: CompensationTable) -> list[str]:
    """A sentence for each rotary axis of whose turn a part was not measured: bridged (the title states it) or held."""
    bridges = [
        f"{axis} was not measured from {low} to {high} deg: the correction there is drawn from one end to the other; "
        "measure it before cutting there"
        for axis, low, high in NOT_MEASURED.findall(table.title)
    ]
    ends = {x: _sample.span(table, x) for x in _sample.positions_of(table) if components.is_rotary(x)}
    return bridges + [
        f"{axis} is corrected from {low:g} to {high:g} deg and held beyond: for an axis that turns on, state its "
        "travel (0 to 360 deg) in the recording and export again"
        for axis, (low, high) in ends.items()
        if high - low < _sample.TURN - 1e-6
    ]


def interpolated_turn(axis: str, low: float, high: float) -> str:
    """The part of a turn that was not measured, deg, from the title of a table."""
    return f"{axis} not measured from {low:g} to {high:g} deg"


def of_files(read: Any, table: CompensationTable) -> list[str]:
    """The same for what a controller made of its files (`targets._base.ReadBack`): sensors at their reference."""
    if hasattr(read, "table"):  # nothing was lost: the table itself was read back
        return of_table(read.table)
    spans = read.spans()
    cold = {line.sensor: np.full(PLACES, line.reference) for line in read.lines}
    out = []
    for axis in read.axes():
        largest = _LargestCorrection(axis)
        for over, (low, high) in sorted(spans.items(), key=lambda item: item[0] != axis):
            at = {name: np.full(PLACES, (a + b) / 2) for name, (a, b) in spans.items()}
            at[over] = np.linspace(low, high, PLACES)
            sides = {s: read.correction(axis, at, np.full(PLACES, s), cold) for s in (1.0, -1.0)}
            largest.over(over, at[over], sides)
        per_kelvin = [_per_kelvin(line) for line in read.lines if line.axis == axis][:1]
        out += [largest.sentence] if largest.sentence else per_kelvin or [_all_zero(axis, table)]
    return out


def _all_zero(axis: str, table: CompensationTable) -> str:
    """That files hold an axis without correcting it: the table's values are smaller than the least count."""
    size, unit = (3600.0, "arcsec") if components.is_rotary(axis) else (1e3, "um")
    return (
        f"{axis} is not corrected: each of its values in these files is 0 (the largest correction of the table, "
        f"{_largest(table, axis).size * size:.2g} {unit}, is less than this format can express)"
    )


def _per_kelvin(line: Any) -> str:
    sentence = _sentence(line.axis, line.sensor, line.reference + 1.0, 0.0, -line.level, "degC")
    return f"{sentence} (1 K above the reference, at {line.axis} = {line.zero:g})"


def _sentence(axis: str, over: str, at: float, side: float, deviation: float, over_unit: str | None = None) -> str:
    """The consequence in words. deviation: mm (deg) of the axis; rotary ones are given in arcsec."""
    rotary = components.is_rotary(axis)
    size, unit = (deviation * 3600, "arcsec") if rotary else (deviation * 1e3, "um")
    if over_unit is None:
        over_unit = "deg" if components.is_rotary(over) else "mm"
    return plausibility.consequence(axis, over, at, side, size, unit, over_unit)
