"""Relations between the columns of a proposed recording: actual and commanded, sign, direction, runs, log.

Deviation is actual minus commanded. If a file contains both positions, the error is derived from them when the
recording is read (`derived: {minus: [actual, commanded]}`); if it contains deviations of the opposite sign, the sign is
changed there, and the manifest states it.
"""

from __future__ import annotations

import re

import numpy as np

from errpipe.domain import components
from errpipe.errors import DataError
from errpipe.importing import ambiguities, dates, order, other_tests, readings, signs, simulated, speeds
from errpipe.importing import columns as guessing
from errpipe.importing.layout import EMPTY, Layout, RawColumn
from errpipe.importing.proposed import ImportOptions, Proposal, slug
from errpipe.importing.units import PER_LENGTH, plain_unit
from errpipe.importing.unstated import PLACES, refuse_a_scale, resolve_units
from errpipe.importing.words import axis_above

MOST_NAMED = 6  # columns in a message, those with a role first
NO_DEVIATION = "no column holds a deviation"


def resolve_positions(p: Proposal, axis: str, options: ImportOptions) -> None:
    """Roles of positions: next to a command the other one is actual; a single target is the position."""
    ignore_target_numbers(p)
    one_position_per_axis(p)
    deviations_as_errors(p, options)
    axes = {e["axis"] for e in p.entries.values() if e["role"] in ("command", "position", "actual")}
    errors = [e for e in p.entries.values() if e["role"] == "error"]
    for letter in sorted(axes):
        command, place, actual = (p.first(role, letter) for role in ("command", "position", "actual"))
        if command is None and place is not None and actual is not None:
            p.entries[place]["role"], command, place = "command", place, None  # a nominal position next to a reading
        if command is not None and place is None and actual is not None and not errors:
            p.entries[actual]["role"] = "position"
        elif place is None and (alone := command or actual) is not None and None in (command, actual):
            p.entries[alone]["role"] = "position"


# For an angle; otherwise a length (inch: both are written as "), a time, or a slope. A level reads um per m.
_OF_AN_ANGLE = {"inch": "arcsec", "s": "arcsec", "min": "arcmin", "um/m": "urad", "mm/m": "mrad"}

_BESIDE_AN_ANGLE = {"inch": '"', "min": "'"}  # how the unit of a length, or of a time, was written


def unit_of_readings(values: np.ndarray, unit: str | None, component: str, why: str) -> tuple[np.ndarray, str, str]:
    """Readings in a unit of the manifest, that unit, and the reason; lengths without a unit by their size.

    Raises DataError for angles without a unit: arcsec taken as urad would be compensated by only a fifth.
    """
    standard = components.unit(component)
    if standard == "urad" and unit in _OF_AN_ANGLE:
        why = why.replace("unit (inch)", 'unit (")')  # as it was read before the angle was known
        why += f"; {_BESIDE_AN_ANGLE.get(unit, unit)} for an angle is {_OF_AN_ANGLE[unit]}"
        unit = _OF_AN_ANGLE[unit]
    if standard == "um" and unit in PER_LENGTH:
        raise DataError(
            f"readings of {component} in {unit}, per length: errpipe needs them in um (or mm) at each position, and of "
            "a level declare what it measured with --component, such as EBX"
        )
    if standard == "um" and unit in (*guessing.SMALL_ANGLES, "s", "min"):
        raise DataError(
            f"readings in {unit} are angles, not {component}: for a rotary axis, --axis C (or A, B); else declare what "
            f"rotated with --component, such as {_turns(component)}"
        )
    values, unit, why = plain_unit(values, unit, why)
    if standard == "urad" and unit in ("um", "mm", "nm"):
        raise DataError(
            f"readings in {unit} are not {component}, which is an angle: declare what was displaced with --set "
            "COLUMN.component=E_X (E_R: along a bar) of each column, and --set COLUMN.role=ignore of the others"
        )
    if unit is None and standard == "urad":
        raise DataError(
            f"no unit is stated for the angles of {component}: declare it with --unit (arcsec, urad, mrad, mdeg, deg)"
        )
    if unit is None and standard in ("N", "N m"):
        raise DataError(
            f"no unit is stated for {component}, and drives also log torques in % or in A: declare it with --set "
            f"COLUMN.unit={standard!r} (or kN, N mm), after a conversion if it is neither"
        )
    if unit is None:
        unit = unit_by_size(values)
        why += f"; no unit is stated, taken as {unit} by the size of the readings (to change it: --unit)"
    return values, unit, why


def _turns(component: str) -> str:
    """`EBX (pitch), ECX (yaw) or EAX (roll) of X` for the axis of a component."""
    axis = (components.parse(component).axis or "X")[0]
    about = guessing.ANGLES.get(axis, {}) | ({"pitch": "A", "yaw": "B"} if axis == "Z" else {})
    pitch, yaw, roll = (f"E{about.get(name, 'B')}{axis} ({name})" for name in ("pitch", "yaw", "roll"))
    return f"{pitch}, {yaw} or {roll} of {axis}"


def stated_unit(options: ImportOptions, written: str | None, header: str) -> str | None:
    """The unit of readings stated by the user, else the written one. Raises DataError if the two differ."""
    if options.unit is None or written in (None, options.unit) or _OF_AN_ANGLE.get(written) == options.unit:
        return options.unit or written
    raise DataError(
        f"column {header!r} is in {written}, but --unit states {options.unit}: if the file is wrong, use "
        f"--set '{header}.unit={options.unit}'"
    )


SMALLEST = 0.1  # um: no axis error is smaller
LARGEST = 5.0  # mm: no axis that is to be compensated has a larger error
OF_MM = (3, 4)  # decimals that dials and lasers display in mm; computed values have more


def unit_by_size(values: np.ndarray) -> str:
    """um or mm, if only one of them is plausible: 0.1 um is not an axis error, nor is 5 mm.

    Raises DataError if both are plausible, and for whole and half numbers, which may be steps of a gauge.
    """
    size = np.abs(values[np.isfinite(values)])
    most = float(size.max()) if size.size else 0.0
    if most < SMALLEST:
        return "mm"
    decimals = max(len(f"{v:.9f}".rstrip("0").partition(".")[2]) for v in size.tolist())
    steps = np.diff(np.unique(size))
    in_steps = np.array_equal(2.0 * size, np.round(2.0 * size)) and steps.size and steps.min() <= 1.0
    if most >= 1.0 and (in_steps or np.array_equal(size, np.round(size))):
        raise DataError(
            f"the readings are whole numbers, or halves, up to {most:g} and no unit is stated: um, or the steps of a "
            "gauge? Declare it with --unit (um, '0.1 um', '0.01 mm', thou, ...)"
        )
    if most <= LARGEST:
        likely = {1: "um is likely, by their decimal", **dict.fromkeys(OF_MM, "mm is likely, by their decimals")}.get(
            decimals, "both are equally likely"
        )
        raise DataError(
            f"readings reach {most:.3g} without a stated unit: um or mm ({likely})? Declare it with --unit mm (or um)"
        )
    return "um"


_EXTERNAL_INSTRUMENT = re.compile(r"laser|interferom|dial|indicator|messuhr", re.IGNORECASE)
_MEASURED = re.compile(rf"{_EXTERNAL_INSTRUMENT.pattern}|meas|mess|gauge|probe|taster|reading|mesur|misur|medid", re.I)
_OWN_SCALE = re.compile(r"encoder|(?<![a-z])enc(?![a-z])|display|read_?out|(?<![a-z])dro(?![a-z])|scale", re.IGNORECASE)


def one_position_per_axis(p: Proposal) -> None:
    """One commanded and one actual position per axis; of two actual ones that of the laser or dial is the measured one.

    Raises DataError if two of a kind differ and nothing states which is meant.
    """
    for role in ("command", "actual", "position"):
        for letter in sorted({e["axis"] for e in p.entries.values() if e["role"] == role}):
            names = [n for n, e in p.entries.items() if e["role"] == role and e["axis"] == letter and n in p.data]
            measured = [n for n in names if _EXTERNAL_INSTRUMENT.search(n)]
            if len(names) < 2:
                continue
            own = [n for n in names if _OWN_SCALE.search(n) and n not in measured]
            other = next((n for n in names if n not in own and _MEASURED.search(n)), None)
            commanded = p.first("command", letter) is not None or p.first("position", letter) is not None
            if role == "actual" and len(own) == 1 and len(names) == 2 and other and not commanded:
                p.entries[own[0]]["role"] = "command"
                p.guesses[own[0]] = "the machine's own reading next to a measured one: used as the command"
                continue
            beside = role == "actual" and len(measured) == 1
            kept, kind = measured[0] if beside else names[0], f"{role} ".removeprefix("position ")
            for name in [n for n in names if n != kept]:
                if not beside and not np.array_equal(p.data[name], p.data[kept], equal_nan=True):
                    raise DataError(
                        f"columns {kept!r} and {name!r} both contain {kind}positions of {letter}: select one "
                        f"with --set {name}.role=ignore (or command, actual)"
                    )
                p.entries[name] = {"role": "ignore"}
                p.guesses[name] = f"not used: {kept} is the {role} position"


def deviations_as_errors(p: Proposal, options: ImportOptions) -> None:
    """Readings that do not rise with the command are deviations: a dial that is zeroed at every target.

    Raises DataError if readings without a unit are neither positions nor deviations in mm.
    """
    if any(e["role"] == "error" for e in p.entries.values()):
        return
    for name in [n for n, e in p.entries.items() if e["role"] == "actual" and n in p.data]:
        entry = p.entries[name]
        command = p.first("command", entry["axis"]) or p.first("position", entry["axis"])
        if command not in p.data or entry.get("unit") not in ("mm", "um", "inch"):
            continue
        component, why = components.positioning(entry["axis"]), p.guesses.get(name, "")
        guessed = "no unit is stated" in why
        if guessed and options.unit is not None:
            p.data[name], entry["unit"], guessed = *plain_unit(p.data[name], options.unit, "")[:2], False
            why = f"{why.split('; no unit')[0]}; unit by --unit"
        slope = readings.slope_of(p.canonical(command), p.canonical(name))
        steep = slope is not None and abs(slope) > readings.ABSOLUTE
        if guessed and slope is not None and steep and abs(abs(slope) - 1.0) > readings.ABSOLUTE:
            raise DataError(
                f"{name!r} changes by {slope:.3g} for each mm of {command!r} and has "
                "no unit: declare it with --unit (um, '0.1 um', '0.01 mm', thou, ...), or counts with --resolution"
            )
        if slope is None or steep or not np.ptp(p.data[name]):
            continue
        unit = unit_by_size(p.data[name]) if guessed else entry["unit"]
        p.data[name], unit, _ = plain_unit(p.data[name], unit, "")
        p.entries[name] = {"role": "error", "component": component, "unit": unit, "_axis": entry["axis"]}
        p.guesses[name] = f"{why}; it does not rise with {command}: deviations in {unit}".strip("; ")


def ignore_target_numbers(p: Proposal) -> None:
    """If an axis has another command or position, ignore a column that counts 1, 2, 3: the numbers of the targets."""
    places = ("command", "position")
    for name, entry in p.entries.items():
        others = [e for n, e in p.entries.items() if n != name and e["role"] in places and entry["role"] in places]
        if not any(e["axis"] == entry["axis"] for e in others):
            continue
        values = np.unique(p.data[name])
        if values.size > 2 and np.array_equal(values, np.arange(1, values.size + 1)):
            p.entries[name] = {"role": "ignore"}
            p.guesses[name] = "it counts 1, 2, 3, ... next to another position: the numbers of the targets"


def finish(p: Proposal, layout: Layout, axis: str, options: ImportOptions) -> None:
    """The error of the axis, its sign, directions, runs, and the derived columns of a log of an axis."""
    of_errors = [e.get("_headers", ()) for e in p.entries.values() if e["role"] == "error"]
    if p.side is None and len(of_errors) == 1 and len(of_errors[0]) == 1:
        p.side = guessing.side_in(of_errors[0][0])
    readings.continue_counts(p, options.resolution)
    readings.change_sign_of_readings(p)
    signs.ignore_corrections(p)
    signs.convert_errors(p, layout, options)
    readings.readings_as_errors(p, axis)
    readings.derive_error(p, axis, options, other_tests.names_a_grid_encoder(layout.above))
    speeds.units_by_positions(p)
    simulated.forces_as_responses(p)
    simulated.of_the_only_response(p)
    simulated.change_signs(p, simulated.positions_as_deviations(p))
    refuse_a_scale(p, layout.above)
    if not any(e["role"] == "error" for e in p.entries.values()):
        known = sorted(p.entries, key=lambda n: p.entries[n]["role"] == "ignore")
        have = ", ".join(_column_with_role(p, n) for n in known[:MOST_NAMED])
        have += f", and {len(p.entries) - MOST_NAMED} more" if len(p.entries) > MOST_NAMED else ""
        raise DataError(
            f"{NO_DEVIATION}, and no two contain an actual and a commanded position (found: {have}). "
            "Declare it with --set COLUMN.role=error, or --set COLUMN.role=actual"
            + simulated.as_a_load(p, axis)
            + "".join(f"; {note}" for note in layout.notes if "--names" in note or note.startswith(EMPTY))
        )
    ambiguities.refuse(p, layout, options)
    _refuse_one_of_several_axes(p, layout, options)
    resolve_units(p, layout)
    stated_names = {header for name in options.sets for header in (name, slug(name))}
    unknown = [c for c in layout.columns if not {c.header, slug(c.header)} & stated_names and _may_be_a_place(p, c)]
    ambiguities.refuse_without_position(p, bool(unknown))
    for name, entry in p.entries.items():
        letter, _ = entry.pop("_axis", None), entry.pop("_headers", None)
        ambiguities.refuse_second_probe(p, name, letter, options)
        alone = letter is not None and p.first("position", letter) is None and p.first("command", letter) is None
        if alone and unknown and letter in "XYZUVW" and components.parse(entry["component"]).axis == letter:
            header = unknown[0].header
            raise DataError(
                f"column {header!r} ({unknown[0].unit}) is unknown, and no position is recorded: use "
                f"--set '{header}.role=position', or --set '{header}.role=ignore'"
            )
        if alone and entry["component"] == components.positioning(letter) and letter in "XYZUVW":
            if p.assumed_axis:
                raise DataError(
                    f"no axis is named and no position recorded: along which axis is {name!r}? Declare it with --axis"
                )
            _refuse_other_axis(p, name, letter, options)
            dates.refuse_unread(p.entries, p.guesses, p.data)
            entry["component"] = f"E_{letter}"  # a drift of the tool point: no position is recorded
            p.guesses[name] = (
                f"{p.guesses.get(name, '')}; E_{letter}, because no position of {letter} is recorded".strip("; ")
            )
    if p.facts.get("protocol") is None:
        order.resolve_order(p, axis)
    p.entries = dict(sorted(p.entries.items(), key=lambda item: item[1]["role"] not in ("run", "time")))


def _refuse_one_of_several_axes(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Raise DataError if several axes move and neither a column of deviations nor a line above names one."""
    moving = {
        e["axis"]
        for n, e in p.entries.items()
        if e["role"] in ("command", "position") and e.get("unit") != "deg" and n in p.data and np.ptp(p.data[n]) > 0
    }
    if len(moving) < 2 or options.axis is not None or axis_above(layout.above) is not None:
        return
    along = [n for n, e in p.entries.items() if e["role"] == "error" and "from the axis" in p.guesses.get(n, "")]
    if len({p.entries[n]["component"] for n in along}) > 1:
        first, own = along[0], p.entries[along[0]]["component"]
        raise DataError(
            f"axes {', '.join(sorted(moving))} move in the same rows, and {', '.join(along)} are read: deviations of "
            f"the tool point (R-test, cloud of points), with --set {first}.component=E_{own[1]} and so on, or the "
            f"positioning of each axis, with --set {first}.component={own} and so on?"
        )
    for name, entry in p.entries.items():
        headers = entry.get("_headers", ())
        if "from the axis" in p.guesses.get(name, "") and not any(map(guessing.axis_in, headers)):
            raise DataError(
                f"axes {', '.join(sorted(moving))} move, and {headers[0]!r} names none of them: deviations of which? "
                f"Declare it with --axis {min(moving)}, or --component (E_R: along a beam or bar)"
            )


def _refuse_other_axis(p: Proposal, name: str, letter: str, options: ImportOptions) -> None:
    """Raise DataError if readings of one axis, without its position, are next to moving positions of another."""
    moving = [n for n, e in p.entries.items() if e["role"] in PLACES and n in p.data and np.ptp(p.data[n]) > 0]
    if not moving or options.component is not None:
        return
    other = p.entries[moving[0]]["axis"]
    raise DataError(
        f"{name!r} names {letter}, but {moving[0]!r} has positions of {other}: declare what was measured with --set "
        f"{name}.component=E{letter}{other} (straightness), E{other}{other} (positioning) or E_{letter} (tool point)"
    )


def _column_with_role(p: Proposal, name: str) -> str:
    """A column with its role; an ignored one with the reason if it has numbers or a known name."""
    role, why = p.entries[name]["role"], p.guesses.get(name, "")
    header = next((h for h, n in p.names.items() if n == name), name) if name.startswith(role) else name
    return f"{header} ({role}: {why})" if role == "ignore" and why and why != guessing.UNKNOWN else f"{header} ({role})"


def _may_be_a_place(p: Proposal, c: RawColumn) -> bool:
    """Whether an unused column has a unit of length and many values."""
    left_out = p.entries.get(p.names.get(c.header, ""), {}).get("role") == "ignore"
    many = np.unique(c.values[np.isfinite(c.values)]).size > 3
    return left_out and many and c.unit in ("mm", "m", "inch", "um", "deg", "rad")
