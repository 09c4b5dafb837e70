"""Absolute readings with commanded positions: sign changed if they count the other way, and subtracted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from errpipe.domain import components, units
from errpipe.errors import DataError
from errpipe.importing import columns as guessing
from errpipe.importing import order
from errpipe.importing.columns import Guesses
from errpipe.importing.layout import RawColumn
from errpipe.importing.proposed import ImportOptions, Proposal, slug

NARROW = 100.0  # a longer travel is in mm: machines above 100 inch are rare, and their files name the unit
ABSOLUTE = 0.1  # of the position: a steeper "deviation" is a reading (no axis has an error of 10 %)


def change_sign_of_readings(p: Proposal) -> None:
    """Readings that fall one for one as the command rises have the opposite sign: the actual position is minus them."""
    for name in [n for n, e in p.entries.items() if e["role"] in ("actual", "position") and n in p.data]:
        entry = p.entries[name]
        command = p.first("command", entry["axis"]) or p.first("position", entry["axis"])
        if command == name or command not in p.data:
            continue
        slope = slope_of(p.canonical(command), p.canonical(name))
        if slope is not None and abs(slope + 1.0) < ABSOLUTE:
            raw = p.put(f"{name}_as_read", p.data.pop(name), role="ignore")
            p.entries[name] = {**entry, "role": "actual", "derived": {"of": raw, "factor": -1.0}}
            p.guesses[name] = f"{raw} falls one for one as {command} rises: opposite direction, sign changed"


COUNTER_BITS = (32, 24, 16)  # widths of the counters of encoder cards and PLCs
OFF = 0.1  # of the span of a counter: readings beside the command by more are no overflow


def continue_counts(p: Proposal, resolution: float | None) -> None:
    """Count on, in place, where a counter of positions overflowed: by whole spans, from the command beside it."""
    for name, entry in p.entries.items() if resolution is not None else ():
        of = entry.get("derived", {}).get("of", name)
        command = p.first("command", entry.get("axis")) or p.first("position", entry.get("axis"))
        counted = of != name or "whole numbers: counts" in p.guesses.get(name, "")
        if entry["role"] not in ("actual", "position") or not counted or command in (None, name) or of not in p.data:
            continue
        scale, one = (resolution, 1.0) if of != name else (1.0, resolution)
        turns = (scale * p.data[of] - p.canonical(str(command))) / resolution
        start = turns[np.isfinite(turns)][:1]
        for bits in COUNTER_BITS if start.size else ():
            spans = (turns - start) / 2.0**bits
            whole = np.round(spans)
            if np.nanmax(np.abs(whole), initial=0.0) > 0 and np.nanmax(np.abs(spans - whole), initial=0.0) < OFF:
                p.data[of] = p.data[of] - whole * one * 2.0**bits
                p.notes.append(
                    f"{of}: overflow of {bits} bit corrected in {int((whole != 0).sum())} rows, by {command}"
                )
                break


def unit_by_positions(columns: Sequence[RawColumn], guesses: Guesses) -> list[str]:
    """Infer the unit of deviations without one that equal actual minus commanded position, or 1000 times it.

    Positions without a unit are in mm if they exceed any travel in inches. Returns a note on each.
    """
    kinds = {
        kind: [c for c in columns if guesses[c.header].kind == kind and c.numeric]
        for kind in ("command", "actual", "position", "error")
    }
    places, notes = kinds["command"] or kinds["position"], []
    actual = kinds["actual"] or (kinds["position"] if kinds["command"] else [])
    if len(places) != 1 or len(actual) != 1 or places[0].unit != actual[0].unit:
        return []
    unit = places[0].unit or ("mm" if np.nanmax(places[0].values) - np.nanmin(places[0].values) >= NARROW else "")
    off = actual[0].values - places[0].values
    for c in kinds["error"] if unit in ("mm", "inch") else []:
        good = np.isfinite(off) & np.isfinite(c.values)
        size = float(np.square(off[good]).sum())
        if c.unit is not None or size == 0.0:
            continue
        factor = abs(float((off[good] * c.values[good]).sum())) / size
        near = next((f for f in (1.0, 1000.0) if abs(factor / f - 1.0) < ABSOLUTE), None)
        if near is not None:
            c.unit = unit if near == 1.0 else {"mm": "um", "inch": "0.001 inch"}[unit]
            times = "" if near == 1.0 else f"{near:g} times "
            notes.append(f"{c.header} is in {c.unit}: it is {times}{actual[0].header} minus {places[0].header}")
    return notes


def slope_of(x: np.ndarray, y: np.ndarray) -> float | None:
    """Least-squares slope of y over x; None if x does not vary, or if values are too small or large."""
    good = np.isfinite(x) & np.isfinite(y)
    if good.sum() <= 3:
        return None
    with np.errstate(all="ignore"):
        from_mean = x[good] - x[good].mean()
        spread = np.square(from_mean).sum()
        slope = float((from_mean * (y[good] - y[good].mean())).sum() / spread)
    return slope if np.isfinite(spread) and np.isfinite(slope) else None


def readings_as_errors(p: Proposal, axis: str) -> None:
    """Treat an error column that follows the position as a reading: the error is derived from it."""
    place = p.first("command", axis) or p.first("position", axis)
    for name in [n for n, e in p.entries.items() if e["role"] == "error" and n in p.data]:
        entry = p.entries[name]
        if place is None or place not in p.data or entry["component"] != components.positioning(axis):
            continue
        values, unit = p.data[name], p.entries[place].get("unit", "mm")
        if "no unit is stated" not in p.guesses.get(name, "no unit is stated") and entry["unit"] != unit:
            values = _in_unit_of_places(values, entry["unit"], unit)
        slope = slope_of(p.data[place], values)
        if slope is None or abs(slope - 1.0) > ABSOLUTE:
            continue
        del p.entries[name], p.data[name]
        p.guesses.pop(name, None)
        name = f"actual_{axis}" if name == entry["component"] else name
        name = p.put(name, values, role="actual", axis=axis, unit=unit)
        p.guesses[name] = f"it rises with {place} one for one: absolute readings in {unit}, not deviations"


def _in_unit_of_places(values: np.ndarray, unit: str, of_places: str) -> np.ndarray:
    """Readings in the unit of the positions: 1 um per inch is an axis error, 25.4 mm per inch are readings."""
    of_readings, places = units.conversion("error", unit), units.conversion("position", of_places)
    assert of_readings is not None and places is not None  # both roles have units
    part = 1e-3 if of_readings.unit == "um" else 180e-6 / np.pi  # mm or deg, the units of positions
    return values * (of_readings.factor * part / places.factor)


def _within_half_a_turn(p: Proposal, command: str, actual: str) -> None:
    """Shift by one turn the actual positions of a rotary axis that passed 360 = 0 before or after the command."""
    if not components.is_rotary(p.entries[actual]["axis"]) or {p.entries[n].get("unit") for n in (command, actual)} != {
        "deg"
    }:
        return
    if command not in p.data or actual not in p.data:
        return
    turns = np.round((p.data[actual] - p.data[command]) / 360.0)
    passed = np.abs(np.nan_to_num(turns)) == 1
    if 0 < passed.mean() <= 0.5:
        p.data[actual] = np.where(passed, p.data[actual] - 360.0 * turns, p.data[actual])
        why = f"{p.guesses.get(actual, '')}; {int(passed.sum())} of them a turn off, as 360 = 0"
        p.guesses[actual] = why.strip("; ")


def derive_error(p: Proposal, axis: str, options: ImportOptions, plane: bool) -> None:
    """error = actual - commanded, if both are recorded and no error column is.

    plane: whether a grid encoder read them: of the tool point where two axes move together.
    """
    if any(e["role"] == "error" for e in p.entries.values()):
        return
    for name, keys in options.sets.items():  # also for a column created from a wide layout: `actual_Y`
        if slug(name) in p.entries and keys.get("role") in ("command", "actual", "position"):
            p.entries[slug(name)]["role"] = keys["role"]
    letters = list(dict.fromkeys([axis, *(e["axis"] for e in p.entries.values() if e.get("axis"))]))
    moving = [a for a in letters if (c := p.first("command", a)) in p.data and np.ptp(p.data[c]) > 0]
    if options.axis is not None:
        letters = [options.axis]
    elif len(moving) == 1:  # the others are constant: `Nominal Y` of a tracker along X
        letters = [a for a in letters if a in moving or p.first("command", a) not in p.data]
    elif len(moving) > 1 and plane and options.component is None:
        p.facts["protocol"] = "point_cloud"
        p.notes.append(f"a grid encoder read {', '.join(moving)} at once: deviations of the tool point, for `identify`")
    elif len(moving) > 1 and p.rows < order.DENSE_ROWS:
        raise DataError(
            f"axes {', '.join(moving)} move together, and there are no deviations: a cloud of points is a recording "
            f"for `identify` (docs/recordings.md); --axis {moving[0]} imports only that axis"
        )
    for letter in letters:
        command = p.first("command", letter)
        actual = p.first("actual", letter) or (p.first("position", letter) if command else None)
        command = command or (p.first("position", letter) if actual else None)
        if command is None or actual is None or command == actual:
            continue
        if p.entries[command]["role"] == "position":
            p.entries[command]["role"] = "command"
        order.refuse_swapped(p, command, actual)
        stated = {keys.get("role") for keys in options.sets.values()}
        if options.sign == "commanded-minus-actual" and not {"command", "actual"} & stated:
            raise DataError(
                f"the error is {actual!r} minus {command!r}, both of which are recorded: --sign would be ignored. If "
                f"the machine read {actual!r} on a gauge or part of known size, use --set {actual}.role=command "
                f"--set {command}.role=actual instead"
            )
        _within_half_a_turn(p, command, actual)
        component = options.component or (f"E_{letter}" if p.facts.get("protocol") else components.positioning(letter))
        if options.component is None and all(guessing.other_component(n, letter) == "E_D" for n in (command, actual)):
            component = "E_D"  # nominal and measured diameter at places along the axis
        unit = components.unit(component)
        minus = {"minus": [actual, command]}
        name = p.put(component, None, role="error", component=component, unit=unit, derived=minus)
        p.guesses[name] = f"error = {actual} - {command} (actual minus commanded)"
