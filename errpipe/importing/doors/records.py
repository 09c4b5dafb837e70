"""Parquet tables (by pyarrow), and JSON: a record a line, a list of records, or a list for each column."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from errpipe.errors import DataError
from errpipe.importing.sheet import Cell, DoorOptions, Sheet, affordable

name = "Parquet or JSON"
suffixes = (".parquet", ".json", ".jsonl", ".ndjson")
binary = True  # a few bytes can state many rows
_PARQUET = b"PAR1"


def sniff(path: Path, head: bytes) -> bool:
    """A Parquet file, or text that begins as records of JSON do; a line `[1] Circle` does not."""
    begin = "".join(head[:64].decode("utf-8-sig", "replace").split())
    return head.startswith(_PARQUET) or begin.startswith(('{"', '[{"', "[{}"))


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """One sheet, a row per record. Raises DataError for a damaged file, and for JSON that is no table."""
    columns = _parquet(path) if path.read_bytes()[:4] == _PARQUET else _json(path)
    rows: list[list[Cell]] = [[*cells] for cells in zip(*columns.values(), strict=True)]
    return [Sheet(path.stem, rows, [*columns]).limited()]


def _parquet(path: Path) -> dict[str, list[Cell]]:
    from pyarrow import parquet

    try:
        file = parquet.ParquetFile(path)
        affordable(file.metadata.num_rows * file.metadata.num_columns, path)
        table = file.read(use_threads=False)
        return {n: _column(table[n]) for n in dict.fromkeys(table.column_names)}
    except (DataError, MemoryError):
        raise
    except Exception as err:  # pyarrow raises ArrowInvalid, OSError, KeyError, ... for damaged files
        raise DataError(
            f"{path}: not a Parquet file that can be read ({type(err).__name__}): export it anew, or as CSV"
        ) from None


def _column(values: Any) -> list[Cell]:
    """The cells of a column; of numbers at once."""
    if str(values.type).startswith(("int", "uint", "float", "double")):
        numbers: list[Cell] = values.to_numpy().astype(float).tolist()
        return numbers
    return [_cell(v) for v in values.to_pylist()]


def _json(path: Path) -> dict[str, list[Cell]]:
    text = path.read_text("utf-8-sig", errors="replace")
    try:
        document = json.loads(text)
    except ValueError:
        document = [_line(path, n, line) for n, line in enumerate(text.splitlines(), 1) if line.strip()]
    except RecursionError:
        raise DataError(f"{path}: JSON that is nested too deep for a table") from None
    if isinstance(document, dict):
        document = next(
            (v for v in document.values() if isinstance(v, list) and v and isinstance(v[0], dict)), document
        )
    if isinstance(document, dict):
        lists = {k: v for k, v in document.items() if isinstance(v, list)}
        if lists and len({*map(len, lists.values())}) == 1:
            return {k: [_cell(v) for v in values] for k, values in lists.items()}
    records = [_flat(r) for r in document if isinstance(r, dict)] if isinstance(document, list) else []
    names = dict.fromkeys(n for r in records for n in r)
    affordable(len(names) * len(records), path)
    if not names:
        raise DataError(f"{path}: JSON that is no table (allowed: a record a line, a list of records, lists by column)")
    return {n: [_cell(r.get(n)) for r in records] for n in names}


def _line(path: Path, n: int, line: str) -> Any:
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as err:
        raise DataError(f"{path}:{n}  no record of JSON: {err}") from None


def _flat(record: dict[str, Any]) -> dict[str, Any]:
    """`{"pos": {"X": 1.0}}` as `{"pos X": 1.0}`, `{"of": [{"id": "C", "temp": 1.0}]}` as `{"of C temp": 1.0}`."""
    parts = ((k, _named(v) if isinstance(v, list) else v) for k, v in record.items())
    inner = ((k, _flat(v) if isinstance(v, dict) else {"": v}) for k, v in parts)
    return {f"{k} {name}".strip(): value for k, of in inner for name, value in of.items()}


def _named(values: list[Any]) -> Any:
    """A list of records that name themselves as a record by these names; any other list as it is."""
    key = next((k for k in ("id", "name") if values and all(isinstance(v, dict) and k in v for v in values)), None)
    return values if key is None else {str(v[key]): {k: x for k, x in v.items() if k != key} for v in values}


def _cell(value: Any) -> Cell:
    if value is None or isinstance(value, float):
        return value
    if isinstance(value, int):
        return float(value)
    return value.isoformat() if hasattr(value, "isoformat") else str(value)
