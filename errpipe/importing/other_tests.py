"""Tests of more than one axis at once, which are not a table of one axis: identified, with the stage for them."""

from __future__ import annotations

import re
from collections.abc import Iterable

from errpipe.importing.readers import markup
from errpipe.importing.sheet import Cell, Sheet, filled_cells
from errpipe.importing.words import plain

LINES, WIDTH = 40, 300  # lines of a file, and characters per line, searched for the name of a test
_GRID = r"\bkgm ?\d*\b|\bgrid ?encoder\b|\bkreuzgitter"
_WRITE = "write a recording (docs/recordings.md, Tests of a machine) for the stage identify:"
# Name; pattern of a line (as `plain` writes it); description; what reads it.
TESTS: tuple[tuple[str, str, str, str], ...] = (
    (
        "ball bar",
        r"\bball ?bar\b|\bkreisformtest\b|\bqc ?[12]0\b|\b(angle|(dreh)?winkel)\b.*\b(radius|radial\w*|d ?r)\b",
        "readings of a ball bar over the angle of a circle",
        "with lines such as `Ballbar`, `Radius: 100 mm`, `Plane: XY` above it the table is imported as it is; else "
        f"{_WRITE} protocol ballbar_circle, the commanded position of each reading from the centre "
        "(X = radius * cos(angle), ...), and the deviation along the bar as E_R",
    ),
    (
        "R-test",
        r"\br-?test\b|^(\W*[abc]( ?(pos\w*|axis|achse|angle|winkel))?\b[^a-z]*((deg|grad)\b\W*)?){1,2}\bd? ?x\b.*"
        r"\bd? ?y\b.*\bd? ?z\b",
        "an R-test: the position of a ball at each position of a rotary axis",
        f"{_WRITE} protocol r_test, the positions of all axes, and ball minus nominal position as E_X, E_Y, E_Z; "
        "deviations are imported with --set COLUMN.component=E_X and so on",
    ),
    (
        "grid encoder",
        rf"{_GRID}|^\W*[xyz]( \W?mm\W?)?\W+[xyz]( \W?mm\W?)?$",
        "the log of a grid encoder, where two axes move together",
        f"{_WRITE} protocol point_cloud, the commanded positions of both axes, and measured minus commanded as E_X, "
        "E_Y; commanded and measured positions below a line that names the grid encoder are imported as they are",
    ),
    (
        "status reports",
        r"\bmpos:|\bwpos:|^bed x:|\bmarlin\b|-- polling (slave|device)|^\[\d+\]:",
        "what a control reports about itself (GRBL, Marlin, Modbus)",
        "it states where the control believes the axis is; needed is what an instrument read there: write a table "
        "`target X [mm];reading [mm]` with a row per reading",
    ),
    (
        "frequency response",
        r"^\W*(freq(uency|uenz|uence)?|hz)\b",
        "a frequency response, of an input shaper or a hammer test",
        "it contains no positions, and errpipe compensates positions; it cannot be used",
    ),
    (
        "inspection print",
        r"^\W*posn\b|\bdprnt\b|\bfeature no\b.*\d|\binspection (report|print)\b|\btchpr|\bmeasuring log\b|messprotokoll"
        r"|^\W*(n\d+ )?x ?-?\d+[.,]\d*\W+y ?-?\d|\bdim loc|\bcmm\b|^dmismn\b|\bfeat/",
        "an inspection print of a CMM or of the machine's own probe",
        "rows with axis, nominal and actual position of each feature are missing: write them as a table "
        "`Feature;Axis;Nominal;Actual` (Hole 1;X;50.000;50.012), in mm, which is imported",
    ),
)

OF_XML = " Targets and readings in separate lists of XML are not joined: export a CSV with a row per reading"


def names_a_grid_encoder(lines: Iterable[str]) -> bool:
    """Whether a line above a table names a grid encoder, which reads two axes against the table of the machine."""
    return any(re.search(_GRID, plain(line)) for line in lines)


def identify(sheets: Iterable[Sheet], kind: str) -> str:
    """The test that the first lines of a file identify and what reads it, as a sentence; '' if it is none of TESTS."""
    for sheet in sheets:
        rows: list[list[Cell]] = [[*sheet.above[:LINES]], [*(sheet.header or [])], *sheet.rows[:LINES]]
        lines = [plain(" ".join(map(str, filled_cells(row)))[:WIDTH]) for row in rows]
        for _, pattern, what, reads in TESTS:
            if any(re.search(pattern, line) for line in lines):
                return f" It may be {what}: {reads}."
    return OF_XML if kind == markup.name else ""
