"""Tables of HTML pages (also if named .xls), and records of XML: control traces, workbooks of Excel 2003.

Consecutive elements of one name are the rows of a sheet, their attributes and nested elements its cells.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

from errpipe.errors import DataError
from errpipe.importing.readers._xml import root_of
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, affordable
from errpipe.importing.units import unit_of

name = "XML or HTML"
suffixes = (".xml", ".html", ".htm", ".xls")
FEWEST = 3  # records
MOST_LINES = 60  # of text next to a table
LONGEST_LINE = 200
MOST_SHEETS = 32  # the largest groups of records; smaller ones are settings
NEAREST = 8  # enclosing elements of records whose name may be that of the sheet
MOST_SPAN = 64  # columns of one cell
_CALLED = ("description", "label", "title", "name")  # attributes that name a column, or a table


def sniff(path: Path, head: bytes) -> bool:
    """Text that starts like XML or HTML."""
    return _beginning(head).startswith((b"<?xml", b"<html", b"<!doctype html", b"<table", b"<head", b"<body"))


def _beginning(data: bytes) -> bytes:
    """The first bytes in lower case, without byte order mark, blanks, and the zeros of UTF-16."""
    return data[:4096].lstrip(b"\xef\xbb\xbf\xff\xfe").replace(b"\0", b"").lstrip().lower()


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """Every table. Raises DataError."""
    data = path.read_bytes()
    if b"<html" in _beginning(data) or not _beginning(data).startswith(b"<?xml"):
        sheets = _of_html(path, data)
    else:
        sheets = _of_xml(path, data)
    if not sheets:
        raise DataError(f"{path}: XML or HTML without a table or {FEWEST} records of one kind: export it as CSV")
    return [s.limited() for s in sheets if options.sheet in (None, s.name)]


class _Tables(HTMLParser):
    """The tables of a page, and the lines of text before each."""

    def __init__(self, path: Path):
        super().__init__()
        self.path, self.sheets, self.lines, self.text = path, list[Sheet](), list[str](), ""
        self.rows: list[list[Cell]] | None = None
        self.span, self.open = 1, False

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag in ("td", "th", "tr"):  # also if the page omits the end tag of the previous cell
            self._end_cell()
        if tag in ("td", "th"):
            self.open = True
            span = dict(attrs).get("colspan") or "1"
            self.span = min(int(span), MOST_SPAN) if span.isdecimal() else 1
        elif tag == "tr" and self.rows is not None:
            self.rows.append([])
        elif tag == "table":
            self._close()
            self.rows = []
        elif tag in ("br", "p", "div", "li", "h1", "h2", "h3", "h4") and self.rows is None:
            self._close()

    def handle_endtag(self, tag: str) -> None:
        if tag in ("td", "th"):
            self._end_cell()
        elif tag == "table" and self.rows is not None:
            self._end_cell()
            if sum(len(row) > 1 for row in self.rows) > FEWEST:
                self.sheets.append(Sheet(f"{self.path.stem}", self.rows, above=self.lines[-MOST_LINES:]))
            self.lines += [" ".join(str(c) for c in row if c)[:LONGEST_LINE] for row in self.rows[:MOST_LINES]]
            self.rows = None
        elif self.rows is None:
            self._close()

    def handle_data(self, data: str) -> None:
        self.text += data

    def _end_cell(self) -> None:
        if self.open and self.rows:
            self.rows[-1] += [" ".join(self.text.split()) or None, *[None] * (self.span - 1)]
        if self.rows is not None:
            self.text, self.open = "", False

    def _close(self) -> None:
        text = " ".join(self.text.split())
        if self.rows is None and text:
            self.lines.append(text[:LONGEST_LINE])
        self.text = ""


def _of_html(path: Path, data: bytes) -> list[Sheet]:
    stated = re.search(rb"charset=[\"']?([\w-]+)", data[:4096])
    encodings = [stated[1].decode("ascii", "replace")] if stated else []
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encodings.insert(0, "utf-16")
    parser = _Tables(path)
    for encoding in (*encodings, "utf-8-sig", "cp1252", "latin-1"):
        try:
            text = data.decode(encoding)
            break
        except (LookupError, UnicodeDecodeError):
            continue
    affordable(text.lower().count("<td"), path)
    parser.feed(text)
    parser.close()
    for k, sheet in enumerate(parser.sheets if len(parser.sheets) > 1 else [], 1):
        sheet.name = f"{sheet.name} table {k}"
    return parser.sheets[:MOST_SHEETS]


def _of_xml(path: Path, data: bytes) -> list[Sheet]:
    root = root_of(path, data)
    affordable(data.count(b"<") + data.count(b'="'), path)
    parents = {child: parent for parent in root.iter() for child in parent}
    called = {e.get("id"): _what(e) for e in root.iter() if e.get("id") and _what(e)}
    groups = [
        (parent, [child for child in parent if child.tag == tag])
        for parent in root.iter()
        for tag, n in Counter(child.tag for child in parent).items()
        if n >= FEWEST
    ]
    around = [e for e in _outside(root, {r for _, records in groups for r in records}) if not e.get("id")]
    above = [f"{_local(k)}: {v}" for e in around for k, v in e.attrib.items()]
    above += [f"{_local(e.tag)}: {text}" for e in around if not len(e) and (text := (e.text or "").strip())]
    out = []
    for parent, records in groups:
        sheet = _sheet(_name(parent, parents) or path.stem, records, called)
        if sheet is not None:
            sheet.above = [line[:LONGEST_LINE] for line in above[:MOST_LINES]] if sheet.header else []
            out.append(sheet)
    return sorted(out, key=lambda s: -sum(map(len, s.rows)))[:MOST_SHEETS]


def _outside(root: ElementTree.Element, records: set[ElementTree.Element]) -> Iterator[ElementTree.Element]:
    """The elements that are not records, nor within one."""
    left = [root]
    while left:
        element = left.pop()
        if element not in records:
            yield element
            left += reversed(element)


def _local(tag: str) -> str:
    return tag.rpartition("}")[2]


def _what(element: ElementTree.Element) -> str:
    """The name that an element with an id gives to its column: `Position setpoint X1 [mm]`."""
    text = next((element.get(n, "") for n in _CALLED if element.get(n)), "")
    unit = next((v for k, v in element.attrib.items() if k.lower() in ("unit", "units", "unitstype")), "")
    return f"{text} [{unit}]" if text and unit_of(unit) else text


def _name(element: ElementTree.Element | None, parents: dict[ElementTree.Element, ElementTree.Element]) -> str:
    """The nearest name among the elements that enclose records, at most NEAREST of them."""
    for _ in range(NEAREST):
        if element is None:
            break
        for key, value in element.attrib.items():
            if _local(key).lower() in ("name", "title", "axis"):
                return f"{_local(key)} {value}" if _local(key).lower() == "axis" else value
        element = parents.get(element)
    return ""


def _sheet(name: str, records: list[ElementTree.Element], called: dict[str | None, str]) -> Sheet | None:
    """The records as rows; cells of one element name have no column names. None if they are empty."""
    tags = Counter(_local(c.tag) for record in records for c in record)
    if tags and max(Counter(_local(c.tag) for c in r).most_common(1)[0][1] for r in records if len(r)) > 1:
        return Sheet(name, [_cells(record) for record in records])
    rows = [{**r.attrib, **{_local(c.tag): _text(c) for c in r}} for r in records]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    if len(columns) < 2:
        return None
    notes = []
    if not tags and "time" in rows[0] and len(rows[0]) == len(columns) and any(len(row) < len(columns) for row in rows):
        notes.append("values that a record does not repeat are held, as control traces write them")
        for before, row in pairwise(rows):
            row |= {key: before[key] for key in columns if key not in row}
    cells: list[list[Cell]] = [[row.get(key) or None for key in columns] for row in rows]
    return Sheet(name, cells, [called.get(key) or _local(key) for key in columns], notes)


def _cells(record: ElementTree.Element) -> list[Cell]:
    """Cells in order; one with an index goes to that column (workbooks omit empty ones)."""
    cells: list[Cell] = []
    for child in record:
        index = next((v for k, v in child.attrib.items() if _local(k) == "Index"), "")
        if index.isdecimal() and len(cells) < int(index) <= MOST_SPAN:
            cells += [None] * (int(index) - 1 - len(cells))
        cells.append(_text(child) or None)
    return cells


def _text(element: ElementTree.Element) -> str:
    """The text of an element, or of the one within it (`<Cell><Data>5</Data></Cell>`)."""
    inner = element[0] if len(element) == 1 else element
    return " ".join((inner.text or "").split()) or element.get("value", "")
