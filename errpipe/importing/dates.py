"""Dates, clock times and elapsed times as files write them, in seconds since the first row."""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from errpipe.domain.recording import ROLE_UNITS
from errpipe.errors import DataError
from errpipe.importing.layout import RawColumn
from errpipe.importing.sheet import Cell
from errpipe.importing.units import unit_of
from errpipe.importing.words import kind_by_name

NOT_UNDERSTOOD = "a date in an unknown format"
MIDNIGHT = "T00:00:00"  # how a workbook writes a date without a time of day
_DATE = re.compile(
    rf"(\d{{4}}-\d\d-\d\d|\d{{1,2}}[./-]\d{{1,2}}[./-]\d{{2,4}}|\d{{4}}/\d\d?/\d\d?)(?:{MIDNIGHT})?"
    r"|\d{1,2}[-. ]{1,2}[^\W\d_]{3,9}[-. ]{1,2}\d{2,4}"  # 20-Feb-2026
)
_CLOCK = re.compile(r"\d{1,2}:\d\d(:\d\d([.,]\d+)?)?( ?[AaPp]\.?[Mm]\.?)?")
_CLOCK_BEHIND = re.compile(r"\D?\d{1,2}:\d\d")  # a date
_ELAPSED = re.compile(
    r"(?:(\d+)\s*(?:d|days?|tage?|[.:])?\s+|(\d+)[.:](?=\d+:\d\d:))?(\d+):(\d\d)(?::(\d\d(?:\.\d+)?))?"
)
_NUMBERED_DAY = re.compile(r"^(?:day|tag|jour|giorno|d[ií]a)[ .#]{0,3}(\d{1,4})[ :;-]{1,3}", re.IGNORECASE)
_COMPACT = re.compile(r"(?:19|20)\d{12}")  # yyyymmddhhmmss, read as a number
_FIRST_YEAR = 1901  # strptime returns 1900 for a text with only a clock time
_HALF_A_DAY = 43200.0  # s
LONGEST_NOON = 10800.0  # s, by judgement: a longer pause from a morning to `1:30` is rather a night

_CLOCKS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M %p")
_DAY_BEFORE_MONTH = ("%d.%m.%Y", "%d.%m.%y", "%d-%m-%Y", "%d-%b-%Y", "%d %b %Y", "%b %d %Y")
_YEAR_FIRST = ("%Y/%m/%d", "%Y.%m.%d", "%Y-%m-%d")


def _forms(*dates: str) -> tuple[str, ...]:
    return tuple(f"{date} {clock}" for date in dates for clock in _CLOCKS)


_USUAL = (
    *_forms(*_DAY_BEFORE_MONTH, "%m/%d/%Y", "%m/%d/%y", *_YEAR_FIRST),
    *("%Y%m%d%H%M%S", "%Y%m%d_%H%M%S", "%Y%m%d-%H%M%S", "%Y%m%d %H:%M:%S"),
    *_CLOCKS,
)
# With slashes and dashes, month or day may come first: both are tried, and the shorter ascending time is used.
_OTHER_ORDER = _forms("%d/%m/%Y", "%d/%m/%y", "%m-%d-%Y", "%y-%m-%d")
_YEAR_OF_TWO_DIGITS = _forms("%y/%m/%d", "%d-%m-%y")

# Ticks since an epoch, by magnitude: from, to, s per tick.
EPOCHS = ((1e9, 4.2e9, 1.0), (1e12, 4.2e12, 1e-3), (1e15, 4.2e15, 1e-6), (1.1e17, 1.7e17, 1e-7), (1e18, 4.2e18, 1e-9))
# Days of the years 2000 to 2099: spreadsheet (or modified Julian), MATLAB's datenum, Julian.
SPREADSHEET_ZERO = datetime(1899, 12, 30)  # of the day count of Excel and similar programs
DAY = 86400.0  # s
_JULIAN = re.compile(r"\b(?:(m)?jd|(modified )?julian)\b", re.IGNORECASE)
SERIAL_DAYS = ((36526.0, 73050.0), (730486.0, 767010.0), (2451544.5, 2488069.5))

SHORT = {"us": 1e-6, "ns": 1e-9}  # units of time that the manifest does not have, in s
FILE_TIME = 1e-7  # such ticks do not count from 1970


def seconds(column: RawColumn) -> tuple[np.ndarray, str | None, str] | None:
    """Dates, clock or elapsed times as s since the first, that date in ISO 8601, and the format; or None."""
    texts = [_usual_signs(str(c).strip()) if c not in (None, "") else "" for c in _cells(column)]
    first = next((t for t in texts if t), None)
    if first is None:
        return None
    usual = ("%M:%S",) if re.search(r"mm:ss", column.header) else ("ISO 8601", *_USUAL)
    candidates = [s for forms in (usual, _OTHER_ORDER, _YEAR_OF_TWO_DIGITS) if (s := _since_first(texts, forms))]
    if not candidates:
        return _elapsed(texts)
    since, epoch, form = min(candidates, key=lambda s: (np.nanmin(np.diff(s[0]), initial=0.0) < 0, np.nanmax(s[0])))
    zones = {
        f"{sign}{int(hours):02d}:{minutes or '00'}" if sign else _ZONES.get(name.upper(), "+02:00")
        for name, sign, hours, minutes in _ZONE.findall(f"{column.header} {column.unit or ''}")
    }
    if len(zones) == 1 and epoch is not None and datetime.fromisoformat(epoch).tzinfo is None:  # not `CET/CEST`
        epoch += zones.pop()
    return since, epoch, form


def numbered(c: RawColumn, unit: str | None, why: str) -> tuple[np.ndarray, str, str, str | None]:
    """Times that are numbers, their unit, the reason and the date of 0.

    Raises DataError for values that may be days or seconds.
    """
    if (counted := unwrapped(c.values)) is not c.values:
        c, why = RawColumn(c.header, c.unit, c.cells, counted), f"{why}; counter overflow corrected"
    first, last = float(np.nanmin(c.values)), float(np.nanmax(c.values))
    unit = unit or unit_of(c.header)  # a column named `minutes`
    tick = next((tick for low, high, tick in EPOCHS if low <= first < high), None)
    epoch = None if tick in (None, FILE_TIME) else datetime.fromtimestamp(first * tick, UTC).isoformat()
    if unit in SHORT:
        return (c.values - first) * SHORT[unit], "s", f"{why}; {unit} converted to s", epoch
    if tick is not None and (unit not in ROLE_UNITS["time"] or {"s": 1.0, "ms": 1e-3}.get(unit or "") == tick):
        return (c.values - first) * tick, "s", f"{why}; ticks of {tick:g} s since an epoch, by their magnitude", epoch
    days = any(low <= first <= last < high for low, high in SERIAL_DAYS)
    if days and (julian := _JULIAN.search(c.header)) is not None:
        of_1970 = 40587.0 if any(julian.groups()) else 2440587.5
        start = datetime.fromtimestamp((first - of_1970) * DAY, UTC).isoformat(timespec="seconds")
        return (c.values - first) * DAY, "s", f"{why}; Julian days converted to s", start
    dated = re.search(r"\b(date|datum|fecha|data|zeitstempel|time ?stamp)\b", c.header, re.IGNORECASE)
    if days and first < 1e5 and (unit == "d" or (unit is None and dated)):
        start = (SPREADSHEET_ZERO + timedelta(days=first)).isoformat(timespec="seconds")
        return (c.values - first) * DAY, "s", f"{why}; spreadsheet days converted to s", start
    if unit is None and days and last - first < len(c.values):
        raise DataError(
            f"column {c.header!r} starts at {first:g}: days since a date, or seconds? (--set '{c.header}.unit=d', or s)"
        )
    if unit not in ROLE_UNITS["time"]:
        unit, why = "s", f"{why}; no unit is stated, taken as s".strip("; ")
    late = first > 1e8 or (first > SERIAL_DAYS[0][0] and unit == "d")
    return c.values - first if late else c.values, unit, why, None


FEW_STEPS = 5.0  # of a clock: between the last row before an overflow and the first one after it


def unwrapped(values: np.ndarray) -> np.ndarray:
    """Times continued where a 16, 24 or 32 bit counter restarted from its minimum; else unchanged."""
    steps, usual = np.diff(values), float(np.median(np.diff(values), axis=0)) if values.size > 1 else 0.0
    for span in (2.0**16, 2.0**24, 2.0**32):
        if usual > 0 and (steps < 0).any() and (np.abs(steps[steps < 0] + span) <= FEW_STEPS * usual).all():
            return values + span * np.r_[0.0, np.cumsum(steps < 0)]
    return values


def order_of(form: str) -> str:
    """The assumption on a format in which day and month could be exchanged, for the user to confirm."""
    if form.startswith(("%m/", "%m-")):
        return "; the month first"
    if form.startswith(("%y/", "%y-")):
        return "; the year first"
    return "; the day first" if form.startswith(("%d/", "%d-")) else ""


def refuse_clock_set_back(c: RawColumn, since: np.ndarray) -> None:
    """Raise DataError if a clock goes back once, by an hour less one step, as at the end of summer time, or by a day.

    By a day less one step, within one date: past midnight with the date of the start.
    """
    rows = np.flatnonzero(np.isfinite(since))
    steps = np.diff(since[rows])
    usual = float(np.median(steps)) if steps.size else 0.0
    back = np.flatnonzero(steps < 0)
    pairs = [(str(c.cells[rows[i]]), str(c.cells[rows[i + 1]])) for i in back]
    one_date = all(_CLOCK_BEHIND.split(a)[0] == _CLOCK_BEHIND.split(b)[0] for a, b in pairs)
    if pairs and one_date and (np.abs(steps[back] + DAY - usual) <= FEW_STEPS * usual).all():
        before, after = pairs[0]
        raise DataError(
            f"column {c.header!r}: {after!r} follows {before!r}: the clock passes midnight, and the date does not "
            "change: write the date of each row"
        )
    noon = (steps[back] + _HALF_A_DAY > 0.0) & (steps[back] + _HALF_A_DAY <= LONGEST_NOON)
    clocks = [m for i in rows if (m := _CLOCK.fullmatch(str(c.cells[i]))) is not None]  # none if each has a date
    hours = {int(m[0].partition(":")[0]) for m in clocks}
    if noon.any() and len(clocks) == rows.size and hours <= {*range(1, 13)}:
        before, after = pairs[int(np.argmax(noon))]
        raise DataError(
            f"column {c.header!r}: {after!r} follows {before!r}: in the afternoon, or the next day? Write hours up to "
            "23, or the date of each row"
        )
    if len(pairs) == 1 and 0 <= steps[back[0]] + 3600.0 <= 2.0 * usual:
        before, after = pairs[0]
        raise DataError(
            f"column {c.header!r}: {after!r} follows {before!r}, one hour back: the end of summer time? Write the "
            "times in UTC or with their zone (2026-10-25T02:10:00+02:00, ... +01:00)"
        )


def refuse_unread(entries: dict[str, dict[str, Any]], guesses: dict[str, str], data: dict[str, Any]) -> None:
    """Raise DataError if a drift has no readable time, but a column of possible dates."""
    unread = next((name for name, why in guesses.items() if why == NOT_UNDERSTOOD), None)
    if unread is not None and not any(e["role"] == "time" for e in entries.values()):
        first = next((x for x in data[unread] if x), "")
        raise DataError(
            f"column {unread!r}: {first!r} is not a known time format (allowed: 2025-03-01T07:00:00, the usual "
            f"orders of day, month and year, seconds): convert it, or use --set {unread}.role=ignore"
        )


def is_date(text: str) -> bool:
    """Whether a text is a date without a time of day."""
    return _DATE.fullmatch(text) is not None


_DIGITS = {
    8: ("%Y%m%d", "%Y-%m-%d"),
    12: ("%Y%m%d%H%M", "%Y-%m-%d %H:%M"),
    6: ("%H%M%S", "%H:%M:%S"),
    4: ("%H%M", "%H:%M"),
}
_YEARS = range(_FIRST_YEAR, 2100)
FEWEST_CLOCKS = 6  # rows: fewer whole numbers may read as clock times by chance


def _unevenness(steps: np.ndarray) -> float:
    """The range of the steps of a clock over their median."""
    return float(np.ptp(steps) / np.median(steps)) if steps.size else 0.0


def _from_digits(c: RawColumn) -> RawColumn:
    """A column of times with `20240503`, or with `93000` or `930` for half past nine, as texts with marks.

    Others are unchanged.
    Numbers are clock times if all are valid ones and their steps then vary less: not 80, 81 ... 99, 100.
    """
    if not c.numeric or c.unit is not None or kind_by_name(c.header) != "time" or not np.isfinite(c.values).all():
        return c
    digits = [f"{v:.0f}" if v.is_integer() and 0 <= v < 1e12 else "" for v in c.values.tolist()]
    if not all(digits):
        return c
    longest = max(len(x.strip()) if isinstance(x, str) else len(t) for x, t in zip(c.cells, digits, strict=True))
    width = longest if longest > 6 else 6 if longest > 4 else 4
    form, written = _DIGITS.get(width, ("", ""))
    try:
        times = [datetime.strptime(t.zfill(width) if width < 8 else t, form) for t in digits if form]
    except ValueError:
        return c
    if not times or (width < 8 and len(times) < FEWEST_CLOCKS) or any(t.year not in (1900, *_YEARS) for t in times):
        return c
    on_clock = np.diff([(t - times[0]).total_seconds() for t in times])
    as_clock, as_number = (_unevenness(steps[steps > 0.0]) for steps in (on_clock, np.diff(c.values)))
    if width < 8 and as_clock >= 0.5 * as_number:
        return c
    return RawColumn(c.header, None, [f"{t:{written}}" for t in times], np.full(len(times), np.nan))


def date_and_clock(columns: list[RawColumn]) -> list[RawColumn]:
    """A column of dates without a time of day and one of clock times, merged; of digits alone, with marks."""
    columns = [_from_digits(c) for c in columns]
    dates = [c for c in columns if not c.numeric and c.texts and all(map(_DATE.fullmatch, c.texts))]
    clocks = [c for c in columns if not c.numeric and c.texts and all(map(_CLOCK.fullmatch, c.texts))]
    if len(dates) != 1 or len(clocks) != 1:
        return columns
    (date,), (clock,) = dates, clocks
    pairs = zip(date.cells, clock.cells, strict=True)
    both: list[Cell] = [
        None if d in (None, "") or c in (None, "") else f"{str(d).strip().removesuffix(MIDNIGHT)} {str(c).strip()}"
        for d, c in pairs
    ]
    joined = RawColumn(f"{date.header} {clock.header}", None, both, np.full(len(both), np.nan))
    return [joined if c is date else c for c in columns if c is not clock]


def _cells(column: RawColumn) -> list[Cell]:
    """The cells, numbers of fourteen digits that begin with a year as texts; empty if the column is numeric."""
    if not column.numeric:
        return column.cells
    texts = [f"{v:.0f}" if np.isfinite(v) else "" for v in column.values]
    return [*texts] if all(_COMPACT.fullmatch(t) for t in texts if t) else []


def _since_first(texts: list[str], forms: tuple[str, ...]) -> tuple[np.ndarray, str | None, str] | None:
    for form in forms:
        try:
            stamps = [_stamp(t, form) if t else None for t in texts]
            start = next(s for s in stamps if s is not None)
            out = np.array([np.nan if s is None else (s - start).total_seconds() for s in stamps])
        except (ValueError, TypeError):  # TypeError: some stamps with a time zone, some without
            continue
        if start.year >= _FIRST_YEAR:
            return out, start.isoformat(), form
        rows = np.flatnonzero(np.isfinite(out))
        steps = np.diff(out[rows])
        day = _HALF_A_DAY if _is_twelve_hour_clock([s for s in stamps if s is not None], steps) else 2.0 * _HALF_A_DAY
        for step in np.flatnonzero(steps < (0.0 if day == _HALF_A_DAY else -_HALF_A_DAY)):
            out[rows[step + 1 :]] += day  # a clock without a date passed midnight, or noon
        return out, None, form
    return None


def _is_twelve_hour_clock(stamps: list[datetime], steps: np.ndarray) -> bool:
    """Whether a clock shows 1:00 after 12:55, each time: it has hours 1 to 12, and no word for the afternoon."""
    usual, back = float(np.median(steps)) if steps.size else 0.0, steps[steps < 0.0]
    hours = {s.hour for s in stamps}
    return bool(back.size and min(hours) >= 1 and max(hours) <= 12) and bool(
        (np.abs(back + _HALF_A_DAY - usual) <= FEW_STEPS * abs(usual)).all()
    )


def _stamp(text: str, form: str) -> datetime:
    if form != "ISO 8601":
        return datetime.strptime(text, form)
    if not re.match(r"\d{4}-\d\d", text):
        raise ValueError(text)
    return datetime.fromisoformat(text.replace("Z", "+00:00"))


def _elapsed(texts: list[str]) -> tuple[np.ndarray, str | None, str] | None:
    """`0 days 00:01:00`, `Day 1 08:00`, `1.02:00:00`, `25:10:00`: days, hours, minutes and seconds since a start."""
    parts = [_ELAPSED.fullmatch(_NUMBERED_DAY.sub(r"\1 ", t)) for t in texts]
    if not all(part or not t for part, t in zip(parts, texts, strict=True)):
        return None
    out = np.array([_seconds_of(part) if part else np.nan for part in parts])
    return out - out[np.isfinite(out)][0], None, "days and a clock"


def _seconds_of(part: re.Match[str]) -> float:
    days, hours, minutes, rest = float(part[1] or part[2] or 0), float(part[3]), float(part[4]), float(part[5] or 0)
    return ((days * 24.0 + hours) * 60.0 + minutes) * 60.0 + rest


# Beginnings of month names in other languages -> as `%b` parses them.
_BEGINNINGS = (
    "Mar mär mrz mars marz; May mai mag may; Jan gen ene janv; Feb fév febb; Apr avr abr; Jun juin giu; Jul juil lug; "
    "Aug août ago; Sep set sept; Oct okt ott; Dec dez déc dic"
)
_MONTHS = {start: name for name, *starts in map(str.split, _BEGINNINGS.split(";")) for start in starts}
_ZONES = {"UTC": "+00:00", "GMT": "+00:00", "CET": "+01:00", "MEZ": "+01:00"}  # CEST, MESZ: summer time
_ZONE = re.compile(  # of a header
    r"(?<![^\W_])((?i:UTC|GMT)|CES?T|MES?Z)(?:\s?([+-])\s?(0?\d|1[0-4])(?::?([0-5]\d))?)?(?![^\W_]|\s?[+-]\s?\d)"
)
_EAST_ASIAN = str.maketrans({"年": "/", "月": "/", "日": " ", "時": ":", "时": ":", "分": ":", "秒": ""})


def _usual_signs(text: str) -> str:
    """`7:00:00,5` with a point, `Mar 1, 2025 7:00` with a space, `2. März 2026` in English, `07.58.00` with colons.

    Also a date in quotes, and `2021/06/12-12:54:51` with a space between date and clock.
    """
    text = re.sub(r"^(\d{1,4}[/.-]\d\d?[/.-]\d{1,4})[-_](?=\d\d?:\d\d)", r"\1 ", text.strip("\"' "))
    text = re.sub(r",(?=\d)", ".", text.translate(_EAST_ASIAN)).replace(",", " ")
    text = re.sub(r"(?<=\d) ?([AaPp])\.?[Mm]\.?$", r" \1M", text)
    text = re.sub(r"(?<=\d) (UTC|GMT|CES?T|MES?Z)$", lambda zone: _ZONES.get(zone[1], "+02:00"), text)
    text = re.sub(r"(:\d\d:\d\d):(\d{1,3})$", r"\1.\2", text)  # `08:00:00:250`, as data loggers write
    text = re.sub(r"(?<= )(\d{1,2})\.(\d\d)\.(\d\d)$", r"\1:\2:\3", text)
    text = re.sub(r"(?<=\d)\.(?= [^\W\d]{3})|(?<=[^\W\d])\.(?= )", "", text)
    return " ".join(re.sub(r"[^\W\d_]{3,}", _month, text).split())


def _month(word: re.Match[str]) -> str:
    return next((name for start, name in _MONTHS.items() if word[0].lower().startswith(start)), word[0])
