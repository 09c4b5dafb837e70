"""Excel workbooks (.xlsx, .xlsm, .xlsb, .xls) and OpenDocument sheets, by python-calamine (extra `excel`)."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

from errpipe.errors import UsageError, did_you_mean
from errpipe.importing.readers._workbook_marks import Marks, marks_of, remove_struck_cells
from errpipe.importing.sheet import ReaderOptions, Rows, Sheet, affordable, cell_of, readable
from errpipe.importing.signs import states_a_sign

name = "Excel workbook"
suffixes = (".xlsx", ".xlsm", ".xlsb", ".xls", ".ods")
binary = True
_OLE = b"\xd0\xcf\x11\xe0"
_BEFORE_OLE = (b"\t\0", b"\t\x02", b"\t\x04")  # .xls of Excel 2 to 4, still written by some instruments


_OTHERWISE = (
    "damaged, locked by a password, or older than Excel 5. Open it in a spreadsheet, and save it as .xlsx or .csv"
)


def sniff(path: Path, head: bytes) -> bool:
    """A zip or OLE file, or an older one, with a spreadsheet's ending."""
    return path.suffix.lower() in suffixes and head.startswith((b"PK", _OLE, *_BEFORE_OLE))


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The named sheet, else every sheet with at least two rows. Raises DataError, UsageError."""
    try:
        from python_calamine import CalamineWorkbook, SheetVisibleEnum
    except ImportError:
        raise UsageError(f"{path}: reading Excel needs python-calamine: pip install 'errpipe[excel]'") from None
    with readable(path, "a workbook", _OTHERWISE):
        book = CalamineWorkbook.from_path(str(path))
        names = list(book.sheet_names)
        if options.sheet is not None and options.sheet not in names:
            near = did_you_mean(options.sheet, names)
            raise UsageError(f"{path}: no sheet {options.sheet!r} (sheets: {', '.join(names)}).{near}")
        hidden = {s.name for s in book.sheets_metadata if s.visible != SheetVisibleEnum.Visible}
        chosen = [options.sheet] if options.sheet is not None else [n for n in names if n not in hidden]
        marks = marks_of(path)
        sheets = []
        for each in chosen:
            sheet = book.get_sheet_by_name(each)
            affordable(sheet.total_height * sheet.total_width, f"{path}: {each}")
            rows = [[cell_of(c) for c in row] for row in sheet.to_python(skip_empty_area=False)]
            shown = marks.get(each, Marks())
            notes = remove_struck_cells(rows, shown, f"{path}: {each}")
            rows = _with_merged_numbers(rows, sheet.merged_cell_ranges)
            on_the_sign = [line for line in shown.comments if states_a_sign(line)]  # others are remarks on a cell
            sheets.append(Sheet(each, rows, notes=notes, above=on_the_sign))
    return [sheet.limited() for sheet in sheets if len(sheet.rows) > 1]


def _with_merged_numbers(rows: Rows, ranges: Iterable[Any] | None) -> Rows:
    """The rows, with a number in a cell merged over several rows of one column, such as a target, in each of them."""
    for (top, left), (bottom, right) in ranges or ():
        value = rows[top][left] if top < len(rows) and left < len(rows[top]) else None
        if left == right and isinstance(value, float):
            for row in rows[top : bottom + 1]:
                row[left] = value
    return rows
