"""Several tables below one another on a sheet: blocks with the same header are runs, or the two directions."""

from __future__ import annotations

import re

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, Numbers, Rows, filled_cells, label
from errpipe.importing.units import split_header
from errpipe.importing.words import axis_above, direction_sign_of, direction_word_in, kind_by_name

COMMENT = ("#", "%", "//", ";", "!")
MEAN_WITHIN = 0.02  # of its range: a table is the mean of two others, all rounded
_PAGE = re.compile(  # above the header that a printer repeats: `Page 2 of 3`, `Seite: 2`
    r"(?<![^\W_])(?:page|seite|pagina|pág(?:ina)?|página|strona|str|strana|sida|sayfa|oldal|blatt|стр(?:аница)?|페이지|ページ|页)"
    r"\W{0,3}\d+|第\s?\d+\s?[页頁]|\d+\s?ページ",
    re.IGNORECASE,
)
LONGEST_TITLE = 40  # characters of a line that states a direction and nothing else


def blocks(
    names: list[str], rows: Rows, numbers: Numbers, start: int, notes: list[str], deep: int = 1
) -> tuple[list[str], Rows]:
    """Names and rows up to the header of a second table; blocks below the same header are consecutive runs.

    deep: number of header rows, including units.
    """
    if deep == 1:
        width = len(rows[start - 1])
        rows, numbers = _by_name(rows, numbers, start, notes)
        names[width : len(rows[start - 1])] = map(label, rows[start - 1][width:])
    below = range(start + 1, len(rows) - 1)
    again = [r for r in below if filled_cells(rows[r]) == filled_cells(rows[start - 1])]
    if deep > 1 and all(rows[r - k] == rows[start - 1 - k] for r in again for k in range(deep)):
        upper = {r - k for r in again for k in range(1, deep)}  # the last row of each header starts a block
        kept = [r for r in range(len(rows)) if r not in upper and not start - deep <= r < start - 1]
        titled = [_title(rows, numbers, r - deep + 1) for r in (start - 1, *again)]
        at = {r: i for i, r in enumerate(kept)}
        rows, numbers = [rows[r] for r in kept], [numbers[r] for r in kept]
        again, start = [at[r] for r in again], at[start - 1] + 1
        below = range(start + 1, len(rows) - 1)
    else:
        titled = [_title(rows, numbers, r) for r in (start - 1, *again)]
    starts = [r for r in below if r in again or _starts_table(rows[r], numbers[r], numbers[r + 1 : r + 3])]
    others = [r for r in starts if r not in again and r - 1 not in again]
    other = others[0] if others else None
    if len(others) == 2 and not again and _are_sides_of(rows, numbers, start, *others):
        text = " ".join(map(label, filled_cells(rows[start - 1])))[:60]
        notes.append(
            f"three tables: the first ({text!r}) is the mean of the two below, one for each direction: excluded"
        )
        names, start, other = [*map(label, rows[others[0]])], others[0] + 1, others[1]
    if other is not None and not again and _is_way_back(rows[start - 1], rows[other]):
        width, header = len(names), rows[other]
        notes.append(
            f"a second table below ({' '.join(map(str, filled_cells(header)))[:60]!r}): the return to these targets"
        )
        back = [[row[0], *[None] * (width - 1), *row[1:]] for row in rows[other + 1 :] if row]
        return [*names, *map(label, header[1:])], [*rows[start:other], *back]
    if other is not None and not any(r > other for r in again):
        text = "', '".join(" ".join(map(str, filled_cells(rows[r])))[:60] for r in others)
        tables = "a second table" if len(others) == 1 else f"{len(others)} more tables"
        were, their = ("was", "its") if len(others) == 1 else ("were", "their")
        count = len(rows) - other - len(others)
        notes.append(f"{tables} below ('{text}') {were} excluded with {their} {count} rows")
        rows = rows[:other]
    if not again:
        return names, rows[start:]
    return _repeated(names, rows, numbers, start, again, titled, notes)


def _by_name(rows: Rows, numbers: Numbers, start: int, notes: list[str]) -> tuple[Rows, Numbers]:
    """Rows with their columns where the first header has them, below headers of its names in another order, or more."""
    header = [label(c) for c in rows[start - 1]]
    if len({*header}) < max(2, len(header)) or not all(header):
        return rows, numbers
    at = {r: [label(c) for c in rows[r]] for r in range(start, len(rows)) if not any(v is not None for v in numbers[r])}
    at = {r: cells for r, cells in at.items() if {*header} <= {*cells} and len({*cells}) == len(cells)}
    known = [*dict.fromkeys([*header, *(c for cells in at.values() for c in cells if c)])]
    if all(cells == header for cells in at.values()):
        return rows, numbers
    notes.append("a header below has the names of the first one in another order, or more: columns are put by name")
    out: Rows = [*rows[: start - 1], [*known]]
    of_out, order = numbers[:start], [*range(len(header))]
    for r in range(start, len(rows)):
        order = [at[r].index(c) if c in at[r] else len(at[r]) for c in known] if r in at else order
        out.append([*known] if r in at else [rows[r][i] if i < len(rows[r]) else None for i in order])
        of_out.append([numbers[r][i] if i < len(numbers[r]) else None for i in order])
    return out, of_out


def sections(names: list[str], rows: Rows, first: str, notes: list[str]) -> tuple[list[str], Rows]:
    """Names and rows with the side, and the run, that lines among the rows state for the rows below: `Run 2 reverse`.

    first: the line right above the first row. Raises DataError if rows precede the first line that states a
    side.
    """
    last = max((r for r, row in enumerate(rows) if len(filled_cells(row)) > 1), default=0)  # remarks stand below it
    single = {r: str(cells[0]) for r, row in enumerate(rows[:last]) if len(cells := filled_cells(row)) == 1}
    titles = {
        r: text for r, text in single.items() if len(text) <= LONGEST_TITLE and len(direction_word_in(text) or "") > 1
    }
    if not titles or any(kind_by_name(name) == "direction" or direction_sign_of(name) is not None for name in names):
        return names, rows
    if direction_word_in(first) is None and min(titles) > 0:
        raise DataError(
            f"a line states {titles[min(titles)]!r}, but none states from which side the rows above it were "
            "approached: write the direction of every row in a column"
        )
    title, out, numbered = first, [], all(re.search(r"\d", t) for t in titles.values())
    numbered = numbered and not any(kind_by_name(name) == "run" for name in names)
    for r, row in enumerate(rows):
        title = titles.get(r, title)
        run = re.search(r"\d+", title)
        own: list[Cell] = [direction_word_in(title), *([run.group() if run else "1"] if numbered else [])]
        if r not in titles:
            out.append([*row, *[None] * (len(names) - len(row)), *own])
    notes.append(
        f"lines among the rows state the side of those below ({', '.join(dict.fromkeys(titles.values()))})"[:160]
    )
    return [*names, "direction", *(["run"] if numbered else [])], out


def _repeated(
    names: list[str], rows: Rows, numbers: Numbers, start: int, again: list[int], titles: list[str], notes: list[str]
) -> tuple[list[str], Rows]:
    """Names and rows of blocks below one header, with the axis, run and side that their titles state."""
    axes = [axis_above([title]) or "" for title in titles]
    ways = [direction_sign_of(title) for title in titles]
    several = all(axes) and len(set(axes)) > 1
    sided = None not in ways and len(set(ways)) == 2
    if sided and not several and len(titles) == 2 and all(re.search(r"\d", name) for name in names[1:]):
        notes.append(f"the header occurs twice, below {titles[0]!r} and {titles[1]!r}: forward and return pass")
        back = [[row[0], *[None] * (len(names) - 1), *row[1:]] for row in rows[again[0] + 1 :] if row]
        parts = [(*split_header(n), title) for title in titles for n in names[1:]]  # one column per run
        sides = [f"{n} {title}" + (f" [{unit}]" if unit else "") for n, unit, title in parts]
        return [names[0], *sides], [*rows[start : again[0]], *back]
    labels: dict[str, list[Cell]] = {"axis": [*axes]} if several else {}
    one_each = several and len(set(axes)) == len(axes)
    pages = len({_PAGE.sub("", title) for title in titles}) == 1 and all(map(_PAGE.search, titles[1:]))
    if pages:
        notes.append(f"the header is repeated on {len(titles)} pages: one table")
    if not one_each and not pages and not any(re.search(r"\b(run|lauf)\b", name.lower()) for name in names):
        notes.append(f"the header occurs {len(titles)} times: the rows below each are one run")
        labels["run"] = [float(b + 1) for b in range(len(titles))]
        if sided:
            labels["run"] = [f"{ways[: b + 1].count(ways[b])} {title}" for b, title in enumerate(titles)]
        elif all(titles) and len(set(titles)) == len(titles):
            labels["run"] = [*titles]
    block, out = 0, []
    between = _above_headers(rows, numbers, start, again)
    for r, row in enumerate(rows[start:], start):
        block += r in again
        if r not in again and r not in between:
            own = [of_block[block] for of_block in labels.values()]
            out.append([*row, *[None] * (len(names) - len(row)), *own] if labels else row)
    return [*names, *labels], out


def _above_headers(rows: Rows, numbers: Numbers, start: int, again: list[int]) -> set[int]:
    """Rows that belong to the next header, with its preamble in the first column (`Delta_X;60;60`)."""
    out: set[int] = set()
    for r in again if numbers[start] and numbers[start][0] is not None else []:
        while r - 1 > start and rows[r - 1] and numbers[r - 1][0] is None and rows[r - 1][0] not in (None, ""):
            r -= 1
            out.add(r)
    return out


def _title(rows: Rows, numbers: Numbers, header: int) -> str:
    """The words right above a header, or nothing if a row of data precedes it."""
    title = " ".join(map(label, filled_cells(rows[header - 1]))) if header else ""
    data = header > 0 and sum(v is not None for v in numbers[header - 1]) > 1
    return "" if data and not _PAGE.search(title) else title


def _is_way_back(header: list[Cell], other: list[Cell]) -> bool:
    """Whether two tables have the same first column and one direction each: `Forward 1`, below `Reverse 1`."""
    ways = [{direction_sign_of(label(c)) for c in filled_cells(row[1:])} for row in (header, other) if row]
    return header[:1] == other[:1] and sorted(map(str, ways)) == ["{-1.0}", "{1.0}"]


def _are_sides_of(rows: Rows, numbers: Numbers, start: int, first: int, second: int) -> bool:
    """Whether of three tables with two columns the last two are one for each direction, and the first their mean."""
    parts = [[v[:2] for v in numbers[a:b] if v and v[0] is not None] for a, b in ((start, first), (first, second))]
    parts.append([v[:2] for v in numbers[second:] if v and v[0] is not None])
    whole = all(len(v) == 2 and v[1] is not None for part in parts for v in part)
    if (
        not whole
        or not _is_way_back(rows[first], rows[second])
        or direction_sign_of(" ".join(map(label, rows[start - 1])))
    ):
        return False
    tables = [{at: float(value or 0.0) for at, value in part} for part in parts]
    if not tables[0] or len({frozenset(table) for table in tables}) > 1:
        return False
    mean, up, down = tables
    span = max(mean.values()) - min(mean.values())
    return all(abs(mean[at] - (up[at] + down[at]) / 2) <= MEAN_WITHIN * span for at in mean)


def _starts_table(row: list[Cell], numbers: list[float | None], below: Numbers) -> bool:
    """Whether a row consists of at least two words, with numbers in the rows below."""
    words = [c for c in row if isinstance(c, str) and any(map(str.isalpha, c))]
    plain = len(words) >= 2 and not any(v is not None for v in numbers)
    marked = label((filled_cells(row) or [None])[0]).startswith(COMMENT)
    remark = marked and len(words) < max(map(len, below), default=0)
    return plain and not remark and any(sum(v is not None for v in row) >= 2 for row in below)
