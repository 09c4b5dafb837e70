"""Rows of results that come in parts, written as one CSV or Parquet file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import IO, Any

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from errpipe import files


def write(path: Path, frames: Iterator[pd.DataFrame]) -> dict[str, Any]:
    """Write parts of equal columns one after the other; the file appears when all are in. Its `rows` and `columns`."""
    first = next(frames)
    put = _parquet if path.suffix == ".parquet" else _csv
    with files.whole(path) as stream:
        rows = put(stream, first, chain([first], frames))
    return {"rows": rows, "columns": list(first.columns)}


def _csv(stream: IO[bytes], first: pd.DataFrame, frames: Iterable[pd.DataFrame]) -> int:
    rows = 0
    for frame in frames:
        stream.write(frame.to_csv(index=False, header=rows == 0, lineterminator="\n").encode())
        rows += len(frame)
    return rows


def _parquet(stream: IO[bytes], first: pd.DataFrame, frames: Iterable[pd.DataFrame]) -> int:
    rows, schema = 0, pa.schema([pa.field(n, _kind(first[n])) for n in first.columns])
    with pq.ParquetWriter(stream, schema, version="2.6", compression="snappy", use_dictionary=["run"]) as writer:
        for frame in frames:
            writer.write_table(pa.Table.from_pandas(frame, schema, preserve_index=False))
            rows += len(frame)
    return rows


def _kind(column: pd.Series) -> Any:
    return {"f": pa.float64(), "i": pa.int64()}.get(column.dtype.kind, pa.string())
