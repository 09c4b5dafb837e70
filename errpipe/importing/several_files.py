"""Several files as one recording: files of one layout, and logs of other devices merged by date and time."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from errpipe.domain import units
from errpipe.errors import DataError
from errpipe.importing import daylight_saving
from errpipe.importing.columns import side
from errpipe.importing.order import set_side
from errpipe.importing.proposed import AXIS_ASSUMED, Proposal, slug
from errpipe.importing.words import BEFORE_A_STATE, plain

OF_A_MACHINE = ("command", "position", "actual")
MAX_SHEETS_NAMED = 6  # sheets named in a message
OF_BOTH = (*OF_A_MACHINE, "spindle_speed", "velocity", "feed")  # what two devices may both record
LARGEST_SHIFT = 900.0  # s, by judgement: clocks that are set by hand differ by minutes; an hour is a time zone
MOST_COMPARED = 2000  # rows, and shifts, of a comparison of two clocks; by judgement
SAME_MISFIT = 0.01  # of the range: differences that noise explains; by judgement
CLOCK_RATIO = 3.0  # of mean differences now and at the best shift; by judgement, tried on logs shifted by -240 to 180 s
STALE_STEPS = 10.0  # steps of a log, by judgement: an older reading is not used for the row


def concatenate_files(parts: Sequence[Proposal], stems: Sequence[str]) -> Proposal:
    """Concatenate files of one layout; the runs of each carry its name, and times count from the first date."""
    if len(parts) == 1:
        return parts[0]
    first = parts[0]
    lacking = _without_sensor(parts, stems)
    _refuse_another_sign(parts, stems)
    for other, stem in zip(parts[1:], stems[1:], strict=True):
        if other.entries.keys() != first.entries.keys():
            not_shared = ", ".join(sorted(other.entries.keys() ^ first.entries.keys()))
            advice = "give a quantity one header in all files; where its sign is the other one, reverse its values, too"
            raise DataError(f"{stem}: its columns are not those of {stems[0]} (not in both: {not_shared}): {advice}")
        _shift(other, _epoch(first), _epoch(other))
        for name, entry in first.entries.items():
            _refuse_another(name, (entry, other.entries[name]), (stems[0], stem))
    _in_one_unit(parts, stems)
    joined = Proposal(entries=dict(first.entries), guesses=dict(first.guesses), notes=[*first.notes, *lacking])
    for part, stem in zip(parts[1:], stems[1:], strict=True):
        joined.notes += [f"{stem}: {note}" for note in part.notes if note not in (*first.notes, AXIS_ASSUMED)]
    run = joined.first("run")
    if run is None:
        run = joined.put("run", None, "one run for each file", role="run")
        joined.entries = {run: joined.entries.pop(run), **joined.entries}
    for name in first.data:
        values = [part.data[name] for part in parts]
        joined.data[name] = (
            [v for part in values for v in part] if isinstance(values[0], list) else np.concatenate(values)
        )
    labels = []
    for part, stem in zip(parts, stems, strict=True):
        own_labels = part.data.get(run)
        labels += [f"{stem}-{label}" for label in own_labels] if own_labels is not None else [stem] * part.rows
    joined.data[run] = labels
    return joined


def _without_sensor(parts: Sequence[Proposal], stems: Sequence[str]) -> list[str]:
    """Fill temperatures that some files lack, or have without a reading, with empty cells, in place; notes on them."""
    notes = []
    whole = max(parts, key=lambda part: len(part.entries))
    for part, stem in zip(parts, stems, strict=True):
        missing = _lacking(whole, part) or []
        for name in missing:
            part.entries[name] = dict(whole.entries[name])
            part.guesses[name] = whole.guesses.get(name, "")
            part.data[name] = np.full(part.rows, np.nan)
        if missing:
            notes.append(f"{stem}: no reading of {', '.join(missing)}: missing")
    return notes


def names_of_files(files: Sequence[Path], inside: Mapping[Path, tuple[str, ...]]) -> list[str]:
    """Names of runs, one per file: the stem, after the folders that not all of them share; a number if two are equal.

    inside: the folders of a file within a folder or archive from the user; of any other file its own folder counts.
    """
    parts = [(*inside.get(file, (file.resolve().parent.name,)), file.stem) for file in files]
    shared = next(
        (n for n, of in enumerate(zip(*parts, strict=False)) if len({*of}) > 1), len(parts[0]) if parts else 0
    )
    stems = ["_".join(part[min(shared, len(part) - 1) :]) for part in parts]
    return [f"{s}_{stems[: n + 1].count(s)}" if stems.count(s) > 1 else s for n, s in enumerate(stems)]


def of_one_log(parts: Mapping[Path, Proposal]) -> list[list[Path]]:
    """Files without deviations by log: a logger writes a file a day, and some may lack a temperature of the others."""
    groups: list[list[Path]] = []
    for file in sorted(parts, key=lambda f: -len(parts[f].entries)):
        own = [files for files in groups if all(_of_one_logger(parts[other], parts[file]) for other in files)]
        groups += [] if own else [[]]
        (own or groups[-1:])[0].append(file)
    order = [*parts].index
    return sorted((sorted(files, key=order) for files in groups), key=lambda files: order(files[0]))


def _of_one_logger(whole: Proposal, part: Proposal) -> bool:
    """Whether two logs have the same columns, or the second lacks temperatures and is of another period."""
    if whole.entries.keys() == part.entries.keys():
        return True
    start, own, time = _epoch(whole), _epoch(part), whole.first("time") or ""
    if start is None or own is None or part.first("temperature") is None or _lacking(whole, part) is None:
        return False
    if (start.tzinfo is None) != (own.tzinfo is None):
        return False
    here, there = whole.data[time], part.data[time] + (own - start).total_seconds()
    return bool(np.nanmax(here) < np.nanmin(there) or np.nanmax(there) < np.nanmin(here))


def _lacking(whole: Proposal, part: Proposal) -> list[str] | None:
    """Temperatures of the first that the second lacks; None if it differs in more: another name is another sensor."""
    missing = [n for n in whole.entries if n not in part.entries]
    other = part.entries.keys() - whole.entries.keys() or any(
        whole.entries[n]["role"] != "temperature" for n in missing
    )
    return None if other else missing


_SIDE_OF_NAME = re.compile(r"[^\W\d_]{2,}|(?<=[^\W_])[+-](?![^\W_])|(?<![^\W_])[+-](?=[XYZABC](?:_|\b))")  # `X+`, `-X`
_RUN_WORD = r"(?:runs?|lauf|durchlauf|messung|messreihe|cycle|zyklus|pass|trial|essai|passe|prova|ensayo|pasada)"


def are_runs(names: Sequence[str]) -> bool:
    """Whether names of sheets are those of the runs of one test: `Run 1`, `Run 2`, or `Forward`, `Backward`.

    Names that differ in more than a run number and a side, or have neither, may be of other machines or states.
    """
    rests = {re.sub(rf"{_RUN_WORD}[ _.-]*\d+", "", plain(name)) for name in names}
    bare = {re.sub(r"[^\W\d_]{2,}", lambda m: "" if side(m[0]) is not None else m[0], rest).strip() for rest in rests}
    numbered = all(re.search(rf"{_RUN_WORD}[ _.-]*\d+", plain(name)) for name in names)
    both = {side(w) for n in names for w in re.findall(r"[^\W\d_]{2,}", plain(n))} >= {1.0, -1.0}
    return len(bare) == 1 and len(set(names)) == len(names) and (numbered or both)


_CORRECTED = rf"(?:{BEFORE_A_STATE}[ -])?(?:comp(?:ens\w*)?|kompen[sz]\w*|korrektur|korrigiert|corre[cz]\w*)"
_STATES = re.compile(
    rf"(?<![^\W_])(before|after|vorher|nachher|avant|apres|{_CORRECTED}[ -]?(?:on|off|ein|aus)"
    rf"|un(?:comp|kompens|korr|corr)\w*|{_CORRECTED})(?![^\W_])"
)


def refuse_states(names: Sequence[str], what: str, answer: str) -> None:
    """Raise DataError if names state several states of one machine, such as before and after a compensation."""
    of_names = [tuple(m[0] for m in _STATES.finditer(plain(name))) for name in names]
    if len(set(of_names)) > 1:
        raise DataError(
            f"{what} {', '.join(names)}: several states of the machine? Runs of one test share one state: {answer} "
            "(if the state is the same, rename them)"
        )


def of_one_test(part: Proposal, first: Proposal) -> bool:
    """Whether two parts have columns of the same names, roles, axes and components."""
    keys = ("role", "axis", "component", "of", "derived")
    return part.entries.keys() == first.entries.keys() and all(
        [part.entries[n].get(k) for k in keys] == [e.get(k) for k in keys] for n, e in first.entries.items()
    )


def runs_of_sheets(sheets: list[tuple[Proposal, str]]) -> list[tuple[Proposal, str]]:
    """Sheets with their names; those that are runs of one test, by names and columns, merged.

    Raises DataError if columns are equal and the names are not those of runs: two years, or a corrected copy.
    """
    named = [sheet for sheet in sheets if are_runs([sheets[0][1], sheet[1]]) or sheet is sheets[0]]
    _refuse_another_sign([part for part, _ in named], [name for _, name in named])
    alike = [(part, name) for part, name in sheets if of_one_test(part, sheets[0][0])]
    parts, names = [part for part, _ in alike], [name for _, name in alike]
    if len(parts) < 2:
        return sheets
    if not are_runs(names):
        shown = ", ".join(names[:MAX_SHEETS_NAMED])
        raise DataError(
            f"sheets {shown} have the same columns: which one is meant? Select it with --sheet (runs of one test: name "
            "them Run 1, Run 2)"
        )
    joined = concatenate_files(parts, sides_of_names(parts, names))
    joined.notes.append(f"the sheets {', '.join(names)} are runs of one test")
    return [(joined, ", ".join(names)), *(rest for rest in sheets if rest[1] not in names)]


def sides_of_names(parts: Sequence[Proposal], stems: Sequence[str]) -> list[str]:
    """Run names of files that differ only by their sides, whose rows get these: `X_up`, `X_down`.

    The file names if their columns state the sides, or if not every name does.
    """
    of_names = [[w for w in _SIDE_OF_NAME.findall(stem) if side(w) is not None] for stem in stems]
    shared = set(of_names[0]).intersection(*of_names) if of_names else set()  # `pos` of `pos_X_up` and `pos_X_down`
    of_names = [[w for w in of_stem if w not in shared] for of_stem in of_names]
    ways = {side(words[0]) for words in of_names if len(words) == 1}
    stated = any(part.first("direction") is not None for part in parts)
    if stated or ways != {1.0, -1.0} or any(len(words) != 1 for words in of_names):
        return [*stems]
    for part, stem, (word,) in zip(parts, stems, of_names, strict=True):
        axis = next((e["axis"] for e in part.entries.values() if e["role"] in OF_A_MACHINE), None)
        if axis is not None:
            set_side(part, axis, word, f"the name of the file {stem!r} states {word!r}")
            part.guesses[part.first("direction") or ""] = "from the names of the files"
    bare = [_without(stem, word) for stem, (word,) in zip(stems, of_names, strict=True)]
    return [text.strip(" _-") or "1" for text in bare]


def _without(stem: str, word: str) -> str:
    return re.sub(rf"[\W_]*({_SIDE_OF_NAME.pattern})", lambda m: "" if m[1] == word else m[0], stem)


def _refuse_another(name: str, entries: tuple[dict[str, Any], ...], stems: tuple[str, str]) -> None:
    """Raise DataError if a column of two files belongs to another axis or component: they are not runs of one test."""
    for key in ("role", "axis", "component", "of", "derived"):
        here, there = (entry.get(key) for entry in entries)
        if here != there:
            raise DataError(f"{stems[1]}: {key} of {name!r} is {there}, in {stems[0]} {here}: import them separately")


def _refuse_another_sign(parts: Sequence[Proposal], stems: Sequence[str]) -> None:
    """Raise DataError if some parts state that their deviations are commanded minus actual, and others do not."""
    for part, stem in zip(parts, stems, strict=True):
        for name in [n for n, e in part.entries.items() if e["role"] == "error" and e.get("derived", {}).get("of")]:
            others = [(o.entries.get(name, {}), s) for o, s in zip(parts, stems, strict=True)]
            silent = next((s for e, s in others if e.get("role") == "error" and "derived" not in e), None)
            if silent is not None:
                raise DataError(
                    f"{stem}: {name!r} is commanded minus actual ({part.guesses.get(name, '').split('; ')[-1]}), and "
                    f"{silent} does not say so: if it holds for all, use --sign commanded-minus-actual; else import "
                    "them separately"
                )


def _in_one_unit(parts: Sequence[Proposal], stems: Sequence[str]) -> None:
    """Convert columns in several units to the canonical one, in place.

    Raises DataError if one of the units was guessed.
    """
    for name, entry in parts[0].entries.items():
        if len({part.entries[name].get("unit") for part in parts}) < 2 or entry["role"] == "ignore":
            continue
        guessed = [s for s, part in zip(stems, parts, strict=True) if "no unit is stated" in part.guesses.get(name, "")]
        if guessed:
            raise DataError(
                f"{guessed[0]}: no unit is stated for {name!r}, and it seems to differ from that of the other files"
            )
        for part in parts:
            convert = units.conversion(entry["role"], part.entries[name].get("unit"))
            if convert is not None:
                part.data[name] = convert(part.data[name])
                part.entries[name]["unit"] = convert.unit
        parts[0].notes.append(
            f"{name}: converted to {parts[0].entries[name]['unit']}, because the files have several units"
        )


def add_log(p: Proposal, log: Proposal, stems: Sequence[str]) -> None:
    """Merge a log without deviations with the readings, by date and time, in place.

    stems: names of the log's files, which its notes may begin with.
    Readings at a position take the last reading of the log before them. A drift keeps the rows of both, so that the
    warming between two readings is preserved; each stretch of the log outside every run becomes a run of its own.
    Raises DataError if a clock has no date, or if the two have no common time.
    """
    start, own, stem = _epoch(p), _epoch(log), stems[0]
    if start is None or own is None:
        raise DataError(
            f"{stem}: it contains no deviation, and files are merged by date and time, which not all of them have "
            "(write times such as 2025-03-01T07:00:00, or join the columns in one table)"
        )
    start, own = _same_day(p, own, start, p.notes), _same_day(log, start, own, p.notes)
    p.entries[p.first("time") or ""]["epoch"] = start.isoformat()
    _shift(log, start, own)
    time, log_time = p.first("time") or "", log.first("time") or ""
    logged = pd.DataFrame({n: v for n, v in log.data.items() if log.entries[n]["role"] != "run"})
    logged = logged.dropna(subset=[log_time]).sort_values(log_time, kind="stable", ignore_index=True)
    step = float(np.median(np.diff(logged[log_time]))) if len(logged) > 1 else 1.0
    at = np.asarray(p.data[time], dtype=float)
    latest = np.searchsorted(logged[log_time], at, side="right") - 1
    fresh = (latest >= 0) & (at - logged[log_time].to_numpy()[np.maximum(latest, 0)] <= STALE_STEPS * step)
    if not fresh.any():
        raise DataError(
            f"{stem}: none of its rows is from the time of the deviations ({_period(start, at)}; "
            f"of {stem}: {_period(start, logged[log_time].to_numpy())})"
        )
    named = tuple(f"{name}: " for name in stems)
    notes = [note for note in log.notes if note not in (*p.notes, AXIS_ASSUMED)]
    p.notes += [note if note.startswith(named) else f"{stem}: {note}" for note in notes]
    p.notes.append(f"{stem}: its clock is taken to agree with that of the deviations: if not, shift its times")
    _refuse_other_clock(p, log, logged, at, (stem, log_time, step))
    of_run = p.data.get(p.first("run") or "", [""] * at.size)
    p.notes += daylight_saving.note(stem, of_run, at, logged[log_time].to_numpy(), STALE_STEPS * step)
    names = {n: n if n not in p.entries else slug(f"{stem}_{n}") for n in logged.columns if n != log_time}
    logged = logged.rename(columns={log_time: time, **names})
    if any(e["role"] in OF_A_MACHINE for e in p.entries.values()):
        values = logged.drop(columns=time).reindex(np.where(fresh, latest, -1)).reset_index(drop=True)
        both = pd.concat([pd.DataFrame(p.data), values], axis=1)
        p.notes.append(f"{stem}: its last reading before each row; {int((~fresh).sum())} rows have none")
    else:
        both = _interleaved(p, logged, time, step)
        p.notes.append(f"{stem}: its rows are merged with those of the deviations by date and time")
    for n, name in names.items():
        p.put(name, None, log.guesses.get(n, ""), **log.entries[n])
    numeric = {n: pd.api.types.is_numeric_dtype(both[n]) for n in both}
    p.data = {n: both[n].to_numpy(float) if numeric[n] else both[n].fillna("").tolist() for n in both}


def _same_day(p: Proposal, other: datetime, own: datetime, notes: list[str]) -> datetime:
    """The date of a file; with day and month exchanged if it is then that of the other file, as 12/03 beside 12.03."""
    # Not where a date shows the order, as in a log that passes a midnight.
    assumed = re.search("the (month|day) first", p.guesses.get(p.first("time") or "", ""))
    if not assumed or own.day == own.month or (own.day, own.month, own.year) != (other.month, other.day, other.year):
        return own
    notes.append(f"day and month of {own:%Y-%m-%d} are exchanged: it is then the day of the other file")
    return own.replace(day=own.month, month=own.day)


def _refuse_other_clock(
    p: Proposal, log: Proposal, logged: pd.DataFrame, at: np.ndarray, of_log: tuple[str, str, float]
) -> None:
    """Raise DataError if a speed or position that both files record agrees better at another time: two clocks.

    The shift is that of the smallest mean absolute difference. of_log: its name, its column of times, s between rows.
    """
    stem, log_time, step = of_log
    clock = logged[log_time].to_numpy(float)
    rows = np.unique(np.linspace(0, at.size - 1, MOST_COMPARED).astype(int))
    shifts = step * np.arange(-np.floor(LARGEST_SHIFT / step), np.floor(LARGEST_SHIFT / step) + 1)
    shifts = shifts[:: max(shifts.size // MOST_COMPARED, 1)]
    for name in [n for n in logged if log.entries[n]["role"] in OF_BOTH]:
        own = next((n for n in p.data if {**p.entries[n], "location": 0} == {**log.entries[name], "location": 0}), None)
        if own is None:
            continue
        here, there = np.asarray(p.data[own], dtype=float)[rows], logged[name].to_numpy(float)
        latest = np.searchsorted(clock, at[rows][None, :] + shifts[:, None], side="right") - 1
        known = (latest >= 0) & (latest < clock.size - 1) & np.isfinite(here + there[latest])
        misfit = np.where(known, np.abs(here - there[latest]), 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
        misfit[known.sum(axis=1) < 0.5 * rows.size] = np.inf
        near = shifts[misfit <= misfit.min() + SAME_MISFIT * np.ptp(here)]  # a cycle agrees again one period later
        best, now = near[np.argmin(np.abs(near))], misfit[np.argmin(np.abs(shifts))]
        least = CLOCK_RATIO * misfit.min() + SAME_MISFIT * np.ptp(here)
        if abs(best) >= 2.0 * step and np.isfinite(now) and now > least:
            way = "later" if best > 0 else "earlier"
            raise DataError(
                f"{stem}: {name!r} is in both files, and agrees best {abs(best):g} s {way} there: the clocks "
                f"differ. Correct the times of one, or leave it out (--set {name}.role=ignore)"
            )


def _interleaved(p: Proposal, logged: pd.DataFrame, time: str, step: float) -> pd.DataFrame:
    """Rows of readings and of a log sorted by time, shape (both,); `run` is added if there is none."""
    run = p.first("run") or p.put("run", None, "the run of the deviations; the log at that time", role="run")
    rows = pd.DataFrame(p.data)
    rows[run] = rows[run].astype(str) if run in rows else "1"
    spans = rows.groupby(run, sort=False)[time].agg(["min", "max"]).sort_values("min")
    before = np.searchsorted(spans["min"] - step, logged[time], side="right") - 1
    inside = (before >= 0) & (logged[time].to_numpy() <= spans["max"].to_numpy()[np.maximum(before, 0)])
    stretch = np.cumsum(_starts(logged[time].to_numpy(), np.where(inside, -2, before), STALE_STEPS * step))
    own = [spans.index[b] if i else f"log {s}" for b, i, s in zip(before, inside, stretch, strict=True)]
    both = pd.concat([rows, logged.assign(**{run: own})], ignore_index=True)
    return both.sort_values(time, kind="stable", ignore_index=True)


def _starts(time: np.ndarray, between: np.ndarray, longest: float) -> np.ndarray:
    """Whether a stretch of a log outside the runs begins, per row: between other runs, or after a break of the log."""
    new = np.r_[True, (np.diff(between) != 0) | (np.diff(time) > longest)]
    return new & (between >= -1)


def _epoch(p: Proposal) -> datetime | None:
    """The date at which the time of a proposal, in s, was 0."""
    entry = p.entries.get(p.first("time") or "", {})
    return datetime.fromisoformat(entry["epoch"]) if entry.get("epoch") and entry.get("unit") == "s" else None


def _shift(p: Proposal, start: datetime | None, own: datetime | None) -> None:
    """Make the times of a proposal count from another date. Raises DataError if only one date has a time zone."""
    if start is None or own is None:
        return
    if (start.tzinfo is None) != (own.tzinfo is None):
        zoned, bare = (start, own) if start.tzinfo else (own, start)
        raise DataError(
            f"the times of one file have a time zone ({zoned.isoformat()}) and those of another do not "
            f"({bare.isoformat()}), which may differ by hours: write both with a time zone, or both without"
        )
    time = p.first("time") or ""
    p.data[time] = p.data[time] + (own - start).total_seconds()
    p.entries[time]["epoch"] = start.isoformat()


def _period(start: datetime, seconds: np.ndarray) -> str:
    first, last = (start + timedelta(seconds=float(f(seconds))) for f in (np.nanmin, np.nanmax))
    return f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}"
