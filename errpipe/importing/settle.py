"""Relations between the columns of a proposed recording: actual and commanded, sign, direction, runs, a log.

Deviation is actual minus commanded. Where a file holds both positions, the error is derived from them at the door of
the recording (`derived: {minus: [actual, commanded]}`); where it holds deviations of the other sign, their sign is
reversed there, and the manifest states it.
"""

from __future__ import annotations

import numpy as np

from errpipe.domain import components, units
from errpipe.errors import DataError
from errpipe.importing import words
from errpipe.importing.layout import Layout
from errpipe.importing.proposed import ImportOptions, Proposal

DENSE_ROWS = 500  # rows: a log, not a test of targets
DENSE_PLACES = 100  # different commands: a log, not a test of targets
ABSOLUTE = 0.1  # of the position: a steeper "deviation" is a reading (no axis is wrong by 10 %)
SHOWN = 0.9  # correlation with actual - commanded: as `reversed-sign` of the plausibility checks


def settle_positions(p: Proposal, axis: str) -> None:
    """Roles of positions: beside a command the other one is actual; alone a target is the position."""
    leave_numbers(p)
    axes = {e["axis"] for e in p.entries.values() if e["role"] in ("command", "position", "actual")}
    errors = [e for e in p.entries.values() if e["role"] == "error"]
    for letter in sorted(axes):
        command, place, actual = (p.first(role, letter) for role in ("command", "position", "actual"))
        if command is None and place is not None and actual is not None:
            p.entries[place]["role"], command, place = "command", place, None  # a nominal position beside a reading
        if command is not None and place is None and actual is not None and not errors:
            p.entries[actual]["role"] = "position"
        elif command is not None and place is None and actual is None:
            p.entries[command]["role"] = "position"
        elif command is None and place is None and actual is not None:
            p.entries[actual]["role"] = "position"
        elif command is not None and place is not None and actual is not None:
            pass  # all three are recorded


def leave_numbers(p: Proposal) -> None:
    """Of two commands of an axis, one that counts 1, 2, 3 holds the numbers of the targets."""
    for name, entry in p.entries.items():
        others = [n for n, e in p.entries.items() if n != name and e["role"] == "command" == entry["role"]]
        if not any(p.entries[n]["axis"] == entry["axis"] for n in others):
            continue
        values = np.unique(p.data[name])
        if values.size > 2 and np.array_equal(values, np.arange(1, values.size + 1)):
            p.entries[name] = {"role": "ignore"}
            p.guesses[name] = "it counts 1, 2, 3, ... beside another command: the numbers of the targets"


def finish(p: Proposal, layout: Layout, axis: str, options: ImportOptions) -> None:
    """The error of the axis, its sign, directions, runs, and what a log of an axis needs besides."""
    turn_readings(p)
    leave_corrections(p)
    turn_signs(p, layout, options)
    readings_as_errors(p, axis)
    derive_error(p, axis, options)
    if not any(e["role"] == "error" for e in p.entries.values()):
        have = ", ".join(f"{n} ({e['role']})" for n, e in p.entries.items())
        raise DataError(
            f"no column holds a deviation, and no two hold an actual and a commanded position (found: {have}). "
            "Say it with --set COLUMN.role=error, or --set COLUMN.role=actual"
            + "".join(f"; {note}" for note in layout.notes if "--names" in note)
        )
    for name, entry in p.entries.items():
        letter, _ = entry.pop("_axis", None), entry.pop("_headers", None)
        alone = letter is not None and p.first("position", letter) is None and p.first("command", letter) is None
        if alone and entry["component"] == components.positioning(letter) and letter in "XYZUVW":
            entry["component"] = f"E_{letter}"  # a drift of the tool point: no position is recorded
            p.guesses[name] = f"{p.guesses.get(name, '')}; E_{letter}, for no position of {letter} is recorded".strip(
                "; "
            )
    dense = _is_log(p, axis)
    if dense:
        _log_of_an_axis(p, axis)
    else:
        _directions_and_runs(p, axis)
    p.entries = dict(sorted(p.entries.items(), key=lambda item: item[1]["role"] not in ("run", "time")))


def leave_corrections(p: Proposal) -> None:
    """A column of corrections beside one of deviations is left out."""
    errors = [n for n, e in p.entries.items() if e["role"] == "error"]
    corrections = [n for n in errors if any(map(words.is_correction, p.entries[n].get("_headers", (n,))))]
    for name in corrections if len(corrections) < len(errors) else []:
        p.entries[name] = {"role": "ignore"}
        p.guesses[name] = "corrections beside deviations: only the deviations are used"


def turn_signs(p: Proposal, layout: Layout, options: ImportOptions) -> None:
    """Every error column as actual minus commanded, by the options, the two positions or the file's header."""
    for name in [n for n, e in p.entries.items() if e["role"] == "error" and "derived" not in e]:
        headers = p.entries[name].get("_headers", (name,))
        texts = words.plain(
            " ".join([*headers, name, *(c.header for c in layout.columns), *layout.above, *layout.below])
        )
        reversed_ = words.COMMANDED_LESS_MEASURED.search(texts)
        straight = words.MEASURED_LESS_COMMANDED.search(texts)
        corrections = any(map(words.is_correction, headers)) or any(map(words.titles_corrections, layout.above))
        sign, reason = options.sign, ""
        shown = _sign_shown(p, name) if sign is None else None
        if shown is not None:
            turn, difference = shown
            sign = "commanded-minus-actual" if turn else "actual-minus-commanded"
            reason = f"it is minus {difference}: the sign is turned" if turn else f"its sign is that of {difference}"
        elif sign is None and corrections:
            sign, reason = "commanded-minus-actual", "a correction is minus the deviation: the sign is turned"
        elif sign is None and reversed_ and not straight:
            sign = "commanded-minus-actual"
            reason = f"the file says {reversed_.group(0)!r}: the sign is turned"
        elif sign is None and straight:
            sign, reason = "actual-minus-commanded", f"the file says {straight.group(0)!r}"
        elif sign is None:
            reason = "the file does not say its sign: taken as actual minus commanded (--sign says it)"
        if reason:
            p.guesses[name] = f"{p.guesses.get(name, '')}; {reason}".strip("; ")
        if sign == "commanded-minus-actual":
            entry = p.entries[name]
            raw = p.put(f"{name}_as_written", p.data.pop(name), role="ignore")
            p.entries[name] = {**entry, "derived": {"of": raw, "factor": -1.0}}


def turn_readings(p: Proposal) -> None:
    """Readings that fall one for one as the command rises count the other way: the actual position is minus them."""
    for name in [n for n, e in p.entries.items() if e["role"] in ("actual", "position") and n in p.data]:
        entry = p.entries[name]
        command = p.first("command", entry["axis"]) or p.first("position", entry["axis"])
        if command == name or command not in p.data:
            continue
        slope = _slope(*(_canonical(p, n) for n in (command, name)))
        if slope is not None and abs(slope + 1.0) < ABSOLUTE:
            raw = p.put(f"{name}_as_read", p.data.pop(name), role="ignore")
            p.entries[name] = {**entry, "role": "actual", "derived": {"of": raw, "factor": -1.0}}
            p.guesses[name] = f"{raw} falls one for one as {command} rises: it counts the other way and is turned"


def _canonical(p: Proposal, name: str) -> np.ndarray:
    convert = units.conversion("position", p.entries[name].get("unit"))
    return p.data[name] if convert is None else convert(p.data[name])


def _slope(x: np.ndarray, y: np.ndarray) -> float | None:
    """Least-squares slope of y over x; None where x does not vary, or values are too small or large to say."""
    good = np.isfinite(x) & np.isfinite(y)
    if good.sum() <= 3:
        return None
    with np.errstate(all="ignore"):
        from_mean = x[good] - x[good].mean()
        spread = np.square(from_mean).sum()
        slope = float((from_mean * (y[good] - y[good].mean())).sum() / spread)
    return slope if np.isfinite(spread) and np.isfinite(slope) else None


def _sign_shown(p: Proposal, name: str) -> tuple[bool, str] | None:
    """Whether an error is minus the difference of the recorded positions, and that difference; None: not known."""
    component = p.entries[name]["component"]
    for axis in {e["axis"] for e in p.entries.values() if e.get("axis")}:
        command, actual = p.first("command", axis), p.first("actual", axis) or p.first("position", axis)
        if component != components.positioning(axis) or command not in p.data or actual not in p.data:
            continue
        x, y = _canonical(p, actual) - _canonical(p, command), p.data[name]
        good = np.isfinite(x) & np.isfinite(y)
        if good.sum() < 4 or min(np.ptp(x[good]), np.ptp(y[good])) == 0:
            continue
        r = float(np.corrcoef(x[good], y[good])[0, 1])
        if abs(r) > SHOWN:
            return r < 0, f"{actual} - {command} (correlation {r:.2f})"
    return None


def readings_as_errors(p: Proposal, axis: str) -> None:
    """An error column that runs along with the position is a reading: the error is derived from it."""
    place = p.first("command", axis) or p.first("position", axis)
    for name in [n for n, e in p.entries.items() if e["role"] == "error" and n in p.data]:
        entry = p.entries[name]
        if place is None or place not in p.data or entry["component"] != components.positioning(axis):
            continue
        slope = _slope(p.data[place], p.data[name])
        if slope is None or abs(slope - 1.0) > ABSOLUTE:
            continue
        unit = p.entries[place].get("unit", "mm")
        del p.entries[name]
        p.guesses.pop(name, None)
        name = p.put(
            f"actual_{axis}" if name == entry["component"] else name,
            p.data.pop(name),
            role="actual",
            axis=axis,
            unit=unit,
        )
        p.guesses[name] = f"it rises with {place} one for one: absolute readings in {unit}, not deviations"


def derive_error(p: Proposal, axis: str, options: ImportOptions) -> None:
    """error = actual - commanded, where both are recorded and no error column is."""
    if any(e["role"] == "error" for e in p.entries.values()):
        return
    for letter in dict.fromkeys([axis, *(e["axis"] for e in p.entries.values() if e.get("axis"))]):
        command = p.first("command", letter)
        actual = p.first("actual", letter) or (p.first("position", letter) if command else None)
        command = command or (p.first("position", letter) if actual else None)
        if command is None or actual is None or command == actual:
            continue
        if p.entries[command]["role"] == "position":
            p.entries[command]["role"] = "command"
        component = options.component or components.positioning(letter)
        unit = components.unit(component)
        name = p.put(
            component, None, role="error", component=component, unit=unit, derived={"minus": [actual, command]}
        )
        p.guesses[name] = f"error = {actual} - {command} (actual minus commanded)"


# ---------------------------------------------------------------- order of rows


def _is_log(p: Proposal, axis: str) -> bool:
    command = p.first("command", axis) or p.first("position", axis)
    if p.first("time") is None or command is None or p.rows < DENSE_ROWS or command not in p.data:
        return False
    return np.unique(np.round(p.data[command], 4)).size > DENSE_PLACES


def _log_of_an_axis(p: Proposal, axis: str) -> None:
    """Velocity, acceleration and direction from the command, and an ideal axis as the simulation."""
    command, time = p.first("command", axis), p.first("time")
    if command is None or time is None or p.entries[command].get("unit", "mm") not in ("mm", "deg"):
        return
    scale = {"s": 1.0, "ms": 1e-3, "min": 60.0, "h": 3600.0, "d": 86400.0}[p.entries[time].get("unit", "s")]
    t, x = p.data[time] * scale, p.data[command]
    if np.isfinite(t).all() and np.isfinite(x).all() and np.all(np.diff(t) > 0):
        unit = p.entries[command].get("unit", "mm")
        v = np.gradient(x, t)
        if p.first("velocity", axis) is None:
            p.put(
                f"v_{axis}", np.round(v, 6), "derivative of the command", role="velocity", axis=axis, unit=f"{unit}/s"
            )
        if p.first("acceleration", axis) is None:
            a = np.round(np.gradient(v, t), 4)
            p.put(f"a_{axis}", a, "second derivative of the command", role="acceleration", axis=axis, unit=f"{unit}/s2")
    error = next(n for n, e in p.entries.items() if e["role"] == "error")
    if p.first("simulated") is None:
        component, unit = p.entries[error]["component"], p.entries[error]["unit"]
        p.put(f"{component}_sim", None, role="simulated", component=component, unit=unit, derived={"constant": 0.0})
        p.guesses[f"{component}_sim"] = "the simulation is an ideal axis that follows its command (deviation 0)"


def _directions_and_runs(p: Proposal, axis: str) -> None:
    place = p.first("command", axis) or p.first("position", axis)
    if place is None or place not in p.data:
        return
    x = p.data[place]
    if p.first("direction") is None:
        moves = motion_sides(x)
        if moves is not None and np.unique(moves).size == 2:
            p.put(
                "direction", moves, "from the order of the positions: +1 where they rise", role="direction", axis=axis
            )
    if p.first("run") is None:
        side = p.first("direction")
        runs = sweeps(x, p.data.get(side or ""))
        if len(set(runs)) > 1:
            why = "a new run each time the targets start again"
            p.put("run", runs, why, role="run")
    if p.first("direction") is None and _repeated(x, p.data.get(p.first("run") or "")):
        p.notes.append(
            "targets come several times in a run and nothing says from which side: backlash cannot be told from scatter"
        )


def _repeated(x: np.ndarray, runs: list[str] | None) -> bool:
    """Whether most targets come more than once in a run."""
    pairs = list(zip(runs or [""] * x.size, np.round(x, 6).tolist(), strict=True))
    return x.size > 3 and len(set(pairs)) <= 0.6 * len(pairs)


def motion_sides(x: np.ndarray) -> np.ndarray | None:
    """+1 where positions rise, -1 where they fall; a repeated one belongs to the way back. None where unordered."""
    step = np.sign(np.diff(x))
    if not step.any():
        return None
    out = np.empty(x.size)
    out[1:] = step
    out[0] = step[np.flatnonzero(step)[0]]
    for i in np.flatnonzero(out == 0):
        later = out[i + 1 :][out[i + 1 :] != 0]
        out[i] = later[0] if later.size else out[i - 1]
    turns = np.count_nonzero(np.diff(out))
    return out if turns <= x.size / 3 else None


def sweeps(x: np.ndarray, side: np.ndarray | None) -> list[str]:
    """Labels of the runs: a pass up and a pass down are one run; without a way back each pass is one."""
    way = motion_sides(x) if side is None else side
    if way is None:
        return ["1"] * x.size
    jumps = np.r_[False, np.diff(way) != 0]
    if np.unique(way).size < 2:
        span = np.ptp(x) or 1.0
        return [str(1 + k) for k in np.cumsum(np.r_[False, np.abs(np.diff(x)) > 0.5 * span])]
    return [str(1 + k // 2) for k in np.cumsum(jumps)]
