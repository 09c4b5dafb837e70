"""What a person at the machine does with exported files: sign, numbers to enter, three points to compare, the loss."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from errpipe.domain import components
from errpipe.domain.table import CompensationTable
from errpipe.guard.in_table import has_guard, has_substitutes
from errpipe.stages import _artefacts, _plausible
from errpipe.targets import _sample
from errpipe.targets._base import TURN, ByHand, Curve, ReadBack, unit_of
from errpipe.targets._loss import at_most, loss_unit, losses
from errpipe.targets._whole import WholeTable

PUSH = 100.0  # N: the force of an example
MIN_BEND = 0.1  # um: a curve that is straighter is checked in its middle
AS_MEASURED = (
    "the files and numbers hold for axes that were measured with the control's own compensation and backlash off, and "
    "take their place: what was on then must be added to them, or measured again with it off"
)
MEASURED_WITH_THEM = (
    "measured while these act, a machine shows what they leave: state {{kind: ingest, recording: ..., {0}}} in its "
    "pipeline. Its files then replace these; without it they hold the remainder alone, and must not replace these"
)
NOT_ENTERED = ". Where the numbers below were not entered, add compensated_entered: false"
ZERO = (
    "positions count from the axis' own zero (machine coordinates): of a test in workpiece coordinates such as G54, "
    "the files act shifted by that offset; add it to the positions of the recording and export again"
)
RADII = (
    "positions and corrections of X are its travel: a control that counts X in diameters (a lathe) displays twice the "
    "positions below. Whether its tables count radii, as these do, or diameters is in its manual; three points show it"
)
ALONE = (
    "the files hold {0} alone: points, tables and files of another axis may have the same numbers and names, and would "
    "take their place. Axes of one machine are exported together: "
    "errpipe export {0}/table.ect OTHER/table.ect --target {1} --out DIR"
)
NOT_ASSESSED = "not assessed: in settled states the table, counted from its start, is 0; its lags are lost"
FROM_THE_START = (
    "{0}: the correction is 0 at each start of the table and counts from there: set the zero (tool, datum) then, and "
    "again after a restart while warm: otherwise the deviation at the restart stays as an offset, even once cooled"
)
CHECK_THE_SIGN = (
    f"**{_artefacts.SIGN_NOTE}.** Before "
    "anything is loaded: with the instrument of the recording set up at a target, jog the axis 0.1 mm (deg) beyond it, "
    "in the positive direction. The reading must rise by 0.1. If it falls: import with --sign commanded-minus-actual; "
    "if it rises, --sign actual-minus-commanded removes this note."
)
MIN_ZERO_SHIFT = 5e-5  # mm (deg): a smaller shift of a zero is not listed


def checklist(
    target: Any, read: Any, lost: list[dict[str, Any]], table: CompensationTable, others: Sequence[str] = ()
) -> str:
    """The text for one target. read: its files as the controller reads them; others: targets loaded with it."""
    lines = [f"# {target.name}: {target.controller}", ""]
    lines += [CHECK_THE_SIGN, ""] if _artefacts.SIGN_ASSUMED in table.title else []
    lines += [f"Sign: {target.sign}.", f"Limits: {target.limits}."]
    lines += [f"Unit: {target.unit}."]
    if _artefacts.UNGATED in table.title:
        warning = f"**{_artefacts.UNGATED}.** Measure before and after, and take it off where it is not better."
        lines += ["", warning, ""]
    lines += _sensor_monitoring(read, table)
    lines += [f"Source: {target.source}. Confidence: {target.confidence}.", ""]
    numbers = (
        *target.by_hand(table, read, others),
        *_zero_shifts(target, read, table, others),
        *_one_turn(read, table),
        *_counted_from_start(read, table),
    )
    if happens := consequences(read, table):
        lines += ["## What will happen", "", *(f"- {text}." for text in happens), ""]
    read = _within_travel(read, table)
    lines += ["## Switch it on", ""]
    over = {i.axis for i in table.inputs if i.kind == "position"}
    zero = [*([ZERO] if over else []), *([RADII] if "X" in over else [])]
    before = [AS_MEASURED, *zero, *_axis_numbers(target, table), *_single_axis(target, table)]
    steps = (*before, _measured_with(target, read, others, numbers), *target.activation)
    lines += [f"{n}. {step}" for n, step in enumerate(steps, 1)]
    if numbers:
        lines += ["", "## Enter by hand", "", *(f"- {number.text}." for number in numbers)]
    lines += ["", "## Three-point check", ""]
    if moves := _moves(read):
        lines += [
            "Approach each position from below, then from above, with all axes; put the other axes at mid travel. "
            "The control must apply this correction.",
            _reference_state(table),
            *_besides_the_files(numbers),
        ]
        unit = "um, deg/1000" if any(map(components.is_rotary, read.axes())) else "um"
        head = f"| axis | over | position | from below, {unit} | from above, {unit} |"
        lines += ["", head, "| --- | --- | --- | --- | --- |"]
        lines += moves
    else:
        lines += ["Nothing of this table acts over a position or per kelvin: compare the outputs in two known states."]
    lines += ["", "## What this format cannot express", ""]
    lines += [
        f"- {x['axis']}: {x['rms_um']:.3g} {loss_unit(x['axis'])} rms of {x['table_rms_um']:.3g}, "
        f"at most {at_most(x['bound_um'])} {loss_unit(x['axis'])}"
        if x["assessed"]
        else f"- {x['axis']}: {NOT_ASSESSED}"
        for x in lost
    ]
    lines += _with_numbers(table, read, numbers)
    if lost:
        seen = lost[0]["states"]
        lines += [
            "",
            f"At most: bound for settled states inside travel and validity range. Rms: of {seen} random ones.",
        ]
    return "\n".join([*lines, ""])


def _measured_with(target: Any, read: Any, others: Sequence[str], numbers: Sequence[ByHand]) -> str:
    """How a measurement is declared that was made with these files on."""
    formats = "" if isinstance(read, WholeTable) else f", compensated_as: [{', '.join((target.name, *others))}]"
    entered = any(number.curve is not None for number in numbers)
    return MEASURED_WITH_THEM.format(f"compensated_by: table.ect{formats}") + (NOT_ENTERED if entered else "")


def consequences(read: Any, table: CompensationTable) -> list[str]:
    """What the files will do, in sentences: the largest correction of each axis, and what they assume."""
    read = _within_travel(read, table)
    texts = (
        *_plausible.of_files(read, table),
        *_plausible.not_measured(table),
        *_at_the_axis(table),
        *_of_force(table),
    )
    return list(dict.fromkeys(texts))


def _sensor_monitoring(read: Any, table: CompensationTable) -> list[str]:
    """Effect of a failed temperature sensor: undetected unless table and format monitor it."""
    if not _sample.sensors_of(table):
        return []
    if isinstance(read, WholeTable) and has_guard(table):
        if has_substitutes(table):
            return ["Sensors: temperatures are monitored against each other; others replace one that fails."]
        return ["Sensors: each temperature is monitored individually; the correction fades if one fails."]
    why = "the table has no guard" if isinstance(read, WholeTable) else "this format has no memory for a guard"
    warning = f"**Temperatures are not monitored ({why}).** The correction follows a failed sensor."
    return ["", warning, ""]


def _single_axis(target: Any, table: CompensationTable) -> list[str]:
    """That files of one axis and those of another may take the same numbers and names on one control."""
    moved = list(_sample.outputs_by_axis(table))
    return [ALONE.format(moved[0], target.name)] if len(moved) == 1 else []


def _axis_numbers(target: Any, table: CompensationTable) -> list[str]:
    """Which axis the files mean by a number: the table does not know all axes of the machine."""
    if not target.numbering:
        return []
    named = (f"{axis} is {target.numbering.format(n, n + 1)}" for n, axis in enumerate(_sample.axes_of(table)))
    return [
        f"in the files {', '.join(named)}, as on a machine of these axes. Compare with the machine's own numbers and "
        "change them where they differ, else another axis is moved"
    ]


def _zero_shifts(target: Any, read: Any, table: CompensationTable, others: Sequence[str]) -> list[Any]:
    """What switching on does to the zero of each axis that has a curve over itself."""
    out = []
    for axis in dict.fromkeys(c.axis for c in read.curves if c.axis == c.over):
        if axis not in _sample.positions_of(table):
            continue
        unit, (low, high) = unit_of(axis), _sample.span(table, axis)
        x = np.append(np.linspace(low, high, 41), np.clip(0.0, low, high))
        curves = [c for c in read.curves if c.axis == c.over == axis]
        in_file = np.sum(
            [(np.interp(x, c.positions, c.up) + np.interp(x, c.positions, c.down)) / 2 for c in curves], axis=0
        )
        if target.keeps_level and abs(in_file[-1]) > MIN_ZERO_SHIFT:
            text = f"at {axis} = {x[-1]:g} {unit} the file states {in_file[-1]:+.4f} {unit}"
            out.append(ByHand(f"reference zero: {text}, so the zero of {axis} moves by it"))
        elif not target.keeps_level and not others:
            in_table = _sample.curve(table, axis, axis, x[:-1])
            level = float(np.mean((in_table.up + in_table.down) / 2 - in_file[:-1]))
            if abs(level) > MIN_ZERO_SHIFT:
                text = (
                    f"reference zero: the file is 0 there; the datum of {axis} keeps the constant {level:+.4f} {unit}"
                )
                part = Curve(axis, axis, np.array([low, high]), np.full(2, level), np.full(2, level))
                out.append(ByHand(text, part))
    return out


def _one_turn(read: ReadBack, table: CompensationTable) -> list[ByHand]:
    """Over axes that turn on, what a file that ends after one turn asks of the control's way of counting."""
    parts = replace(read, curves=tuple(c for c in read.curves if np.ptp(c.up) or np.ptp(c.down))).grids()
    known, out = _sample.positions_of(table), []
    for over in dict.fromkeys(over for over, x in parts if x[-1] - x[0] < 2 * TURN):
        if over in known and _sample.turns(table, over):
            low, high = _sample.span(table, over)
            if isinstance(read, WholeTable):
                place = table.inputs[table.input_index(known[over])]
                out.append(
                    f"{over}: the table repeats with every turn; its position must count on, from {place.low:g} to "
                    f"{place.high:g} deg at most: a drop from {high:g} to {low:g} deg is taken as a reversal, and what "
                    "a reversal changes is wrong after it"
                )
                continue
            out.append(
                f"{over}: the file covers one turn, {low:g} to {high:g} deg, and its ends are held beyond: the control "
                f"must count {over} in this range in every turn; with any other count the error can double"
            )
    return [ByHand(text) for text in out]


def _counted_from_start(read: ReadBack, table: CompensationTable) -> list[ByHand]:
    """Remarks on what the table counts from its start: the zero to set, and what a file counts from a fixed reading."""
    if isinstance(read, WholeTable):
        sensors = _sample.sensors_of(table)
        axes = [a for a in read.axes() if any(_sample.counts_from_start(table, a, s) for s in sensors)]
        return [ByHand(FROM_THE_START.format(", ".join(axes)))] if axes else []
    lines = read.lines
    return [
        ByHand(
            f"{x.axis}: the table counts {x.sensor} from its reading at the start of the machine; the file counts from "
            f"{x.reference:g} degC: put the reading at each start in its place, else a machine that starts at another "
            "temperature is corrected by the difference"
        )
        for x in lines
        if _sample.counts_from_start(table, x.axis, x.sensor)
    ]


def _besides_the_files(numbers: Sequence[ByHand]) -> list[str]:
    """By how much lost motion entered by hand separates the directions: the move list is that of the files alone."""
    apart: dict[str, float] = {}
    for c in (number.curve for number in numbers if number.curve is not None):
        apart[c.axis] = apart.get(c.axis, 0.0) + 1e3 * float(c.up[0] - c.down[0])
    words = "; ".join(f"{axis} {value:.2f} {loss_unit(axis)}" for axis, value in apart.items() if value)
    return [f"It is that of the files: lost motion entered by hand adds between both directions {words}."] * bool(words)


def _with_numbers(table: CompensationTable, read: Any, numbers: Sequence[Any]) -> list[str]:
    """The residual once the numbers are entered; empty if they add nothing to the files."""
    parts = tuple(number.curve for number in numbers if number.curve is not None)
    if not parts:
        return []
    remaining = [x for x in losses(table, read + ReadBack(curves=parts)) if x.axis in {c.axis for c in parts}]
    words = "; ".join(
        f"{x.axis} {x.rms:.3g} {loss_unit(x.axis)} rms, at most {at_most(x.bound)} {loss_unit(x.axis)}"
        for x in remaining
    )
    return [f"- with the numbers entered by hand: {words}"]


def _of_force(table: CompensationTable) -> list[str]:
    """What a force reading does, and that without one nothing is corrected for it."""
    texts = []
    for force in (i for i in table.inputs if i.kind == "force"):
        for axis in _sample.outputs_by_axis(table):
            pushed = _sample.corrections(table, axis, {force.name: np.array([0.0, PUSH])}, np.ones(2))
            moved = 1e3 * float(pushed[1] - pushed[0])  # um
            if abs(moved) > 1e-3:
                texts.append(
                    f"at {force.name} = {PUSH:g} N and mid travel {axis} is commanded {abs(moved):.3g} um "
                    f"{'less' if moved < 0 else 'more'}; without a reading of {force.name}, with an old one, or one "
                    f"beyond {force.high:g} N, no force correction is made"
                )
    return texts


def _at_the_axis(table: CompensationTable) -> list[str]:
    """How a component that belongs to no axis, such as a diameter, moves the axis that corrects it."""
    texts = []
    for output in table.outputs:
        for term in output.terms:
            try:
                parsed = components.parse(term.component)
            except ValueError:
                continue
            if output.axis and parsed.kind in ("diameter", "circular") and not term.factors:
                along, less = 10.0 * term.weight, "less" if term.weight > 0 else "more"
                texts.append(
                    f"a {components.describe(parsed.name)} of +10 um corresponds to {along:+g} um along {output.axis}: "
                    f"{output.axis} is commanded {abs(along):g} um {less} (factor {term.weight:g}, from acts_on of "
                    "the export or the recording; verify the sign on one turned part)"
                )
    return texts


def _within_travel(read: Any, table: CompensationTable) -> Any:
    """What was read back, its curves cut at the ends of travel: a file's grid may reach further than the axis."""
    curves = []
    for c in read.curves:
        low, high = _sample.reach(table, c.over)
        inside = c.positions[(c.positions > low) & (c.positions < high)]
        x = np.concatenate(([low], inside, [high])) if high > low else c.positions
        up, down = (np.interp(x, c.positions, v) for v in (c.up, c.down))
        curves.append(replace(c, positions=x, up=up, down=down))
    return replace(read, curves=tuple(curves))


def _reference_state(table: CompensationTable) -> str:
    """The readings at which the expected corrections hold."""
    start, moving = _sample.reference_readings(table), set(_sample.positions_of(table).values())
    steady = [f"{i.name} = {start[i.name]:g} {i.unit}".rstrip() for i in table.inputs if i.name in set(start) - moving]
    if not steady:
        return "It depends on no temperature and no speed."
    return f"It holds at {', '.join(steady)}, all of them steady; at other readings expect other values."


def _moves(read: Any) -> list[str]:
    """Rows of the move list: three points of each curve, the corners of each product, one kelvin of each sensor.

    The three points are both ends, and where the correction is furthest from the straight line between them.
    """
    ends, lines = read.spans(), []
    for axis, over in dict.fromkeys((c.axis, c.over) for c in read.curves):
        places = (ends[over][0], _most_bent(read, axis, over), ends[over][1])
        lines += [_move(read, axis, {over: float(x)}) for x in places]
    for axis, (a, b) in dict.fromkeys((p.axis, p.over) for p in (*read.products, *read.planes)):
        lines += [_move(read, axis, {a: x, b: y}) for x in ends[a] for y in ends[b]]
    for line in read.lines:
        per_kelvin = 1e3 * line.level
        lines.append(f"| {line.axis} | {line.sensor} +1 K | {line.zero:.3f} | {per_kelvin:+.3f} | {per_kelvin:+.3f} |")
    return lines


def _corrections(read: Any, axis: str, at: Mapping[str, np.ndarray], side: float) -> np.ndarray:
    """Corrections of an axis, mm (deg), at positions (n,); other axes in the middle, sensors at their reference."""
    size = next(iter(at.values())).size
    middle = {over: np.full(size, (low + high) / 2) for over, (low, high) in read.spans().items()}
    cold = {line.sensor: np.full(size, line.reference) for line in read.lines}
    return np.asarray(read.correction(axis, middle | dict(at), np.full(size, side), cold))


def _move(read: Any, axis: str, at: Mapping[str, float]) -> str:
    """A row of the move list: corrections at one place, come to from below and from above."""
    place = {over: np.full(1, x) for over, x in at.items()}
    up, down = (1e3 * float(_corrections(read, axis, place, side)[0]) for side in (1.0, -1.0))
    where = ", ".join(f"{x:.3f}" for x in at.values())
    return f"| {axis} | {' and '.join(at)} | {where} | {up + 0.0:+.2f} | {down + 0.0:+.2f} |"


def _most_bent(read: Any, axis: str, over: str) -> float:
    """Where the correction is furthest from the straight line between its ends; the middle where it is straight."""
    low, high = read.spans()[over]
    x = np.sort(np.append(_sample.spread(low, high, 101), (low + high) / 2))
    value = _corrections(read, axis, {over: x}, 1.0)
    off = np.abs(value - np.interp(x, (low, high), value[[0, -1]]))
    return float(x[off.argmax()]) if 1e3 * off.max() > MIN_BEND else (low + high) / 2
