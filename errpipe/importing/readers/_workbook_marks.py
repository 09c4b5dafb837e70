"""What an Excel workbook (.xlsx) shows beside its values: cells struck through, scaled number formats, comments.

ECMA-376, part 1: fonts and number formats are in xl/styles.xml, and a cell names its format by a number.
"""

from __future__ import annotations

import posixpath
import re
import zipfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

from errpipe.errors import DataError
from errpipe.importing.readers._xml import root_of
from errpipe.importing.sheet import Rows

MOST_COMMENTS = 50  # of a sheet, as of remarks below a table
MOST_PART_BYTES = 64 << 20  # of a part that is read at once (by judgement); sheets are read in blocks
_BLOCK, _LONGEST_TAG = 1 << 20, 1 << 12  # bytes
_CELL = re.compile(rb"<(?:\w+:)?c\s[^>]*>")
_PLACE = re.compile(rb'\sr="([A-Z]{1,3})(\d{1,7})"')
_STYLE = re.compile(rb'\ss="(\d{1,6})"')
_THOUSANDTHS = re.compile(r"[0#?],+(?![0#?,])")  # a comma behind the last digit divides by 1000 (18.8.31)


@dataclass
class Marks:
    """Of one sheet: cells struck through and cells shown divided by 1000, as (row, column), and texts of comments."""

    struck: list[tuple[int, int]] = field(default_factory=list)
    scaled: list[tuple[int, int]] = field(default_factory=list)
    comments: list[str] = field(default_factory=list)


def marks_of(path: Path) -> dict[str, Marks]:
    """The marks of each sheet by its name; nothing for a workbook that is not a zip file of XML."""
    if not zipfile.is_zipfile(path):
        return {}
    with zipfile.ZipFile(path) as book:
        names = set(book.namelist())
        if not {"xl/workbook.xml", "xl/_rels/workbook.xml.rels"} <= names:
            return {}
        struck, scaled = _styles(path, book) if "xl/styles.xml" in names else (set(), set())
        parts = {key: target for key, _, target in _related(path, book, "xl/workbook.xml")}
        out = {}
        for sheet in _elements(_root(path, book, "xl/workbook.xml"), "sheet"):
            part = parts.get(next((v for k, v in sheet.attrib.items() if k.endswith("}id")), ""), "")
            if part in names:
                marks = out[sheet.attrib.get("name", "")] = Marks(comments=_comments(path, book, part))
                for place, style in _cells(book, part) if struck or scaled else ():
                    marks.struck += [place] if style in struck else []
                    marks.scaled += [place] if style in scaled else []
        return out


def remove_struck_cells(rows: Rows, marks: Marks, where: str) -> list[str]:
    """Empty the cells that are struck through, in place; a note on them.

    Raises DataError for a number shown divided by 1000: whether its unit is that of the value or of what is shown, the
    workbook does not say.
    """

    def filled(places: list[tuple[int, int]]) -> list[tuple[int, int]]:
        return [(r, c) for r, c in places if r < len(rows) and c < len(rows[r]) and rows[r][c] is not None]

    number = next(((r, c) for r, c in filled(marks.scaled) if isinstance(rows[r][c], float)), None)
    if number is not None:
        value = float(rows[number[0]][number[1]] or 0.0)
        raise DataError(
            f"{where}: cell {_name(*number)} is {value:g} and shown as {value / 1000:g} (its number format divides by "
            "1000): which one has the unit of the header? Give its column the format General and check its numbers, or "
            "choose another sheet with --sheet"
        )
    struck = filled(marks.struck)
    for r, c in struck:
        rows[r][c] = None
    first = f" (the first: {_name(*struck[0])})" if struck else ""
    return [f"{len(struck)} cells that are struck through{first}: left out"] if struck else []


def _styles(path: Path, book: zipfile.ZipFile) -> tuple[set[int], set[int]]:
    """Numbers of the cell formats whose font is struck through, and of those that divide by 1000."""
    root = _root(path, book, "xl/styles.xml")
    codes = {f.attrib.get("numFmtId"): f.attrib.get("formatCode", "") for f in _elements(root, "numFmt")}
    by_1000 = {k for k, code in codes.items() if _THOUSANDTHS.search(re.sub(r'"[^"]*"|\\.|;.*', "", code))}
    fonts = next(_elements(root, "fonts"), ())
    lines = [next(_elements(font, "strike"), None) for font in fonts]
    formats = [*next(_elements(root, "cellXfs"), ())]
    of_font = [int(f.attrib.get("fontId", 0)) for f in formats]
    drawn = [line is not None and line.attrib.get("val", "1") in ("1", "true") for line in lines]
    struck = {k for k, font in enumerate(of_font) if font < len(drawn) and drawn[font]}
    return struck, {k for k, f in enumerate(formats) if f.attrib.get("numFmtId") in by_1000}


def _root(path: Path, book: zipfile.ZipFile, part: str) -> ElementTree.Element:
    """The root of a part. Raises DataError for one that unpacks to more than `MOST_PART_BYTES`."""
    if book.getinfo(part).file_size > MOST_PART_BYTES:  # zipfile stops at the stated size
        raise DataError(f"{path}: {part} unpacks to more than {MOST_PART_BYTES >> 20} MB: save the sheet as CSV")
    return root_of(path, book.read(part))


def _cells(book: zipfile.ZipFile, part: str) -> Iterator[tuple[tuple[int, int], int]]:
    """Place and format of the cells of a sheet that have both."""
    rest = b""
    with book.open(part) as xml:
        while block := xml.read(_BLOCK):
            block = rest + block
            end = max(block.rfind(b"<"), len(block) - _LONGEST_TAG)
            rest = block[end:]  # a tag that the block cuts
            for cell in _CELL.finditer(block[:end]):
                place, style = _PLACE.search(cell.group()), _STYLE.search(cell.group())
                if place and style:
                    column = 0
                    for letter in place[1]:
                        column = 26 * column + letter - ord("A") + 1
                    yield (int(place[2]) - 1, column - 1), int(style[1])


def _comments(path: Path, book: zipfile.ZipFile, part: str) -> list[str]:
    """Texts of the comments of a sheet, without the name of who wrote them."""
    out = []
    for _, kind, target in _related(path, book, part):
        if kind.endswith("/comments") and target in book.namelist():
            for comment in _elements(_root(path, book, target), "comment"):
                text = "".join(t.text or "" for t in _elements(comment, "t"))
                out += [line for line in text.splitlines() if line.strip()]
    return out[:MOST_COMMENTS]


def _related(path: Path, book: zipfile.ZipFile, part: str) -> list[tuple[str, str, str]]:
    """Id, kind and name of the parts to which a part of a workbook refers."""
    folder, name = posixpath.split(part)
    listing = f"{folder}/_rels/{name}.rels"
    if listing not in book.namelist():
        return []
    related = [r.attrib for r in _elements(_root(path, book, listing), "Relationship")]
    names = [posixpath.normpath(posixpath.join("/", folder, r.get("Target", ""))).lstrip("/") for r in related]
    return [(r.get("Id", ""), r.get("Type", ""), n) for r, n in zip(related, names, strict=True)]


def _elements(root: ElementTree.Element, tag: str) -> Iterator[ElementTree.Element]:
    """The elements of a tag, in whichever of the namespaces of the two editions of the standard."""
    return (e for e in root.iter() if e.tag.rpartition("}")[2] == tag)


def _name(row: int, column: int) -> str:
    letters = ""
    while column >= 0:
        letters, column = chr(ord("A") + column % 26) + letters, column // 26 - 1
    return f"{letters}{row + 1}"
