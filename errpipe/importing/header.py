"""The rows of a table that name its columns: words, groups above them, units below; and comments among them."""

from __future__ import annotations

import re
from itertools import pairwise

import numpy as np

from errpipe.importing.blocks import COMMENT
from errpipe.importing.sheet import Cell, Numbers, Rows, Sheet, filled_cells, label, number
from errpipe.importing.units import split_header, unit_of
from errpipe.importing.units_above import UNITS
from errpipe.importing.words import direction_word_in, is_correction, kind_by_name, plain

DEEPEST_LEGEND = 200  # rows of a legend, and of a sheet above its data: the longest known preamble has 60
NUMBER_AND_UNIT = re.compile(r"\s*([+\-−–]?[\d.,'’]*\d)\s*([^\d\s.,+\-][^\s]{0,8})\s*")
_CHANNEL = re.compile(r"[^\W\d_]{0,8}\W?\d[\d-]*")  # `CH1`, `AI-03`
_KEY = re.compile(
    r"(?:signal|tag|var|variable|channel|kanal|sensor|point|item|metadata|series|field|node)[ -]?(?:id|nr|no|key)?\.?"
)
_LABELS = re.compile(r"(?:comment|kommentar|tag|label|(?:signal|channel|kanal)?[ _-]?name)s?", re.IGNORECASE)
_WORD = re.compile(
    r"(?!(n/?a|nan|null|none|#n/a|#?wert!?|ol|---?|open|burn ?out|over ?(range|flow)|no ?sensor)$).*[^\W\d_]",
    re.IGNORECASE,
)  # not a missing value
_MOMENT = re.compile(
    r"(?=.*\d:\d|.*\d[./-]\d+[./-]\d)\d[\d.:/\-T ,+Z]*( ?[AaPp]\.?[Mm]\.?)?"
    r"|\d{1,2}[-. ]{1,2}[^\W\d_]{3,9}[-. ]{1,2}\d{2,4}( \d.*)?"
)
_DATE_FORM = re.compile(
    r"[yY]{2,4}[./-][mM]{1,2}[./-][dD]{1,2}|[dD]{1,2}[./-][mM]{1,2}[./-][yY]{2,4}|[hH]{1,2}:[mM]{2}(:[sS]{2})?|NO\."
)

FACTS = {
    "machine": r"machine|maschine",
    "serial_number": r"serial(?: ?(?:no|number))?|serien ?nr|seriennummer|s/n",
    "operator": r"operator|bediener|pr[üu]fer|inspector",
    "date": r"date|datum",
    "instrument": r"instrument|messger[äa]t|laser",
}
OF_A_FACT = "|".join(("axis|achse|axe|asse|eje|soft|program|title|titel|test|company|firma", *FACTS.values()))


def is_word(cell: Cell) -> bool:
    """Whether a cell is a word other than those for a missing value."""
    return isinstance(cell, str) and _WORD.match(cell) is not None and not is_moment(cell)


def is_moment(cell: Cell) -> bool:
    """Whether a cell is a numeric date or clock time."""
    return isinstance(cell, str) and _MOMENT.fullmatch(cell.strip()) is not None


def is_header(row: list[Cell], numbers: Numbers, r: int) -> bool:
    """A row with a word above a column of numbers is a header even if its other cells are numbers (run 1, 2, 3)."""
    below = numbers[r + 1 : r + 6]
    alone = len(filled_cells(row)) == 1 and max((sum(v is not None for v in b) for b in below), default=0) > 1
    for c, cell in enumerate([] if alone else row):
        word = isinstance(cell, str) and _WORD.match(cell) is not None and numbers[r][c] is None
        if word and below and sum(len(b) > c and b[c] is not None for b in below) >= 0.8 * len(below):
            return True
    return _counts_runs(row, numbers, r, r + 1)


def _counts_runs(row: list[Cell], numbers: Numbers, r: int, start: int) -> bool:
    """A row of run numbers: `Target;1;2;3;Mean`, or `;1;2;3;1;2;3` below names of groups.

    start: row of the first data.
    """
    counts, below = [v for v in numbers[r] if v is not None], numbers[start : start + 5]
    titled = bool(row) and is_word(row[0])
    if not row or not (titled or row[0] in (None, "")) or not below or not all(b and b[0] is not None for b in below):
        return False
    if len(counts) < 2 or (not titled and (len(counts) < len(filled_cells(row)) or r == 0 or any(numbers[r - 1]))):
        return False
    return counts[0] == 1 and all(b in (a, a + 1, 1) for a, b in pairwise(counts))


def lift_comments(rows: Rows, numbers: Numbers, start: int) -> None:
    """Move comments between a header and its data above the header, in place. start: row of the first data."""
    head = start - 1
    while head > 0 and _is_comment(rows[head], numbers[head], len(filled_cells(rows[start]))):
        head -= 1
    texts = [label(c) for c in filled_cells(rows[head])]
    wide = len(texts) >= max(2, 0.6 * len(filled_cells(rows[start])))
    if head == start - 1 or not wide or any(v is not None for v in numbers[head]) or texts[0].startswith(COMMENT):
        return
    top = head
    if _are_units([label(c) for c in rows[head]]):  # the names are above it
        top -= head > 0 and sum(map(is_word, rows[head - 1])) >= 2 and not any(v is not None for v in numbers[head - 1])
    for table in (rows, numbers):
        table[top:start] = [*table[head + 1 : start], *table[top : head + 1]]


def _is_comment(row: list[Cell], numbers: list[float | None], width: int) -> bool:
    """Whether a row is a comment: it starts with a comment mark, or is text in few of the columns without a unit.

    width: filled cells of a row of data. An event of a log has a comma as well: `INFO: SETTLING, started`.
    """
    texts = [label(c) for c in filled_cells(row)]
    alone = len(texts) <= max(1, width // 3) and not any(v is not None for v in numbers)
    return bool(texts) and (texts[0].startswith(COMMENT) or alone) and not _are_units(texts)


def header_rows(rows: Rows, numbers: Numbers, start: int) -> list[int]:
    """Up to three rows right above the data that are a header: at least two words, or as `is_header` decides."""
    found: list[int] = []
    for r in range(start - 1, max(start - 4, -1), -1):
        if found and label(rows[r][0] if rows[r] else None).startswith(("#", "%", "//")):
            break  # a comment above the header
        if found and r and len(_channel_names(rows[r - 1 : r + 1])) > 1:
            break  # a list of channels above the header
        words = [c for c in rows[r] if isinstance(c, str) and c]
        figures = sum(v is not None for v in numbers[r])
        above_units = all(_are_units([label(c) for c in rows[k]]) for k in found)  # or there are none
        named = above_units and _counts_runs(rows[r], numbers, r, start)
        named = named or (not found and bool(words) and is_header(rows[r], numbers, r))
        if (len(words) >= 2 and figures == 0) or named:
            found.insert(0, r)
        else:
            break
    return found


def names_of(rows: Rows, head: list[int], width: int) -> tuple[list[str], list[str | None], int]:
    """Header texts, units, and the number of rows used."""
    if not head:
        return [f"column {i + 1}" for i in range(width)], [None] * width, 0
    texts = [[label(c) for c in rows[r]] + [""] * width for r in head]
    units: list[str | None] = [None] * width
    used = len(head)
    if len(texts) > 1:
        of_units = next((k for k in range(len(texts) - 1, 0, -1) if _are_units(texts[k][:width])), None)
        if of_units is not None:
            units = [unit_of(t.strip("[]() ")) if t else None for t in texts.pop(of_units)[:width]]
    whole = [len({*t[:width]}) == width and all(split_header(n)[1] for n in t[:width]) for t in texts]
    if sum(whole) == 1 and not any(units) and _of_devices(texts[whole.index(True) + 1 :]):
        used -= whole.index(True)
        texts = [texts[whole.index(True)]]
    if len(texts) > 2:  # more than a group row above the names: the rest is a preamble
        used -= len(texts) - 2
        texts = texts[-2:]
    if len(texts) == 2:
        filled = sum(bool(t) for t in texts[0][:width])
        title = filled < 0.34 * width and not any(texts[0][1:width])
        fact = filled <= 2 and any(map(_is_amount, texts[0]))
        if title or fact or _are_positions(texts[1]) or _is_preamble(texts[0], texts[1][:width]):
            used -= 1
            texts = texts[-1:]
    if len(texts) == 2:
        last = ""
        group = []
        for text in texts[0][:width]:
            last = text or last
            group.append(last)
        names = [f"{g} {n}".strip() if g != n else n for g, n in zip(group, texts[1][:width], strict=True)]
    else:
        names = texts[0][:width]
    return [n or f"column {i + 1}" for i, n in enumerate(names)], units, used


def _of_devices(rows: list[list[str]]) -> bool:
    """Whether rows below complete names hold devices and, at last, starting times, but no quantity, side or sign."""
    starts = [t for t in rows[-1][1:] if t] if rows else []
    others = [t for row in rows[:-1] for t in row if t]
    states = any(kind_by_name(t) or len(direction_word_in(t) or "") > 1 or is_correction(t) for t in others)
    return bool(starts) and all(map(is_moment, starts)) and not states


def _are_units(texts: list[str]) -> bool:
    """Whether all cells are units; the first may say so: `Unit;s;µm`."""
    named = [t for k, t in enumerate(texts) if t and (k or not UNITS.fullmatch(t.strip(" :")))]
    cells = [t.strip("[]() ") for t in named]
    known = [unit_of(c) or c in ("-", "1", "#", "–", "—") or _DATE_FORM.fullmatch(c) for c in cells]
    return any(map(unit_of, cells)) and all(known)


def named_above(names: list[str], above: Rows) -> list[str]:
    """Channel names from the lines above: `CH1` below `CH1,Spindle,TEMP`; unchanged if two would be equal.

    Or from a row of labels over all columns: `Comment,X target,X deviation` above `Time,U1-1[mm],U1-2[um]`.
    """
    labels = next((r for r in above if len(r) == len(names) > 2 and _LABELS.fullmatch(label(r[0]))), [])
    if labels and all(map(is_word, labels)) and len({*labels}) == len(labels):
        units = [split_header(n)[1] for n in names]
        return [names[0], *(f"{c} [{u}]" if u else str(c) for c, u in zip(labels[1:], units[1:], strict=True))]
    called = _channel_names(above)
    bare = [split_header(n)[0] for n in names]
    numbered = [n for n in bare if n in called]
    unique = len({called[n] for n in numbered}) == len(numbered) > 1
    return [
        n.replace(b, _with_channel(b, split_header(called[b])[0] if n != b else called[b]), 1)
        if unique and b in numbered
        else n
        for n, b in zip(names, bare, strict=True)
    ]


def _channel_names(rows: Rows) -> dict[str, str]:
    """The names, with their units, that rows give to channels: `CH1 | Bearing | degC`."""
    labels = [[label(c) for c in filled_cells(row)] for row in rows]
    return {
        row[0]: row[1] + (f" [{row[2]}]" if len(row) > 2 and unit_of(row[2]) else "")
        for row in labels
        if len(row) > 1 and _CHANNEL.fullmatch(row[0]) and is_word(row[1])
    }


def _with_channel(channel: str, name: str) -> str:
    """`CH1 Bearing`; the name alone if the channel is but a number, which would be read as that of a run."""
    return name if channel.isdigit() else f"{channel} {name}"


def is_legend(sheet: Sheet) -> bool:
    """Whether a sheet lists channels with their names and units, and nothing else below its header."""
    called = _channel_names(sheet.rows)
    return len(called) >= max(2, len(sheet.rows) - 1) and all(name.endswith("]") for name in called.values())


def with_legend(sheets: list[Sheet]) -> list[Sheet]:
    """The sheets with the names and units that a legend sheet assigns to channels of another: `CH1 | Bearing | degC`.

    A legend has a row for each of at least two cells of a header, the channel first. It is kept among the sheets.
    """
    for legend in sheets if len(sheets) > 1 else []:
        called = _channel_names(legend.rows)
        for sheet in (s for s in sheets if s is not legend):
            _name_signals(sheet, legend, called)
            heads = [row for row in sheet.rows[:DEEPEST_LEGEND] if sum(label(c) in called for c in row) > 1]
            if sheet.header is None and len(heads) == 1 and len(called) < DEEPEST_LEGEND:
                at = next(r for r, row in enumerate(sheet.rows) if row is heads[0])
                sheet.rows[at] = [_with_channel(n, called[n]) if (n := label(c)) in called else c for c in heads[0]]
                sheet.notes.append(f"the sheet {legend.name!r} names the channels")
    return sheets


def _name_signals(sheet: Sheet, legend: Sheet, called: dict[str, str]) -> None:
    """Replace the numbers of signals (`tag_id`) in rows of one value each by their names in a legend, in place."""
    body = sheet.rows if sheet.header is not None else sheet.rows[1:]
    header = [plain(label(c)) for c in (sheet.header or (sheet.rows[0] if sheet.rows else []))]
    for i in [i for i, text in enumerate(header) if _KEY.fullmatch(text)]:
        keys = {label(row[i]) for row in body if len(row) > i and row[i] is not None}
        if 1 < len(keys) < len(body) / 2 and keys <= called.keys() and len(legend.rows) < len(body):
            for row in [row for row in body if len(row) > i]:
                row[i] = called.get(label(row[i]), row[i])
            (sheet.header or sheet.rows[0])[i] = "tag"
            sheet.notes.append(f"the sheet {legend.name!r} names the signals of the column {header[i]!r}")


def with_metres(names: list[str]) -> list[str]:
    """`x_m` as `x [m]` if another header ends likewise, or if it is a target: alone it may be a measured x."""
    found = {n: m for n in names if (m := re.fullmatch(r"(.*\w)(?:[_ ]|( ?/ ?|, ))m", n))}  # `x / m`: not per metre
    targets = any(kind_by_name(m[1]) in ("command", "position") for m in found.values())
    ending = [n for n in found if targets or not found[n][2]]
    bare = any("[" not in n and "(" not in n and split_header(n)[1] for n in names)  # `Deviation um` next to it
    metres = ending if len(ending) > 1 else [n for n in ending if bare and kind_by_name(found[n][1]) == "command"]
    return [f"{found[n][1]} [m]" if n in metres else n for n in names]


def _is_preamble(group: list[str], names: list[str]) -> bool:
    """Whether a row above the names is a fact (`Machine;VMC 3`), not a group of columns."""
    cells = [i for i, text in enumerate(group) if text]
    words = [n for n in names if n]
    complete = len(set(words)) == len(words) and all(_WORD.match(n) for n in words)
    named = len(words) > 2 or re.match(OF_A_FACT, group[0], re.IGNORECASE) is not None
    return complete and named and cells in ([0], [0, 1])


def _is_amount(text: str) -> bool:
    """Whether a cell above the names is a fact, a number with its unit: `100,000 mm`."""
    match = NUMBER_AND_UNIT.fullmatch(text)
    return match is not None and unit_of(match.group(2)) is not None


def _are_positions(header: list[str]) -> bool:
    """Whether the names of most columns are increasing or decreasing numbers, not a count: a column per target."""
    values = [v for text in header if text and (v := number(text, "," in text)) is not None]
    steps = np.diff(values)
    counted = np.array_equal(values, 1.0 + np.arange(len(values)))
    return len(values) > 3 and not counted and bool((steps > 0).all() or (steps < 0).all())


def facts(above: list[str]) -> dict[str, str]:
    """Facts on the set-up from the lines above a table: `Maschine: VMC 3`."""
    found: dict[str, str] = {}
    for line in above:
        for name, words in FACTS.items():
            match = re.match(rf"\s*(?:{words})\b\.?\s*[:=;,]?\s+(\S.{{0,80}})$", line, re.IGNORECASE)
            if match and name not in found:
                found[name] = match.group(1).strip()
    return found
