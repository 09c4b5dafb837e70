"""INI files: a section per reading, a section per column with a value per target, or lists of values as columns."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

from errpipe.errors import UsageError
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, number

name = "INI"
suffixes = (".ini", ".cfg")
FEWEST_ROWS = 3  # of a table
_LINE = re.compile(r"\s*(\[[^\]]+\]|[;#].*|[^\s=\[][^=]*=.*)?\s*")
_APART = re.compile(r"\s*[;|\t]\s*|,\s+|\s+")  # between the values of a list; a comma without a blank may be decimal


def sniff(path: Path, head: bytes) -> bool:
    """Whether each line is a section, a comment, or a key and a value, and some of them make a table."""
    text = head.decode("utf-8-sig", "replace")
    if not re.search(r"^\s*\[[^\]=]+\]\s*$", text, re.MULTILINE) or not all(
        map(_LINE.fullmatch, text.splitlines()[:-1])
    ):
        return False
    return _table(path) is not None


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The table of a file; other keys are lines above it. Raises UsageError for --sheet."""
    if options.sheet is not None:
        raise UsageError(f"{path}: an INI file is one table: --sheet would be ignored")
    header, rows, above = _table(path) or ([], [], [])
    return [Sheet(path.stem, rows, header, above=above).limited()]


def _table(path: Path) -> tuple[list[str], list[list[Cell]], list[str]] | None:
    """Header, rows and other keys: of sections with the same keys, of lists of one length; None without either."""
    parser = configparser.ConfigParser(interpolation=None, comment_prefixes=("#", ";"), default_section="")
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(path.read_bytes().decode("utf-8-sig", "replace"))
    except configparser.Error:
        return None
    sections = {title: dict(parser[title]) for title in parser.sections()}
    alike: dict[tuple[str, ...], list[str]] = {}
    for title, of_section in sections.items():
        alike.setdefault(tuple(of_section), []).append(title)
    keys, titles = max(alike.items(), key=lambda item: len(item[0]) * len(item[1]), default=((), []))
    if len(titles) < FEWEST_ROWS > len(keys) or len(titles) < 2:
        return _of_lists(sections)
    above = [f"{k}: {v}" for title, of in sections.items() if title not in titles for k, v in of.items()]
    if len(titles) >= len(keys):  # a section per reading
        return [*keys], [[sections[title][k] for k in keys] for title in titles], above
    return titles, [[sections[title][k] for title in titles] for k in keys], above


def _of_lists(sections: dict[str, dict[str, str]]) -> tuple[list[str], list[list[Cell]], list[str]] | None:
    pairs = [(k, v) for of_section in sections.values() for k, v in of_section.items()]
    lists = {k: values for k, v in pairs if len(values := _APART.split(v.strip())) >= FEWEST_ROWS}
    lists = {k: values for k, values in lists.items() if all(number(x, "," in x) is not None for x in values)}
    if len(lists) < 2 or len({*map(len, lists.values())}) > 1:
        return None
    return (
        [*lists],
        [[*row] for row in zip(*lists.values(), strict=True)],
        [f"{k}: {v}" for k, v in pairs if k not in lists],
    )
