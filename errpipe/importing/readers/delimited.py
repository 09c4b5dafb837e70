"""Delimited text: CSV and similar formats of spreadsheets, lasers, loggers and scripts.

Encodings UTF-8 (with or without a byte order mark), UTF-16, Windows-1252 and those of Japan, China, Korea and Russia;
separators semicolon, tab, comma, bar or runs of blanks; decimal points or commas; any number of lines above the header.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

from errpipe.errors import DataError, UsageError
from errpipe.importing.header import is_word
from errpipe.importing.sheet import INVISIBLE, Cell, ReaderOptions, Rows, Sheet, affordable, number
from errpipe.importing.units import unit_of

name = "delimited text"
suffixes = (".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".prn", ".lvm", ".xls")

SEPARATORS = (";", "\t", "|", ",")
LONGEST_LINE = 1 << 16  # characters: with a longer line a file is not a table
ENCODINGS = {
    "utf-8-sig": "UTF-8",
    "cp1252": "Windows-1252",
    "cp932": "Shift JIS",
    "cp1251": "Windows-1251",
    "cp1250": "Windows-1250",
}
MOST_LINES_OF_A_CELL = 20  # with more, its quote is a sign of inches
_QUOTED = r'(?:(?<=^)|(?<=[;,\t|]))\s?"(?:[^"]|"")*"(?=\s*(?:[;,\t|]|$))'
_OPEN = re.compile(rf'^((?:{_QUOTED}|[^"])*(?:(?<=^)|(?<=[;,\t|]))\s?)"((?:[^"]|"")*)$')
_STAMP = re.compile(r'(?<=,)"?(\d\d?/\d\d?/\d{4});(\d\d?:\d\d:\d\d);(\d{3})"?(?=,)')  # of a Rockwell trend
_METRICS = ("HELP", "TYPE", "UNIT")  # comments of Prometheus on a metric
SAMPLE_LINES = 400  # lines from which the dialect is inferred


def sniff(path: Path, head: bytes) -> bool:
    """Whether the first bytes are text in one of the encodings."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE, codecs.BOM_UTF8)):
        return True
    head = _without_padding(head)
    if b"\0" in head:
        return _wide(head) is not None
    control = sum(byte < 9 or 13 < byte < 32 for byte in head)
    return control <= len(head) // 200


def _without_padding(data: bytes) -> bytes:
    """Text without the zeros with which controllers fill a file of a fixed length; zeros alone are no text."""
    text = data.rstrip(b"\0")
    return text if text and b"\0" not in text[: 1 << 14] else data


def _wide(head: bytes) -> str | None:
    """UTF-16 without a byte order mark: every second byte of Latin text is zero."""
    even, odd = head[0::2].count(0), head[1::2].count(0)
    if odd > 0.4 * len(head) / 2 and even < 0.05 * len(head):
        return "utf-16-le"
    return "utf-16-be" if even > 0.4 * len(head) / 2 and odd < 0.05 * len(head) else None


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The cells of a text file. Raises DataError if it is not a table."""
    if options.sheet is not None:
        raise UsageError(f"{path}: a text is one table: --sheet would be ignored")
    whole = path.read_bytes()
    data = _without_padding(whole)
    affordable(data.count(b"\n") + data.count(b"\r"), path)
    encoding, text = _decode(path, data)
    text = _STAMP.sub(r"\1 \2.\3", INVISIBLE.sub("", text))
    lines = _whole_lines(text.splitlines())
    if any(len(line) > LONGEST_LINE for line in lines[:SAMPLE_LINES]):
        raise DataError(f"{path}: a line of more than {LONGEST_LINE} characters (no table of measurements)")
    separator = _separator(lines[:SAMPLE_LINES])
    if separator == ",":
        lines = _with_prose_quoted(lines)
    if separator == " " and _quotes_words(lines[:SAMPLE_LINES]):
        quoted = csv.reader(lines, delimiter=" ", skipinitialspace=True)
        cells: Iterable[list[Cell]] = ([word or None for word in row] for row in quoted)
    elif separator == " ":
        cells = _by_blanks(path, lines)
    else:
        cells = (
            [(text if text[:1] != "=" else _without_formula(text)) or None for text in map(str.strip, row)]
            for row in csv.reader(lines, delimiter=separator)
        )
    try:
        rows = _bounded(cells, path)
    except csv.Error as err:
        raise DataError(f"{path}: not a table: {err}") from None
    _name_column_of_row_names(rows)
    if separator != " ":
        _refuse_short_rows(path, rows)
    if separator == ",":
        _refuse_torn_numbers(path, rows)
    zeros = len(whole) - len(data)
    notes = [f"{zeros} bytes of zeros at its end were ignored, {CUT_OFF}"] if zeros else []
    if separator != " " and not text.endswith(("\n", "\r")):
        notes += _without_torn_row(rows)
    words = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}[separator]
    return [Sheet(path.stem, rows, notes=[f"text in {encoding}, separated by {words}", *notes]).limited()]


def _quotes_words(lines: list[str]) -> bool:
    """Whether the lines separate words in quotes by single blanks, as `write.table` of R does."""
    filled = [line for line in lines if line.strip()]
    return bool(filled) and all(re.fullmatch(r'("[^"]*"|[^\s"]+)( ("[^"]*"|[^\s"]+))+', x) and '"' in x for x in filled)


def _name_column_of_row_names(rows: Rows) -> None:
    """Name the first column, in place, if R wrote its row names 1, 2, 3 ... and no name above them."""
    width = len(rows[0]) + 1 if rows else 0
    if width < 3 or len(rows) < MIN_WHOLE_ROWS or any(map(_figure, rows[0])):
        return
    of_r = all(len(row) == width and row[0] == str(r) for r, row in enumerate(rows[1:], start=1))
    if of_r and any(row[-1] is not None for row in rows[1:]):  # else a separator ends each row but the first
        rows[0].insert(0, "No.")


def _by_blanks(path: Path, lines: list[str]) -> Iterator[list[Cell]]:
    """Cells separated by blanks. Raises DataError if a row of numbers lacks one: its column is unknown.

    Names may contain blanks (`Soll [mm]`): then two blanks or a bracket separate them, or they are a line of text.
    """
    sample = [line.split() for line in lines[:SAMPLE_LINES]]
    figures = [sum(map(_figure, row)) for row in sample]
    full = Counter(len(row) for row, n in zip(sample, figures, strict=True) if n >= max(2, 0.5 * len(row)))
    width = full.most_common(1)[0][0] if full else 0
    first = next((r for r, n in enumerate(figures) if n >= 2 and len(sample[r]) == width), 0)
    for r, line in enumerate(lines):
        row: list[Cell] = [*line.split()]
        if r < first and len(row) == width + 1 and re.fullmatch(r"[#%;!]+|//", str(row[0])) and row[1] not in _METRICS:
            row = row[1:]  # names after a comment mark
        if len(row) != width > 1 < len(row):
            if r > first and all(map(_figure, row)):
                raise DataError(f"{path}:{r + 1}  {len(row)} numbers, not {width}: a gap between blanks has no column")
            above = r < first or line in lines[:first]  # also where the header stands again
            named = _names_with_blanks(line, width) if above else []
            if above and (not any(map(_figure, row)) or (len(named) == width and all(map(is_word, named)))):
                row = named
        yield row


def _whole_lines(lines: list[str]) -> list[str]:
    """The lines, with a cell in quotes on one line if it was broken: `"Target` above `(mm)";"Error"`.

    A quote that nothing closes is a sign of inches: it is quoted itself.
    """
    out, r = list[str](), 0
    while r < len(lines):
        text, last = lines[r], r
        while (opened := _opened(text)) and last + 1 < min(r + MOST_LINES_OF_A_CELL, len(lines)):
            last += 1
            text += f" {lines[last]}"
        if opened and (alone := _opened(lines[r])):
            text, last = f'{alone[1]}"""{alone[2]}"', r
        out.append(text)
        r = last + 1
    return out


def _opened(line: str) -> re.Match[str] | None:
    return _OPEN.search(line) if '"' in line else None


def _with_prose_quoted(lines: list[str]) -> list[str]:
    """Lines above a header as one cell each if blanks follow all their commas, and none of those of the table."""
    first = next((r for r, line in enumerate(lines) if sum(map(_figure, line.split(","))) > 1), 0)
    cells = [[cell.strip(' "[]()') for cell in line.split(",") if cell.strip()] for line in lines[:first]]
    head = next((r for r in range(first - 1, 0, -1) if "," in lines[r] and not all(map(unit_of, cells[r]))), 0)
    if not head or any(", " in line for line in lines[head : first + 1]):
        return lines
    prose = [re.search(r",\s", line) and not re.search(r',\S|"', line.strip().rstrip(",")) for line in lines[:head]]
    return ['"' + line + '"' if of_words else line for line, of_words in zip(lines, prose, strict=False)] + lines[head:]


CUT_OFF = "check that the file was copied to its end"
MIN_WHOLE_ROWS = 3  # rows of numbers of one length, by which a shorter last one is known as torn (by judgement)
MOST_SHORT = 0.1  # share of the rows of numbers; above it, short rows are a layout


def _refuse_short_rows(path: Path, rows: Rows) -> None:
    """Raise DataError if a row of numbers between full ones lacks a cell: its numbers may be in other columns."""
    width, full = (Counter(n for n in map(len, rows) if n > 2).most_common(1) or [(0, 0)])[0]
    filled = [r for r, row in enumerate(rows) if any(row)]
    around = zip(filled, filled[1:], filled[2:], strict=False)
    between = [near for near in around if [len(rows[i]) == width for i in near] == [True, False, True]]
    short = [near for near in between if 1 < len(rows[near[1]]) < width]
    if len(short) > max(1.0, MOST_SHORT * full):
        return
    for r in (near[1] for near in short if all(sum(map(_figure, rows[i])) > 1 for i in near)):
        raise DataError(
            f"{path}:{r + 1}  {len(rows[r])} cells, {width} in the rows around it: which one is missing? (write it "
            "empty, with its separator)"
        )


def _without_torn_row(rows: Rows) -> list[str]:
    """Remove a last row that begins like the row above but ends early, unlike all others of numbers; a note on it."""
    of_numbers = [row for row in rows[:-1] if sum(map(_figure, row)) > 1]
    if len(of_numbers) < MIN_WHOLE_ROWS or len({*map(len, of_numbers)}) > 1:
        return []
    above, last = of_numbers[-1], rows[-1]
    begun = all(_figure(a) == _figure(b) for a, b in zip(above, last[:-1], strict=False))
    if not 0 < len(last) < len(above) or not begun or not re.match(r"[\d.,+-]", str(last[0] or "")):
        return []
    rows.pop()
    found = f"line {len(rows) + 1} has {len(last)} of {len(above)} cells and no end of line: the row was excluded"
    return [f"{found}, {CUT_OFF}"]


def _refuse_torn_numbers(path: Path, rows: Rows) -> None:
    """Raise DataError if commas are decimal marks and separators: rows of whole numbers, longer than the header."""
    figures = [sum(map(_figure, row)) for row in rows]
    first = next((r for r, n in enumerate(figures) if n >= 2), 0)
    header = [c for c in rows[first - 1] if c] if first else []
    longer = [row for row, n in zip(rows, figures, strict=True) if n >= 2 and sum(map(bool, row)) > len(header)]
    if len(header) < 2 or len(longer) < 0.5 * sum(n >= 2 for n in figures) or figures[first - 1]:
        return
    if not any("." in str(c) for row in longer for c in row if c):
        raise DataError(
            f"{path}: the header has {len(header)} columns and the rows {max(map(len, longer))}, without a decimal "
            "point: are commas decimal marks and separators? Write decimal points, or another separator"
        )


def _without_formula(text: str) -> str:
    """`="12,5"`, a number that a spreadsheet stores as text, without the formula."""
    return re.sub(r"^=(\"?)(.*)\1$", r"\2", text)


def _figure(word: Cell) -> bool:
    return number(word, comma=True) is not None or number(word, comma=False) is not None


def _names_with_blanks(line: str, width: int) -> list[Cell]:
    apart = [w for w in re.split(r"\s{2,}|\t", line.strip()) if w]
    last = apart[-1].strip("[]() ") if len(apart) == width + 1 else ""
    if unit_of(last):  # of all readings, behind their names: `Target(mm)  Run 1  Run 2  (um)`
        apart = [n if re.search(r"[\[(]", n) else f"{n} [{last}]" for n in apart[:-1]]
    joined = [w.replace("\0", " ") for w in re.sub(r"\s+(?=[\[(])", "\0", line).split()]
    return [*next((parts for parts in (joined, apart) if len(parts) == width), [line.strip()])]


def _bounded(cells: Iterable[list[Cell]], path: Path) -> Rows:
    """The rows, limited to a reasonable amount of memory."""
    rows, count = [], 0
    for row in cells:
        count += len(row)
        affordable(count, path)
        rows.append(row)
    return rows


def _decode(path: Path, data: bytes) -> tuple[str, str]:
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        candidates = ["utf-16"]
    elif (wide := _wide(data[: 1 << 14])) is not None and b"\0" in data[: 1 << 14]:
        candidates = [wide]
    else:
        head = data[: 1 << 16]
        candidates = ["utf-8-sig", *(_cyrillic(head) or _east_asian(head) or _central(head)), "cp1252", "latin-1"]
    for encoding in candidates:
        try:
            return ENCODINGS.get(encoding, encoding), data.decode(encoding)
        except UnicodeDecodeError:
            continue
    raise DataError(f"{path}: not text (tried {', '.join(candidates)})")


def _central(head: bytes) -> list[str]:
    """Windows-1250 if Western letters would be signs within words: `Odchy³ka`, `w ty³`."""
    text = head.decode("cp1252", errors="replace")
    within = re.search(r"(?<=[A-Za-z])[³¹¿¼¾](?=[a-z³¹¿¼¾])|(?<=[a-z]{3})³|\bOœ\b|œæ", text)
    return ["cp1250"] if within else []


FEWEST_CYRILLIC = 0.8  # of the bytes beyond ASCII in Russian words; the rest are signs such as ° and µ
FEWEST_HANGUL = 0.9  # of the letters beyond ASCII; Chinese read as Korean shows many Chinese letters


def _cyrillic(head: bytes) -> list[str]:
    """The Cyrillic encoding in which the bytes beyond ASCII are words: one script, capitals only at the start."""
    beyond = sum(byte > 127 for byte in head)
    for encoding in ("cp1251", "koi8-r", "cp866"):
        words = re.findall(r"[^\W\d_]+", head.decode(encoding, errors="replace"))
        letters = sum(len(w) for w in words if re.fullmatch(r"[А-ЯЁ]?[а-яё]{2,}|[А-ЯЁ]{3,}", w))
        if letters >= max(6, FEWEST_CYRILLIC * beyond):
            return [encoding]
    return []


def _east_asian(head: bytes) -> list[str]:
    """Two-byte encodings, if the bytes beyond ASCII occur in pairs, which is rare in European text.

    Chinese decoded as Japanese contains half-width katakana, which are rare in Japanese files.
    """
    letters = [c for c in head.decode("euc_kr", errors="replace") if c > "\x7f"]
    if len(letters) > 3 and sum("가" <= c <= "힣" for c in letters) >= FEWEST_HANGUL * len(letters):
        return ["cp949"]
    if 2 * len(re.findall(rb"[a-z][\xc0-\xfe]{2}[a-z\s]", head)) > len(re.findall(rb"[\x81-\xfe]{2,}", head)):
        return []  # accented letters within words: `Dire\xe7\xe3o`
    pairs = b"".join(re.findall(rb"[\x81-\xfe][\x80-\xfe](?:[\x81-\xfe][\x40-\xfe])*", head))
    if sum(byte > 127 for byte in pairs) < 0.7 * sum(byte > 127 for byte in head):
        return []
    text = head.decode("cp932", errors="replace")
    unusual = sum("\uff61" <= c <= "\uff9f" or c == "\ufffd" for c in text)
    return ["gb18030"] if unusual > 0.1 * sum(c > "\x7f" for c in text) else ["cp932", "gb18030"]


def _separator(lines: list[str]) -> str:
    """The separator that splits most lines into the same number of parts (at least two)."""
    best, most = " ", 0
    filled = [re.sub(_QUOTED, "", line) for line in lines if line.strip()]
    for separator in SEPARATORS:
        counts = Counter(line.count(separator) for line in filled)
        counts.pop(0, None)
        if not counts:
            continue
        width = counts.most_common(1)[0][0]
        agree = sum(n for w, n in counts.items() if abs(w - width) <= 1)
        if separator == "," and _commas_are_decimal(filled):
            continue
        all_lines = agree == len(filled) > most  # also the header: `;` may occur within cells (`ns=2;s=Axis.X`)
        if (agree > 1.05 * most or all_lines) and agree >= 0.3 * len(filled):
            best, most = separator, agree
    return best


def _commas_are_decimal(lines: list[str]) -> bool:
    """Whether commas are inside numbers and blanks between them: `1,5  2,25`, `1  +  0,5  2,25`."""
    marked = [[word for word in line.split() if "," in word] for line in lines]
    decimal = sum(len(w) > 1 and all(re.fullmatch(r"[+-]?\d+,\d+", word) for word in w) for w in marked)
    return decimal > 0.5 * len(lines)
