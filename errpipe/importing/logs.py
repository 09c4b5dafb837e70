"""Logs of other devices, without deviations, merged with the readings by date and time."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pandas as pd

from errpipe.errors import DataError
from errpipe.importing import daylight_saving
from errpipe.importing.proposed import AXIS_ASSUMED, Proposal, slug
from errpipe.importing.several_files import OF_A_MACHINE, concatenate_files, epoch_of, lacking, names_of_files, shift

OF_BOTH = (*OF_A_MACHINE, "spindle_speed", "velocity", "feed")  # what two devices may both record
LARGEST_SHIFT = 900.0  # s, by judgement: clocks that are set by hand differ by minutes; an hour is a time zone
MOST_COMPARED = 2000  # rows, and shifts, of a comparison of two clocks; by judgement
SAME_MISFIT = 0.01  # of the range: differences that noise explains; by judgement
CLOCK_RATIO = 3.0  # of mean differences now and at the best shift; by judgement, tried on logs shifted by -240 to 180 s
Period = tuple[datetime, datetime] | None  # first and last row of a log; None without dates
STALE_STEPS = 10.0  # steps of a log, by judgement: an older reading is not used for the row


def add_logs(p: Proposal, parts: Mapping[Path, Proposal], inside: Mapping[Path, tuple[str, ...]]) -> None:
    """Merge the logs of all devices with the readings, in place: a column that several have is named by its file.

    inside: the folders of a file within a folder or archive from the user.
    """
    stems = dict(zip(parts, names_of_files([*parts], inside), strict=True))
    devices = [[stems[file] for file in files] for files in _group_by_device(parts, stems)]
    by_name = {stems[file]: part for file, part in parts.items()}
    logs = [concatenate_files([by_name[name] for name in names], names) for names in devices]
    times = {log.first("time") for log in logs}
    count = Counter(name for log in logs for name in log.entries if name not in times)
    for log, names in zip(logs, devices, strict=True):
        _add_log(p, log, names, {name for name, devices_of in count.items() if devices_of > 1})


def _group_by_device(parts: Mapping[Path, Proposal], stems: Mapping[Path, str]) -> list[list[Path]]:
    """Files without deviations by log: a logger writes a file a day, and some may lack a temperature of the others.

    stems: names of the files. Raises DataError where several devices may have written a file.
    """
    periods = {file: _first_and_last(part) for file, part in parts.items()}
    device = {file: re.sub(r"[\W\d_]+", "", stem).lower() for file, stem in stems.items()}  # `bed` of `bed_2025-03-12`

    def add(files: list[Path], groups: list[list[Path]]) -> None:
        fitting = [
            group
            for group in groups
            if all(_is_same_logger(parts[o], parts[f], periods[o], periods[f]) for o in group for f in files)
        ]
        if len(fitting) > 1:
            raise DataError(
                f"{stems[files[0]]}: does it go on {' or '.join(stems[group[0]] for group in fitting)}, which are of "
                "one period, and so of several devices? Name the files by their device, as bed_1, bed_2 and nut_1"
            )
        if fitting:
            fitting[0] += files
        else:
            groups.append([*files])

    by_device: dict[str, list[list[Path]]] = {}
    for file in sorted(parts, key=lambda f: -len(parts[f].entries)):
        add([file], by_device.setdefault(device[file], []))
    groups: list[list[Path]] = []  # `monday` and `tuesday` are of one device, if nothing was recorded at once
    for files in sorted(itertools.chain(*by_device.values()), key=lambda files: -len(parts[files[0]].entries)):
        add(files, groups)
    order = [*parts].index
    return sorted((sorted(files, key=order) for files in groups), key=lambda files: order(files[0]))


def _first_and_last(p: Proposal) -> Period:
    """The period of a log."""
    start, seconds = epoch_of(p), np.asarray(p.data.get(p.first("time") or "", []), dtype=float)
    if start is None or not np.isfinite(seconds).any():
        return None
    return start + timedelta(seconds=float(np.nanmin(seconds))), start + timedelta(seconds=float(np.nanmax(seconds)))


def _is_same_logger(whole: Proposal, part: Proposal, here: Period, there: Period) -> bool:
    """Whether two logs have the same columns, or the second lacks temperatures, and they are of different periods.

    In one period two files of one layout are of two devices, unless their readings of equal times are equal.
    here, there: their periods.
    """
    alike = whole.entries.keys() == part.entries.keys()
    if here is None or there is None or (here[0].tzinfo is None) != (there[0].tzinfo is None):
        return alike  # refused, with the reason, where they are merged
    if not alike and (part.first("temperature") is None or lacking(whole, part) is None):
        return False
    return here[1] < there[0] or there[1] < here[0] or (alike and _has_equal_readings(whole, part))


def _has_equal_readings(whole: Proposal, part: Proposal) -> bool:
    """Whether two logs with dates have times in common, and equal readings at all of these."""
    start, own, time = epoch_of(whole), epoch_of(part), whole.first("time") or ""
    here, there = whole.data[time], part.data[time]
    there = there + (own - start).total_seconds() if start is not None and own is not None else there
    _, at, again = np.intersect1d(np.round(here, 3), np.round(there, 3), return_indices=True)
    read = [n for n, v in whole.data.items() if n != time and isinstance(v, np.ndarray)]
    same = (np.array_equal(whole.data[n][at], part.data[n][again], equal_nan=True) for n in read)
    return at.size > 0 and all(same)


def _add_log(p: Proposal, log: Proposal, stems: Sequence[str], of_several: Collection[str]) -> None:
    """Merge a log without deviations with the readings, by date and time, in place.

    stems: names of the log's files, which its notes may begin with. of_several: columns that other logs have, too.
    Readings at a position take the last reading of the log before them. A drift keeps the rows of both, so that the
    warming between two readings is preserved; each stretch of the log outside every run becomes a run of its own.
    Raises DataError if a clock has no date, or if the two have no common time.
    """
    start, own, stem = epoch_of(p), epoch_of(log), stems[0]
    if start is None or own is None:
        raise DataError(
            f"{stem}: it contains no deviation, and files are merged by date and time, which not all of them have "
            "(write times such as 2025-03-01T07:00:00, or join the columns in one table)"
        )
    start, own = _same_day(p, own, start, p.notes), _same_day(log, start, own, p.notes)
    p.entries[p.first("time") or ""]["epoch"] = start.isoformat()
    shift(log, start, own)
    time, log_time = p.first("time") or "", log.first("time") or ""
    logged = pd.DataFrame({n: v for n, v in log.data.items() if log.entries[n]["role"] != "run"})
    logged = logged.dropna(subset=[log_time]).sort_values(log_time, kind="stable", ignore_index=True)
    steps = np.diff(logged[log_time])
    step = float(np.median(steps[steps > 0.0])) if (steps > 0.0).any() else 1.0
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
    names: dict[str, str] = {}
    for n in (str(n) for n in logged if n != log_time):
        name = slug(f"{stem}_{n}") if n in p.entries or n in of_several else n
        names[n] = _unused_name({*p.entries, *names.values()}, name)
    logged = logged.rename(columns={log_time: time, **names})
    if any(e["role"] in OF_A_MACHINE for e in p.entries.values()):
        values = logged.drop(columns=time).reindex(np.where(fresh, latest, -1)).reset_index(drop=True)
        both = pd.concat([pd.DataFrame(p.data), values], axis=1)
        p.notes.append(f"{stem}: its last reading before each row; {int((~fresh).sum())} rows have none")
    else:
        both = _interleaved(p, logged, time, step)
        p.notes.append(f"{stem}: its rows are merged with those of the deviations by date and time")
    for n, name in names.items():
        place = (
            {"location": f"{stem}: {log.entries[n]['location']}"} if n != name and "location" in log.entries[n] else {}
        )
        p.put(name, None, log.guesses.get(n, ""), **{**log.entries[n], **place})
    numeric = {n: pd.api.types.is_numeric_dtype(both[n]) for n in both}
    p.data = {n: both[n].to_numpy(float) if numeric[n] else both[n].fillna("").tolist() for n in both}


def _unused_name(taken: Collection[str], name: str) -> str:
    """The name, or the first of name_2, name_3 ... that is free: `bed-1` and `bed 1` are `bed_1` as columns."""
    return next(n for n in (name, *(f"{name}_{k}" for k in range(2, len(taken) + 3))) if n not in taken)


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


def _period(start: datetime, seconds: np.ndarray) -> str:
    first, last = (start + timedelta(seconds=float(f(seconds))) for f in (np.nanmin, np.nanmax))
    return f"{first:%Y-%m-%d %H:%M} to {last:%Y-%m-%d %H:%M}"
