"""From guesses to a proposed recording: ordered rows, a manifest, and a description of every guess.

Everything computed here is documented in the manifest or in a note.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from errpipe.domain import components
from errpipe.domain.recording import ROLE_UNITS
from errpipe.errors import DataError, UsageError, did_you_mean
from errpipe.importing import (
    ambiguities,
    circle,
    dates,
    kept_rows,
    no_reading,
    order,
    owners,
    quality,
    readings,
    resolve,
    rows_of,
    signs,
    simulated,
    speeds,
    wide,
)
from errpipe.importing import columns as guessing
from errpipe.importing.header import facts
from errpipe.importing.layout import Layout, NoReadingError, RawColumn
from errpipe.importing.proposed import AXIS_ASSUMED, ImportOptions, Proposal, slug
from errpipe.importing.sheet import label
from errpipe.importing.temperatures import with_temperatures
from errpipe.importing.units import PER_LENGTH, in_brackets, in_role, per_length, plain_unit, unit_of
from errpipe.importing.units_above import unit_above
from errpipe.importing.unstated import refuse_enlarged
from errpipe.importing.words import THERE_AND_BACK, axis_above, plain

# Possible unknown units: `um/m`, `pm`, `x 0.05um`, `0.0001`.
_OTHER_UNIT = re.compile(r"[^\d\s]{1,3}/[^\d\s]{1,3}|[^\W\d_]{1,14}|%|°|[x×*]?\s?\d.*[^\W\d_]|0?[.,]0*\d")
OF_A_COUNT = ", times --resolution"
_NO_UNIT = ("64 bit", "32 bit", "x", "y", "z", "abs", "rel", "raw", "avg", "mean", "inc", "meas", "all")


def propose(layout: Layout, options: ImportOptions, may_be_log: bool = False) -> Proposal:
    """A recording with the probable role of each column. Raises DataError if it contains nothing measured.

    may_be_log: whether a file may have no deviation, only the simultaneous log of another device.
    """
    headers = {c.header for c in layout.columns}
    for c in layout.columns:
        unit = (options.sets.get(c.header) or options.sets.get(slug(c.header)) or {}).get("unit", c.unit)
        c.unit = unit_of(unit or "") or unit
    no_reading.blank(layout)
    quality.blank(layout)
    quality.apply_unit_columns(layout)
    speeds.read_switches(layout)
    if (of_a_ball_bar := circle.proposal(layout, options)) is not None:
        return of_a_ball_bar
    layout = wide.unpivoted(rows_of.one_machine(rows_of.one_axis(layout, options), options))
    layout.columns = [part for c in dates.date_and_clock(layout.columns) for part in wide.split_labels(c)]
    if not layout.columns:
        raise DataError("no column has a value")
    guesses = {c.header: _stated(c, options) or guessing.guess(c) for c in layout.columns}
    layout, guesses = rows_of.of_one_axis(layout, owners.of_axes(layout.columns, guesses, options.axis), options)
    in_columns = wide.find(layout, guesses) is not None
    guesses = ambiguities.machine_positions(layout, guesses, options, in_columns)
    guesses = guessing.with_position_column(layout.columns, guessing.with_one_clock(guesses), options.axis)
    layout = kept_rows.in_order_of_time(layout, guesses)
    guesses, unsure = with_temperatures(layout.columns, guesses)
    layout = kept_rows.with_last_sensors(layout, guesses)
    unsure += readings.unit_by_positions(layout.columns, guesses) if options.unit is None else []
    ambiguities.refuse_diameters(layout, guesses, options)
    layout = wide.side_by_side(wide.merged_targets(layout, guesses), guesses)
    proposal = Proposal(notes=[*layout.notes, *unsure], headers=headers)
    options = ambiguities.component_above(layout, guesses, options, proposal)
    proposal.facts.update(facts(layout.above))
    proposal.side = guessing.side_above(layout.above)
    proposal.notes += signs.compensated(layout.above)
    proposal.notes += _axis_of_a_line(layout.above, options.axis)
    wide_layout = wide.find(layout, guesses)
    guesses = guesses if wide_layout else _of_stated_axis(layout, guesses, options.axis)  # `V1`, `R1` are runs
    axis = options.axis or _axis(layout, guesses, wide_layout, options.component)
    if axis is None:
        angles = [c for c in layout.columns if c.unit in ("deg", "rad") and guesses[c.header].kind in resolve.PLACES]
        if angles and any(guessing.is_radius(c.header) for c in layout.columns):
            raise DataError(
                f"column {angles[0].header!r} has angles of a circle: errpipe needs the commanded position of each "
                "reading, one column per axis (X = centre_X + radius * cos(angle), ...)"
            )
        if angles:
            raise DataError(f"column {angles[0].header!r} has angles, and no axis is named: declare it with --axis C")
        axis, proposal.assumed_axis = "X", True
        proposal.notes.append(AXIS_ASSUMED)
    if wide_layout is not None:
        _wide(layout, guesses, wide_layout, axis, options, proposal)
    else:
        _long(layout, guesses, axis, options, proposal, may_be_log)
    ambiguities.refuse_another_title(proposal, layout, options)
    if options.resolution is not None and not any(OF_A_COUNT in why for why in proposal.guesses.values()):
        raise UsageError("--resolution would be ignored: no column contains counts, or whole numbers without a unit")
    return proposal


def _axis_of_a_line(above: Sequence[str], declared: str | None) -> list[str]:
    """A note where a line above the table names the axis, and another one or none is declared."""
    line = next((text for text in above if axis_above([text])), None)
    axis = axis_above([line]) if line is not None else None
    if line is None or declared == axis:
        return []
    if declared is None:
        return [f"the axis is {axis}, from {line[:60]!r} (to change it: --axis)"]
    return [f"the axis is {declared}, by --axis; {line[:60]!r} states {axis}"]


def _stated(column: RawColumn, options: ImportOptions) -> guessing.ColumnGuess | None:
    """A column's guess from `--set COLUMN.role=...` and `--set COLUMN.axis=...`, or None."""
    stated = options.sets.get(column.header) or options.sets.get(slug(column.header)) or {}
    role, axis = stated.get("role"), stated.get("axis")
    if role is None:
        return replace(guessing.guess(column), axis=axis) if axis else None
    known = (*ROLE_UNITS, "counts")
    if role not in known:
        allowed = f"(allowed: {', '.join(known)})"
        raise UsageError(f"--set {column.header}.role: no role {role!r} {allowed}.{did_you_mean(role, known)}")
    return guessing.ColumnGuess(role, axis or guessing.axis_in(column.header), "")


def _of_stated_axis(layout: Layout, guesses: guessing.Guesses, axis: str | None) -> guessing.Guesses:
    """The guesses with the axis from --axis, even if a line above names another axis: `U1-1` is then a channel.

    Raises DataError if all columns of an axis name another one and no line above does: the option would be ignored.
    """
    named = {h: g for h, g in guesses.items() if g.axis is not None and g.kind in (*guessing.PLACE, "error")}
    letters = {str(g.axis)[0] for g in named.values()}
    if axis is None or len(letters) != 1 or axis[0] in letters:
        return guesses
    if axis_above(layout.above) == axis:
        return guesses | {h: replace(g, axis=None) for h, g in named.items()}
    corrected = " ".join(f"--set '{header}.axis={axis}'" for header in named)
    raise DataError(
        f"--axis {axis}: column {next(iter(named))!r} names the axis {letters.pop()}. Omit --axis, or, if the "
        f"file is wrong, correct each column: {corrected}"
    )


def _axis(layout: Layout, guesses: guessing.Guesses, unfolded: wide.Wide | None, component: str | None) -> str | None:
    motion = ("command", "position", "actual", "counts", "error")
    runs = {c.header for c in [*unfolded.statistics, *(r for r, _, _ in unfolded.readings)]} if unfolded else set()
    named = [
        g.axis
        for header, g in guesses.items()
        if g.axis is not None and g.kind in motion and header not in runs and not guessing.is_straightness(header)
        if unfolded is None or header == unfolded.target.header or not wide.is_figure(header)
    ]
    above = axis_above(layout.above)
    if component is not None and component[-1] in named:  # --component E_Z: the column of Z is meant
        return component[-1]
    if named and above is not None and above not in named:
        raise DataError(
            f"a line above the table, its sheet or file names the axis {above}, a column {named[0]}: declare it "
            f"with --axis {named[0]} (or {above})"
        )
    return above or (named[0] if named else None)


def _long(
    layout: Layout, guesses: guessing.Guesses, axis: str, options: ImportOptions, p: Proposal, may_be_log: bool
) -> None:
    """One row of the file becomes one row of the recording."""
    keep = kept_rows.readings(layout, guesses, p)
    if not keep.any():
        raise NoReadingError("no row contains a reading")
    parts = [c.take(np.flatnonzero(keep)) for c in layout.columns]
    of_errors = [c for c in parts if guesses[c.header].kind == "error"]
    if len(of_errors) == 1 and of_errors[0].unit is None:
        of_errors[0].unit = unit_above(layout.above, of_errors[0].values)
    for column in [c for c in parts if any(cell not in (None, "") for cell in c.cells)]:
        invalid = [c for c, v in zip(column.cells, column.values, strict=True) if c not in (None, "") and np.isnan(v)]
        if invalid and column.numeric:
            p.notes.append(
                f"{len(invalid)} cells of {column.header!r} are not numbers (the first: {invalid[0]!r}): missing"
            )
        add_column(column, guesses[column.header], axis, options, p)
    if may_be_log and not {e["role"] for e in p.entries.values()} & {"error", *resolve.PLACES}:
        resolve.resolve_units(p, layout)
        return
    for name, e in p.entries.items():
        if e.get("unit", "") not in ("", *(allowed := ROLE_UNITS[e["role"]])):
            says = f"column {name!r}: {e['unit']!r} is no unit of role {e['role']} (allowed: {', '.join(allowed)})"
            raise DataError(f"{says}: say --set '{name}.unit=...', or --set '{name}.role=ignore'")
    resolve.resolve_positions(p, axis, options)
    resolve.finish(p, layout, axis, options)


def _wide(
    layout: Layout, guesses: guessing.Guesses, table: wide.Wide, axis: str, options: ImportOptions, p: Proposal
) -> None:
    """A row per target becomes one row per reading."""
    index, run, sides, values = wide.unpivot(table)
    unit, of_target = table.target.unit, "the column of targets"
    if unit is None:
        unit = "deg" if components.is_rotary(axis) else "mm"
        of_target += f"; no unit is stated, taken as {unit}"
    columns, targets = len(table.readings), len(np.unique(table.target.values[index]))
    p.notes.append(f"wide layout: {columns} columns of readings, {len(set(run))} runs, {targets} targets")
    of_headers = {*run} <= {of_column for _, of_column, _ in table.readings}
    why = "from the headers of the columns" if of_headers else "a new run each time the targets start again"
    p.put("run", run, why if table.run is None else f"from the column {table.run.header!r}", role="run")
    p.put(table.target.header, table.target.values[index], of_target, role="position", axis=axis, unit=unit)
    if np.isfinite(sides).all():
        why = "from the headers of the columns" if table.way is None else f"from the column {table.way.header!r}"
        p.put("direction", sides, why, role="direction", axis=axis)
    _wide_readings(layout, table, values, axis, options, p)
    for c in layout.columns:
        if any(c is other for other in (table.target, table.run, table.way, *(r for r, _, _ in table.readings))):
            continue
        if any(c is s for s in table.statistics):
            p.notes.append(f"column {c.header!r} was excluded: a statistic over the runs, not a reading")
            continue
        g = guesses[c.header]
        if g.kind in ("temperature", "pressure", "humidity", "feed", "spindle_speed"):
            add_column(c.take(index), g, axis, options, p)
        else:
            p.notes.append(f"column {c.header!r} was excluded: {g.why}")
    resolve.finish(p, layout, axis, options)


def _wide_readings(
    layout: Layout, table: wide.Wide, values: np.ndarray, axis: str, options: ImportOptions, p: Proposal
) -> None:
    component = options.component or components.positioning(axis)
    headers = tuple(c.header for c, _, _ in table.readings)
    stated = [c.unit for c, _, _ in table.readings if c.unit is not None]
    for header in headers:
        refuse_enlarged(header, options)
    if len(set(stated)) > 1:
        raise DataError(f"the columns of the runs have several units ({', '.join(sorted(set(stated)))})")
    unit = resolve.stated_unit(options, stated[0] if stated else unit_above(layout.above, values), headers[0])
    why = f"the columns of the runs; component {component} from the axis" if options.component is None else ""
    values, unit, why = resolve.unit_of_readings(values, unit, component, why)
    why = why.strip("; ")
    p.put(component, values, why, role="error", component=component, unit=unit, _axis=axis, _headers=headers)


def add_column(c: RawColumn, g: guessing.ColumnGuess, axis: str, options: ImportOptions, p: Proposal) -> None:
    """Add one column of the file with its guessed role."""
    stated = options.sets.get(c.header) or options.sets.get(slug(c.header)) or {}
    unit, own = c.unit, stated.get("axis") or g.axis or axis
    why = "" if stated.get("role") else f"{g.kind} by {g.why}"
    if g.kind == "time":
        _time(c, unit, why, p)
    elif g.kind == "direction" and np.isnan(guessing.sides(c)[[x not in (None, "") for x in c.cells]]).any():
        p.put(c.header, [label(x) for x in c.cells], guessing.NO_SIDES, role="ignore")
    elif g.kind == "direction":
        if all(THERE_AND_BACK.fullmatch(plain(x).strip(".:()")) for x in c.cells if x not in (None, "")):
            why += order.THERE_AND_BACK
        p.put(c.header, guessing.sides(_filled_down(c, p)), why, role="direction", axis=own)
    elif g.kind in ("run", "group"):
        of = stated.get("of") or (guessing.group_of(c.header) if g.kind == "group" else None)
        p.put(c.header, [label(x) for x in _filled_down(c, p).cells], why, role=g.kind, of=of)
    elif g.kind in ("command", "position", "actual"):
        usual = "deg" if components.is_rotary(own) else "mm"
        whole = unit is None and np.array_equal(c.values, np.round(c.values), equal_nan=True)
        factor = options.resolution if whole else None
        counts = usual, f"{why}; whole numbers: counts{OF_A_COUNT}"
        unit, why = counts if factor else _unit_or(_known_unit(c, unit), usual, why)
        values, unit, why = plain_unit(c.values * (factor or 1.0), unit, why, ROLE_UNITS[g.kind])
        p.put(c.header, values, why, role=g.kind, axis=own, unit=unit)
    elif g.kind == "counts":
        _counts(c, own, why, options, p)
    elif g.kind in ("error", "simulated"):
        component = stated.get("component") or options.component or guessing.component_in(c.header)
        component = component or (simulated.component_of_force(c.header, unit, own) if g.kind == "simulated" else None)
        refuse_enlarged(c.header, options)
        _response(c, g.kind, own, resolve.stated_unit(options, unit, c.header), why, component, axis, p)
    elif g.kind == "current":
        unit, why = _unit_or(unit, "A", why)
        name = p.put(c.header, c.values, why, role="current", axis=own, unit=unit)
        if options.torque_constant is not None:
            amps = options.torque_constant * (1e-3 if unit == "mA" else 1.0)
            p.put(f"torque_{own}", None, role="torque", axis=own, unit="N m", derived={"of": name, "factor": amps})
    elif g.kind in ROLE_UNITS and g.kind != "ignore":
        values = c.values
        if ROLE_UNITS[g.kind]:
            taken = in_role(c.values, c.header, c.unit, g.kind, why)
            if taken is None:
                unknown, allowed = c.unit or in_brackets(c.header), ", ".join(ROLE_UNITS[g.kind])
                if stated.get("unit"):
                    raise UsageError(f"--set {c.header}.unit={unknown}: not of role {g.kind} (allowed: {allowed})")
                why = f"{why}, but {unknown!r} is not a unit of role {g.kind} (allowed: {allowed})"
                p.put(c.header, c.values, f"{why}: declare it with --set '{c.header}.unit=...'", role="ignore")
                return
            values, unit, why = taken
            turns = components.is_rotary(own) and g.kind in ("velocity", "acceleration")
            if g.kind != "coolant":  # without a unit it is on or off
                unit, why = _unit_or(unit, ROLE_UNITS[g.kind][1 if turns else 0], why)
        moving = g.kind in ("velocity", "acceleration", "force", "torque")
        place = stated.get("location") or (c.header if g.kind == "temperature" else None)
        p.put(c.header, values, why, role=g.kind, unit=unit, axis=own if moving else None, location=place)
    else:
        p.put(c.header, c.values if c.numeric else [label(x) for x in c.cells], g.why, role="ignore")


def _filled_down(c: RawColumn, p: Proposal) -> RawColumn:
    """The column with empty cells filled from above, if only the first row of each block is filled (merged cells)."""
    filled = np.array([cell not in (None, "") for cell in c.cells])
    if filled.all() or not filled[0] or filled.mean() > 0.5:
        return c
    at = np.maximum.accumulate(np.where(filled, np.arange(filled.size), 0))
    p.notes.append(f"empty cells of {c.header!r} take the value above them (merged cells)")
    return c.take(at)


def _known_unit(c: RawColumn, unit: str | None) -> str | None:
    """The unit of a column, or None. Raises DataError if its header has an unknown one in brackets."""
    match = re.search(r"[\[(]\s*([^\[\]()]{1,14}?)\s*[\])]", c.header)
    unknown_unit = match if unit is None and match and _OTHER_UNIT.fullmatch(match.group(1)) else None
    word = RawColumn(unknown_unit.group(1), None, c.cells, c.values) if unknown_unit else c
    sided = len(word.header) > 1 and guessing.side(word.header) is not None
    named = sided or word.header.lower() in _NO_UNIT
    if unit is None and per_length(c.header):
        raise DataError(f"column {c.header!r}: readings per length; errpipe needs them in um (or mm) at each position")
    if unknown_unit and not named and (len(word.header) == 1 or guessing.guess(word).kind == "ignore"):
        raise DataError(
            f"column {c.header!r}: {unknown_unit.group(1)!r} is not a known unit (um, mm, inch, thou, deg, urad, "
            f"arcsec, ...): declare it with --set '{c.header}.unit=...'"
        )
    return unit


def _unit_or(unit: str | None, usual: str, why: str) -> tuple[str, str]:
    if unit is not None:
        return unit, why
    return usual, f"{why}; no unit is stated, taken as {usual}".strip("; ")


def _time(c: RawColumn, unit: str | None, why: str, p: Proposal) -> None:
    stamps = dates.seconds(c)
    if p.first("time") is not None:
        p.put(c.header, [label(x) for x in c.cells], "a second clock", role="ignore")
    elif stamps is not None:
        since, epoch, form = stamps
        dates.refuse_clock_set_back(c, since)
        why += f"; dates written as s since the first row{dates.order_of(form)}"
        p.put("t", since, why, role="time", unit="s", epoch=epoch)
    elif c.numeric:
        values, unit, why, epoch = dates.numbered(c, unit, why)
        p.put(c.header, values, why, role="time", unit=unit, epoch=epoch)
    else:
        p.put(c.header, [label(x) for x in c.cells], dates.NOT_UNDERSTOOD, role="ignore")


def _counts(c: RawColumn, axis: str, why: str, options: ImportOptions, p: Proposal) -> None:
    if options.resolution is None:
        p.put(c.header, c.values, f"{why}; counts need --resolution (mm or deg of one count)", role="ignore")
        return
    name = p.put(c.header, c.values, why, role="ignore")
    unit = "deg" if components.is_rotary(axis) else "mm"
    p.guesses[name] = f"{why}{OF_A_COUNT}"
    derived = {"of": name, "factor": options.resolution}
    p.put(f"actual_{axis}", None, role="actual", axis=axis, unit=unit, derived=derived)


def _response(
    c: RawColumn, role: str, axis: str, unit: str | None, why: str, component: str | None, moved: str, p: Proposal
) -> None:
    """An error or simulated column; inches are converted, a missing unit is inferred from the size of the readings."""
    magnitude = re.search(r"^\|.*\||\b(abs(olute|olut\w*)?|magnitude|betrag)\b", c.header, re.IGNORECASE)
    if magnitude and not np.any(c.values < 0):
        raise DataError(f"column {c.header!r} may have magnitudes without sign (if not: rename it, or --set its role)")
    if component is None:
        of_a_screw = unit in ("um", "mm", "nm") and re.search(r"\bpitch\b", plain(c.header))
        component = None if of_a_screw else guessing.other_component(c.header, moved)
        why += f"; component {component} from the name and the axis {moved}" if component else ""
    if component is None:
        component = components.positioning(axis)
        why += f"; component {component} from the axis"
    if unit in PER_LENGTH and components.unit(component) == "um" and why.startswith("error by its unit"):
        why = f"{unit}: of a level, an angle: declare what it measured with --component, such as EBX"
        p.put(c.header, c.values, why, role="ignore")
        return
    values, unit, why = resolve.unit_of_readings(c.values, _known_unit(c, unit), component, why)
    p.put(c.header, values, why, role=role, component=component, unit=unit, _axis=axis, _headers=(c.header,))
