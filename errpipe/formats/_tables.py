"""Tables in blocks: CSV and Parquet read a few MB at a time, every refusal with its file and line.

pyarrow parses blocks of whole lines on a few threads. Only if it refuses, or if a value is not allowed,
a block is read again in plain Python to report the line, the invalid text and the allowed values.
"""

from __future__ import annotations

import csv
import difflib
import io
import itertools
import math
import os
import re
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

import numpy as np
import pyarrow as pa
import pyarrow.csv as pacsv
import pyarrow.parquet as pq

from errpipe import files
from errpipe.errors import DataError, did_you_mean

BLOCK_BYTES = 8 << 20  # 8 MB of text is about 150 000 rows; two threads hold 3 such blocks at a time
MAX_HEADER_BYTES = 1 << 20  # a first line beyond 1 MB is not a header row
MAX_LINE_BYTES = 4 << 20  # a row of a hundred thousand columns; a file without line feeds is not held in memory
MAX_CELLS_PER_BYTE = 20  # of a Parquet table; recordings with one varying and ten constant columns have 8
MIN_CELLS_JUDGED = 5_000_000  # 40 MB in memory: smaller tables may hold one value only
MAX_PROBLEMS = 5  # a file with a wrong decimal mark is wrong in every line; five lines show it
_BYTE_ORDER_MARKS = {b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16", b"\xef\xbb\xbf": "a UTF-8 byte order mark"}

_DATE_OR_TIME = re.compile(r"\d{1,4}[-/.:]\d{1,2}[-/.:]\d")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

Kinds = Mapping[str, str]  # column of the table -> "number", "label" or "ignore"


@dataclass(frozen=True)
class Block:
    """Some rows of one table: float64 (missing = null) or labels (also as a dictionary), and each row's location."""

    table: pa.Table
    place: Callable[[int], str]


def blocks(path: Path, kinds: Kinds, label: str) -> Iterator[Block]:
    """The rows of a table in file order. `label` is how messages name the file.

    kinds says what the table's columns are; every column of the table must be among them, and every
    one that is not to be ignored must be in the table. Raises DataError.
    """
    if not path.is_file():
        raise DataError(f"{label}: no such table.{_near_file(path)}")
    if path.suffix.lower() in (".parquet", ".pq"):
        return _parquet_blocks(path, kinds, label)
    if path.suffix.lower() in (".csv", ".txt"):
        return _csv_blocks(path, kinds, label)
    raise DataError(f"{label}: a table is a .csv or a .parquet file (found {path.suffix or 'no'} suffix)")


def _near_file(path: Path) -> str:
    if "*" in path.name:
        return " Tables are listed by name; a pattern is not expanded."
    there = sorted(p.name for p in path.parent.iterdir() if p.is_file()) if path.parent.is_dir() else []
    return did_you_mean(path.name, [n for n in there if n.endswith((".csv", ".parquet"))])


# ---------------------------------------------------------------- CSV


def _csv_blocks(path: Path, kinds: Kinds, label: str) -> Iterator[Block]:
    with files.open_regular(path) as stream:
        names = _header(stream, label)
        check_columns(names, kinds, f"{label}:1")
        convert = _convert_options(names, kinds)
        read = pacsv.ReadOptions(column_names=names, use_threads=False, block_size=1 << 30)
        parse = pacsv.ParseOptions(newlines_in_values=False)

        def parsed(data: bytes, line: int) -> Block:
            try:
                _no_line_break_in_quotes(data, line, label)
                table = pacsv.read_csv(
                    pa.BufferReader(data), read_options=read, parse_options=parse, convert_options=convert
                )
                _finite(table)
            except pa.ArrowInvalid as err:
                problems = list(itertools.islice(_wrong_cells(data, line, names, kinds, label), MAX_PROBLEMS))
                raise DataError("\n".join(problems) or f"{label}: cannot be read as CSV: {err}") from None
            return Block(table, lambda row: f"{label}:{next(itertools.islice(_lines(data, line), row, None))[0]}")

        yield from _in_order(parsed, _text_blocks(stream, label))


def _header(stream: IO[bytes], label: str) -> list[str]:
    first = stream.readline(MAX_HEADER_BYTES)
    for mark, name in _BYTE_ORDER_MARKS.items():
        if first.startswith(mark):
            raise DataError(f"{label}:1  begins with {name} (allowed: plain UTF-8; save without byte order mark)")
    if not first:
        raise DataError(f"{label}: the table is empty (allowed: a header row and at least one row)")
    try:
        text = first.decode("utf-8").rstrip("\r\n")
    except UnicodeDecodeError as err:
        raise DataError(f"{label}:1  not UTF-8 text: byte {err.object[err.start]:#04x} at {err.start + 1}") from None
    if "\r" in text or "\x00" in text or len(first) == MAX_HEADER_BYTES:
        raise DataError(f"{label}:1  no header row that ends in a line feed (is this a text file?)")
    return next(csv.reader([text]), [])


def check_columns(names: list[str], kinds: Kinds, place: str) -> None:
    """Every name once, declared, and none missing. Raises DataError with all that is wrong."""
    if len(names) == 1 and len(kinds) > 1:
        for mark, word in ((";", "semicolons"), ("\t", "tabs"), ("|", "bars")):
            if mark in names[0]:
                raise DataError(f"{place}  the header is separated by {word} (allowed: commas)")
    problems = []
    for name in dict.fromkeys(names):
        if names.count(name) > 1:
            problems.append(f"{place}  column {name!r} occurs {names.count(name)} times in the header (allowed: once)")
    missing = [n for n, kind in kinds.items() if kind != "ignore" and n not in names]
    for name in dict.fromkeys(names):
        if name not in kinds:
            hint = did_you_mean(name.strip(), missing) or " Declare it with its role, or with `role: ignore`."
            problems.append(f"{place}  column {name!r} is not in the manifest.{hint}")
    for name in missing:
        near = difflib.get_close_matches(name, [n for n in names if n not in kinds], n=1)
        if not near:
            problems.append(f"{place}  column {name!r} of the manifest is not in the table (found: {', '.join(names)})")
    if problems:
        raise DataError("\n".join(problems))


def _convert_options(names: list[str], kinds: Kinds) -> pacsv.ConvertOptions:
    wanted = [n for n in kinds if kinds[n] != "ignore" and n in names]
    types = {n: pa.float64() if kinds[n] == "number" else pa.string() for n in wanted}
    return pacsv.ConvertOptions(
        column_types=types, include_columns=wanted, null_values=[""], strings_can_be_null=False, check_utf8=True
    )


def _text_blocks(stream: IO[bytes], label: str) -> Iterator[tuple[bytes, int]]:
    """Blocks of whole lines and the number of each block's first line. Raises DataError for a line without end."""
    line, rest = 2, b""
    while data := stream.read(BLOCK_BYTES):
        cut = data.rfind(b"\n") + 1
        if len(rest) + (cut or len(data)) > BLOCK_BYTES + MAX_LINE_BYTES or len(data) - cut > MAX_LINE_BYTES:
            first = line + data.count(b"\n")
            raise DataError(f"{label}:{first}  is longer than {MAX_LINE_BYTES >> 20} MB (is this a table of lines?)")
        if not cut:
            rest += data
            continue
        block, rest = rest + data[:cut], data[cut:]
        yield block, line
        line += block.count(b"\n")
    if rest:
        yield rest, line


def _in_order(work: Callable[[bytes, int], Block], items: Iterator[tuple[bytes, int]]) -> Iterator[Block]:
    """Parse on a few threads, hand out in file order; never more than a few blocks in memory."""
    threads = min(os.cpu_count() or 1, 4)
    waiting: deque[Future[Block]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for data, line in items:
                if data.strip():
                    waiting.append(pool.submit(work, data, line))
                if len(waiting) > threads:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


def _finite(table: pa.Table) -> None:
    """Raises ArrowInvalid if a cell spells nan or infinity, which pyarrow takes for a number."""
    for column in table.columns:
        if pa.types.is_floating(column.type):
            for chunk in column.chunks:
                values = np.asarray(chunk.fill_null(0.0)) if chunk.null_count else np.asarray(chunk)
                # The sum is not finite where a value is not; overflow of finite values is ruled out below.
                if not math.isfinite(float(np.sum(values))) and not np.isfinite(values).all():
                    raise pa.ArrowInvalid("not a finite number")


def _no_line_break_in_quotes(data: bytes, line: int, label: str) -> None:
    if b'"' not in data:
        return
    octets = np.frombuffer(data, dtype=np.uint8)
    quotes, ends = np.flatnonzero(octets == ord('"')), np.flatnonzero(octets == ord("\n"))
    odd = np.flatnonzero(np.searchsorted(quotes, ends) % 2)
    if odd.size:
        raise DataError(f"{label}:{line + int(odd[0])}  a quote is not closed in its line (allowed: one row, one line)")


def _lines(data: bytes, line: int) -> Iterator[tuple[int, bytes]]:
    for number, text in enumerate(data.split(b"\n"), line):
        if text.strip(b"\r"):
            yield number, text.rstrip(b"\r")


def _wrong_cells(data: bytes, line: int, names: list[str], kinds: Kinds, label: str) -> Iterator[str]:
    """What is wrong in a block that pyarrow refused, line by line."""
    for number, raw in _lines(data, line):
        try:
            text = raw.decode("utf-8")
        except UnicodeDecodeError as err:
            yield f"{label}:{number}  not UTF-8 text: byte {raw[err.start]:#04x} at {err.start + 1}"
            continue
        if "\r" in text:
            yield f"{label}:{number}  a carriage return inside the line (allowed: lines that end in a line feed)"
            continue
        cells = next(csv.reader(io.StringIO(text)), [])
        if len(cells) != len(names):
            hint = " (a decimal comma? write 1.5, not 1,5)" if len(cells) > len(names) else ""
            yield f"{label}:{number}  {len(cells)} cells where the header has {len(names)}{hint}"
            continue
        for name, cell in zip(names, cells, strict=True):
            if kinds.get(name) == "number" and (wrong := _wrong_number(cell)):
                yield f"{label}:{number}  {name}: {wrong}"


def _wrong_number(cell: str) -> str:
    """Why a cell is not a number, or ''."""
    text = cell.strip(" \t")
    if not text and not cell:
        return ""
    if text.lower().lstrip("+-") in ("nan", "inf", "infinity"):
        return f"found {cell!r} (allowed: a finite number, or an empty cell where it is missing)"
    if not _NUMBER.fullmatch(text):
        hint = " A decimal comma? Write 1.5, not 1,5." if text.count(",") == 1 else ""
        if _DATE_OR_TIME.match(text):
            hint = " A date or time of day? `errpipe import` converts it to seconds."
        return f"{cell!r} is not a number (allowed: a number, or an empty cell where it is missing).{hint}"
    return "" if math.isfinite(float(text)) else f"{cell!r} is too large for a number"


# ---------------------------------------------------------------- Parquet


def _parquet_blocks(path: Path, kinds: Kinds, label: str) -> Iterator[Block]:
    try:
        yield from _parquet_batches(path, kinds, label)
    except (pa.ArrowException, OSError, ValueError, OverflowError):
        raise DataError(f"{label}: not a Parquet file, or one that is damaged or still being written") from None


def _parquet_batches(path: Path, kinds: Kinds, label: str) -> Iterator[Block]:
    names = pq.read_schema(path)
    labels = [f.name for f in names if kinds.get(f.name) == "label" and pa.types.is_string(f.type)]
    with pq.ParquetFile(path, pre_buffer=False, read_dictionary=labels) as file:
        check_columns(file.schema_arrow.names, kinds, label)
        wanted = [n for n in kinds if kinds[n] != "ignore"]
        for name in wanted:
            _check_type(file.schema_arrow.field(name), kinds[name], label)
        cells = file.metadata.num_rows * len(wanted)
        if cells > max(MIN_CELLS_JUDGED, MAX_CELLS_PER_BYTE * path.stat().st_size):
            size = f"{path.stat().st_size} bytes that unpack to {cells} cells"
            raise DataError(f"{label}: {size} (measured readings take a byte or more each: is every row the same?)")
        start = 0
        for batch in file.iter_batches(batch_size=131072, columns=wanted, use_threads=pa.cpu_count() > 1):
            table = pa.table({n: _plain(batch.column(n), kinds[n]) for n in wanted})
            place = partial(_place, label, start + 1)
            _refuse_infinite(table, place)
            start += table.num_rows
            if table.num_rows:
                yield Block(table, place)


def _place(label: str, first: int, row: int) -> str:
    return f"{label} row {first + row}"


def _check_type(field: pa.Field, kind: str, label: str) -> None:
    inner = field.type.value_type if pa.types.is_dictionary(field.type) else field.type
    number = pa.types.is_integer(inner) or pa.types.is_floating(inner) or pa.types.is_boolean(inner)
    text = pa.types.is_string(inner) or pa.types.is_large_string(inner)
    if kind == "number" and not (number or pa.types.is_null(inner)):
        hint = "; `errpipe import` converts times to seconds" if pa.types.is_temporal(inner) else ""
        raise DataError(f"{label}  {field.name}: holds {field.type} (allowed: numbers{hint})")
    if kind == "label" and not (text or pa.types.is_integer(inner) or pa.types.is_boolean(inner)):
        raise DataError(f"{label}  {field.name}: holds {field.type} (allowed for a label: text or whole numbers)")


def _plain(column: pa.Array, kind: str) -> pa.Array:
    if pa.types.is_dictionary(column.type):
        if kind == "label" and not column.null_count and not column.dictionary.null_count:
            labels = pa.DictionaryArray.from_arrays(column.indices.cast(pa.int32()), _plain(column.dictionary, kind))
            return labels
        column = column.dictionary_decode()
    if kind == "label":
        text = column.cast(pa.string()).fill_null("")
        text.validate(full=True)  # a damaged page may hold bytes that are no UTF-8
        return text
    if pa.types.is_boolean(column.type):
        column = column.cast(pa.int8())
    return column.cast(pa.float64(), safe=False)


def _refuse_infinite(table: pa.Table, place: Callable[[int], str]) -> None:
    for name, column in zip(table.column_names, table.columns, strict=True):
        if pa.types.is_floating(column.type):
            values = column.to_numpy()
            with np.errstate(over="ignore", invalid="ignore"):
                if np.isfinite(np.sum(values)):  # then each of them is
                    continue
            bad = np.flatnonzero(np.isinf(values))
            if bad.size:
                raise DataError(f"{place(int(bad[0]))}  {name}: is infinite (allowed: a finite number, or none)")


def parquet_schema(columns: Mapping[str, Mapping[str, str]]) -> pa.Schema:
    """Schema of a recording's table. columns: name -> manifest entry; units are stored in the field metadata."""
    fields = []
    for name, facts in columns.items():
        kind = pa.string() if facts["role"] in ("run", "group") else pa.float64()
        fields.append(pa.field(name, kind, metadata={k: v for k, v in facts.items() if k in ("role", "unit")}))
    return pa.schema(fields, metadata={"errpipe.recording": "1"})


def write_parquet(
    path: Path, schema: pa.Schema, parts: Iterator[pa.Table], facts: Callable[[], Mapping[str, str]]
) -> int:
    """Write parts as row groups, one after the other; the file appears whole, and only if its bytes change.

    facts: what the file says of all its rows, asked for when they are written. Returns the number of rows. Equal parts
    give equal bytes (with one version of pyarrow).
    """
    rows = 0
    # Measured readings hardly repeat, so dictionaries of them cost three times the processor time and save 10 %.
    numbers = [f.name for f in schema if pa.types.is_floating(f.type)]
    labels = [f.name for f in schema if f.name not in numbers]
    encoding = {"use_dictionary": labels, "use_byte_stream_split": numbers}
    with (
        files.whole(path) as stream,
        pq.ParquetWriter(stream, schema, version="2.6", compression="snappy", **encoding) as writer,
    ):
        for part in parts:
            writer.write_table(part, row_group_size=max(part.num_rows, 1))
            rows += part.num_rows
        writer.add_key_value_metadata(dict(facts()))
    return rows
