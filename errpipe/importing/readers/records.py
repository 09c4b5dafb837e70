"""Parquet and Feather (by pyarrow), JSON, YAML or INI: a record per line, a list of records or rows, or per column."""

from __future__ import annotations

import configparser
import json
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from errpipe import yamlfile
from errpipe.errors import ConfigError, DataError
from errpipe.importing.sheet import Cell, ReaderOptions, Sheet, affordable, cell_of, number, readable

name = "Parquet or JSON"
suffixes = (".parquet", ".feather", ".arrow", ".json", ".jsonl", ".ndjson")
binary = True  # a few bytes can declare many rows
_PARQUET, _ARROW = b"PAR1", b"ARROW1"
_YAML = (".yaml", ".yml")
DEEPEST = 5  # nesting depth in which tables are searched for: a result of InfluxDB has 4
FEWEST_ROWS = 3  # of a table next to the largest: fewer are facts of the set-up
LONGEST_TEXT = 200  # characters of a text that is a comment
MOST_SERIES = 20  # of a list, in which tables are searched for
FEWEST_SECONDS, MOST_SECONDS = 5e8, 1e10  # Unix times in s, 1985 to 2286; larger values are ms
_LOGGED = re.compile(
    r"([^\s{}]{1,40}\d[^\s{}]*)\s+([^{}\n]{0,200}?)\s*(\{\".*\})\s*(?:\n|$)"
)  # `2026-11-27T09:00:00Z mill/x {"x": 1}`
_SECTION = re.compile(r"(?:\s*[;#].*\n)*\s*\[[^\W\d][^\[\]=]*\]\s*\n")  # the first of an INI file
_BETWEEN = re.compile(r"\s*[;|\t]\s*|,\s+|\s+")  # values of a list; a comma without a blank may be a decimal one
_OF_PYTHON = re.compile(r"'|\b(?:None|True|False|nan)\b")
_JSON = {"None": "null", "True": "true", "False": "false", "nan": "NaN"}
MOST_FACTS, LONGEST_FACT = 4, 30  # entries, and characters of each, that a message repeats
_NAMES = ("columns", "fields", "header")  # keys of column names stored with rows


def sniff(path: Path, head: bytes) -> bool:
    """A Parquet or Feather file, or text that starts like JSON records; a line `[1] Circle` does not match."""
    begin = "".join(head[:64].decode("utf-8-sig", "replace").split()).replace("'", '"')
    records = begin.startswith(('{"', '[{"', "[{}", "[[")) or _LOGGED.match(head.decode("utf-8-sig", "replace"))
    ini = _ini(head.decode("utf-8-sig", "replace").rpartition("\n")[0])
    return head.startswith((_PARQUET, _ARROW)) or bool(records or ini) or path.suffix.lower() in _YAML


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """A row per record. Raises DataError for a damaged file, and for JSON without a table."""
    if path.read_bytes()[:6].startswith((_PARQUET, _ARROW)):
        return [_sheet(path.stem, _parquet(path), [], [])]
    return [s for s in _json(path) if options.sheet in (None, s.name)]


def _facts(document: Any) -> str:
    """What a document without a table states, for a message: `units.deviation: thou`."""
    found, left = list[str](), [("", document)]
    while left and len(found) < MOST_FACTS:
        at, value = left.pop(0)
        if isinstance(value, dict):
            left = [(f"{at}.{key}".strip("."), v) for key, v in value.items()] + left
        elif at and isinstance(value, str | int | float):
            found.append(f"{at}: {str(value)[:LONGEST_FACT]}")
    return f". It states {', '.join(found)}: state this by the options of `import`" if found else ""


def _sheet(name: str, columns: dict[str, list[Cell]], notes: list[str], above: list[str]) -> Sheet:
    rows: list[list[Cell]] = [[*cells] for cells in zip(*columns.values(), strict=True)]
    return Sheet(name, rows, [*columns], notes, above).limited()


def _parquet(path: Path) -> dict[str, list[Cell]]:
    from pyarrow import feather, parquet

    with readable(path, "a Parquet file (or Feather)"):
        if path.read_bytes()[:6] == _ARROW:
            table = feather.read_table(path, use_threads=False, memory_map=False)
            affordable(table.num_rows * table.num_columns, path)
        else:
            file = parquet.ParquetFile(path)
            affordable(file.metadata.num_rows * file.metadata.num_columns, path)
            table = file.read(use_threads=False)
        return {_with_unit(f): _column(table[f.name]) for f in {f.name: f for f in table.schema}.values()}


def _with_unit(field: Any) -> str:
    """The name of a field, and the unit in its metadata."""
    stated = {k.decode(errors="replace").lower(): v.decode(errors="replace") for k, v in (field.metadata or {}).items()}
    unit = stated.get("unit") or stated.get("units")
    return f"{field.name} [{unit}]" if unit else str(field.name)


def _column(values: Any) -> list[Cell]:
    """The cells of a column; numeric ones in one step."""
    if str(values.type).startswith(("int", "uint", "float", "double")):
        numbers: list[Cell] = values.to_numpy().astype(float).tolist()
        return numbers
    return [cell_of(v) for v in values.to_pylist()]


def _json(path: Path) -> list[Sheet]:
    """The largest table and those with the same columns, which may be runs or axes; a note on others."""
    text = path.read_text("utf-8-sig", errors="replace")
    if re.match(r"[\[\s]*\{\s*'", text):  # dictionaries as Python prints them
        text = _OF_PYTHON.sub(lambda m: _JSON.get(m[0], '"'), text)
    try:
        document = _yaml(path, text) if path.suffix.lower() in _YAML else _ini(text) or json.loads(text)
    except ValueError:
        document = _of_one_time(_line(path, n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip())
    except RecursionError:
        raise DataError(f"{path}: JSON nested too deeply for a table") from None
    tables = list(_tables(document))
    if not tables:
        raise DataError(
            f"{path}: JSON or YAML without a table (allowed: one record per line, a list of records, rows or columns, "
            f"also within one object){_facts(document)}"
        )
    _, largest = max(tables, key=lambda table: _rows(table[1]))
    alike = [(at, t) for at, t in tables if [*t] == [*largest] and _rows(t) >= FEWEST_ROWS]
    alike = [(at, t) for k, (at, t) in enumerate(alike) if all(t != before for _, before in alike[:k])]
    alike = alike or [("", largest)]
    affordable(sum(len(t) * _rows(t) for _, t in alike), path)
    used = tuple(f"{at} " for at, _ in alike if at)  # the series of which the table is made
    beside = [(at, t) for at, t in tables if at and not {*t} & {*largest} and not at.startswith(used)]
    beside = [(at, t) for at, t in beside if not any(isinstance(v, list | dict) for of in t.values() for v in of)]
    others = [at for at, t in beside if _rows(t) >= FEWEST_ROWS]
    notes = [f"tables with other columns are excluded: {', '.join(dict.fromkeys(others))}"] if others else []
    facts = document.items() if isinstance(document, dict) else ()
    above = [f"{k}: {v}" for k, v in facts if isinstance(v, str) and len(v) <= LONGEST_TEXT]  # `Axis: X`
    named = [(at if len(alike) > 1 and at else path.stem, t) for at, t in alike]
    return [_sheet(n, {k: [*map(cell_of, of)] for k, of in t.items()}, [*notes], above) for n, t in named]


def _ini(text: str) -> dict[str, Any]:
    """An INI file as a document: a section per reading, a section per column, or lists of values; {} for other text."""
    if not _SECTION.match(text):
        return {}
    parser = configparser.ConfigParser(delimiters=("=",), interpolation=None, default_section="")
    parser.optionxform = str  # type: ignore[assignment,method-assign]
    try:
        parser.read_string(text)
    except configparser.Error:
        return {}
    alike: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    document, lists = dict[str, Any](), dict[str, Any]()
    for title in parser.sections():
        alike.setdefault(tuple(parser[title]), {})[title] = dict(parser[title])
    for keys, sections in alike.items():
        if len(keys) > 1 and len(sections) >= max(FEWEST_ROWS, len(keys)):
            lists[" ".join(keys)] = [*sections.values()]
        elif len(sections) > 1 and len(keys) >= FEWEST_ROWS:
            lists |= {title: [*of.values()] for title, of in sections.items()}
        else:
            document |= {k: v for of in sections.values() for k, v in of.items()}
    apart = {k: _BETWEEN.split(v.strip()) for k, v in document.items()}
    lists |= {
        k: v for k, v in apart.items() if len(v) >= FEWEST_ROWS and all(number(x, "," in x) is not None for x in v)
    }
    return document | lists if lists else {}


def _yaml(path: Path, text: str) -> Any:
    try:
        document = yamlfile.parse(text, str(path))
        document.raise_problems()
    except ConfigError as err:
        raise DataError(str(err)) from None
    return document.value


def _rows(table: dict[str, list[Any]]) -> int:
    return max(map(len, table.values()))


def _tables(document: Any, depth: int = DEEPEST, at: str = "") -> Iterator[tuple[str, dict[str, list[Any]]]]:
    """Keys to, and columns of, every table of a document, including small tables with facts of the set-up.

    A table is a list of records, lists by column (pandas: `list`), a list of rows with the names of the columns
    (`split`), or values by the number of the row (`columns`, `index`).
    """
    if isinstance(document, dict):
        inner, header = [*document.values()], next((h for k in _NAMES if isinstance(h := document.get(k), list)), None)
        lists = {k: v for k, v in document.items() if isinstance(v, list) and v and not isinstance(v[0], list | dict)}
        if lists and len({*map(len, lists.values())}) == 1:
            yield at, lists
        by_number = [v for v in inner if isinstance(v, dict) and _numbered(v)]
        if by_number and len(by_number) == len(inner) and len({*map(len, by_number)}) == 1:
            yield at, {k: [*v.values()] for k, v in document.items()}
        if _numbered(document):
            inner = [inner]
    else:
        inner, header = (document, None) if isinstance(document, list) else ([], None)
        records = [_flat(r) for r in inner if isinstance(r, dict)]
        if names := dict.fromkeys(n for r in records for n in r):
            yield at, {n: [r.get(n) for r in records] for n in names}
        yield from ((at, rows) for rows in _of_rows(inner, None))
        if long := _of_series(inner):
            yield at, long
        inner = inner[:MOST_SERIES]
    keys = [*document] if isinstance(document, dict) and len(document) == len(inner) else range(1, len(inner) + 1)
    for key, value in zip(keys, inner, strict=True) if depth else ():
        where = f"{at} {key}".strip()
        if isinstance(value, list):
            yield from ((where, rows) for rows in _of_rows(value, header))
        if isinstance(value, list | dict):
            yield from _tables(value, depth - 1, where)


def _of_series(series: list[Any]) -> dict[str, list[Any]]:
    """A row per value of series that each contain one list of values with times, as historians store a signal.

    `[{"NodeId": "X.ActPos", "DataValues": [{"SourceTimestamp": ..., "Value": 1.0}]}, ...]`, or of pairs of a Unix time
    and a value: `[{"metric": {"__name__": "x_act"}, "values": [[1764061920, "1.0"], ...]}]`; {} for any other list.
    """
    rows: list[dict[str, Any]] = []
    for one in series if len(series) > 1 else []:
        lists = [v for v in one.values() if isinstance(v, list)] if isinstance(one, dict) else []
        if len(lists) == 1 and (pairs := _timed(lists[0])):
            texts = [(k, v) for k, v in _flat(one).items() if isinstance(v, str)]
            texts.sort(key=lambda item: "name" in item[0])  # `X axis_actual_mm`
            rows += [{"signal": " ".join(v for _, v in texts), "time": t, "value": v} for t, v in pairs]
            continue
        records = lists[0] if len(lists) == 1 and all(isinstance(r, dict) for r in lists[0]) else []
        if not records or not all(any(k.lower() == "value" for k in r) for r in records):
            return {}
        own = {k: v for k, v in one.items() if not isinstance(v, list | dict)}
        rows += [own | _flat(r) for r in records]
    return {n: [r.get(n) for r in rows] for n in dict.fromkeys(n for r in rows for n in r)}


def _timed(pairs: list[Any]) -> list[tuple[str, Any]]:
    """Times, as dates, and values of pairs in either order, one of which counts s or ms from 1970; else nothing."""
    if len(pairs) < FEWEST_ROWS or not all(isinstance(p, list) and len(p) == 2 for p in pairs):
        return []
    for i in (0, 1):
        t = np.array([v if (v := number(cell_of(p[i]), False)) is not None else np.nan for p in pairs])
        per_second = 1e3 if t.min() > MOST_SECONDS else 1.0
        if t.min() / per_second > FEWEST_SECONDS and t.max() / per_second < MOST_SECONDS and (np.diff(t) > 0).all():
            dates = np.datetime_as_string(np.round(1e3 * t / per_second).astype("datetime64[ms]"), timezone="UTC")
            return [(str(when), p[1 - i]) for when, p in zip(dates, pairs, strict=True)]
    return []


def _numbered(values: dict[str, Any]) -> bool:
    """Whether the keys count the rows: `0`, `1`, ..."""
    return len(values) > 2 and [*values] == [str(n) for n in range(len(values))]


def _of_rows(rows: list[Any], header: list[Any] | None) -> Iterator[dict[str, list[Any]]]:
    """The columns of rows of one width, named by a header of that width, or by a first row of texts."""
    if len(rows) < 2 or not all(isinstance(r, list) and len(r) == len(rows[0]) > 1 for r in rows):
        return
    if header is None and all(isinstance(v, str) for v in rows[0]):
        header, rows = rows[0], rows[1:]
    names = [*dict.fromkeys(map(str, header or []))]
    if len(names) != len(rows[0]):
        names = [f"column {i}" for i in range(1, len(rows[0]) + 1)]
    yield dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))


def _of_one_time(records: Iterable[Any]) -> list[Any]:
    """The records, those of one time and of different topics as one."""
    out: list[Any] = []
    for record in records:
        before: Any = out[-1] if out else None
        beside = isinstance(before, dict) and isinstance(record, dict) and {*before} & {*record} == {"time"}
        if beside and before["time"] == record["time"]:
            before |= record
        else:
            out.append(record)
    return out


def _line(path: Path, n: int, line: str) -> Any:
    if logged := _LOGGED.fullmatch(line):  # as subscribers write messages: time, topic, record
        time, topic, text = logged.groups()
        record = _line(path, n, text)
        return {"time": time} | ({topic: record} if topic else record)
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as err:
        raise DataError(f"{path}:{n}  not a JSON record: {err}") from None


def _flat(record: dict[str, Any]) -> dict[str, Any]:
    """`{"pos": {"X": 1.0}}` as `{"pos X": 1.0}`, `{"of": [{"id": "C", "temp": 1.0}]}` as `{"of C temp": 1.0}`."""
    parts = ((k, _named(v) if isinstance(v, list) else v) for k, v in record.items())
    inner = ((k, _flat(v) if isinstance(v, dict) else {"": v}) for k, v in parts)
    return {f"{k} {name}".strip(): value for k, of in inner for name, value in of.items()}


def _named(values: list[Any]) -> Any:
    """A list of records with names as one record keyed by these names; any other list unchanged."""
    key = next((k for k in ("id", "name") if values and all(isinstance(v, dict) and k in v for v in values)), None)
    return values if key is None else {str(v[key]): {k: x for k, x in v.items() if k != key} for v in values}
