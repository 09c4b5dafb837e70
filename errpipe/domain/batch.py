"""Rows of a longer recording as arrays, without a pandas frame, which takes as long to build as to read."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from errpipe.domain.recording import CarriedState, Manifest, Recording


class Batch(Recording):
    """Some rows of a recording. columns: name -> (rows,), float64; labels as a pyarrow dictionary array or `Stretches`.

    Its frame is made where somebody asks for it.
    """

    columns: dict[str, Any]

    def __init__(self, manifest: Manifest, columns: dict[str, Any], rows: int, past: CarriedState | None = None):
        self.__dict__.update(manifest=manifest, columns=columns, rows=rows, between="held", past=past)
        labels = {n for n, values in columns.items() if hasattr(values, "dictionary")}
        self.__dict__["_arrays"] = {n: values for n, values in columns.items() if n not in labels}

    def __len__(self) -> int:
        return int(self.__dict__["rows"])

    def __contains__(self, name: str) -> bool:
        return name in self.columns

    @cached_property
    def run_stretches(self) -> tuple[list[str], np.ndarray]:
        """Run of each stretch of rows of one run, and the first row of each, (stretches,)."""
        name = self.name("run")
        if name is None:
            return (["1"], np.zeros(1, dtype=np.int64)) if len(self) else ([], np.zeros(0, dtype=np.int64))
        if isinstance(self.columns[name], Stretches):
            return self.columns[name].dictionary, self.columns[name].starts
        index, labels = self.columns[name].indices.to_numpy(), self.columns[name].dictionary.to_pylist()
        starts = np.flatnonzero(np.r_[index[:1] >= 0, index[1:] != index[:-1]])
        return [labels[k] for k in index[starts]], starts

    @cached_property
    def _codes(self) -> tuple[np.ndarray, tuple[str, ...]]:
        runs, starts = self.run_stretches
        number = {label: k for k, label in enumerate(dict.fromkeys(runs))}
        codes = np.array([number[label] for label in runs], dtype=np.int64)
        return np.repeat(codes, np.diff(starts, append=len(self))), tuple(number)

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The rows as pandas has them, labels as categories."""
        made = {n: v.to_pandas() if hasattr(v, "dictionary") else v for n, v in self.columns.items()}
        return pd.DataFrame(made, copy=False)

    def take(self, rows: Any) -> Batch:
        """The batch with only the rows of a boolean mask, an index array or a slice (which copies nothing)."""
        rows = np.flatnonzero(rows) if getattr(rows, "dtype", None) == "bool" else rows
        size = len(range(*rows.indices(len(self)))) if isinstance(rows, slice) else len(rows)
        return Batch(self.manifest, {n: _taken(values, rows) for n, values in self.columns.items()}, size)

    def with_values(self, columns: dict[str, Any]) -> Batch:
        """The rows with other values (arrays) in some columns."""
        return Batch(self.manifest, self.columns | columns, len(self))


class Stretches:
    """Labels, each for a stretch of rows. starts: first row of each, (stretches,). A dictionary array
    only on demand: constructing one takes a tenth of the time of reading a batch.
    """

    def __init__(self, labels: list[str], starts: np.ndarray, rows: int):
        self.dictionary, self.starts, self.rows = labels, starts, rows

    def take(self, rows: Any) -> Any:
        """The labels of some rows, as a dictionary array."""
        rows = np.arange(self.rows)[rows] if isinstance(rows, slice) else rows
        index = np.searchsorted(self.starts, rows, side="right") - 1
        return pa.DictionaryArray.from_arrays(index.astype(np.int32), self.dictionary, safe=False)

    def to_pandas(self) -> pd.Series:
        """The labels of all rows, as categories."""
        return self.take(slice(None)).to_pandas()


def _taken(values: Any, rows: np.ndarray | slice) -> Any:
    """Some rows of a column; of labels by numpy, which takes a third of pyarrow's time."""
    if isinstance(rows, slice) and not isinstance(values, Stretches):
        return values[rows]
    if not hasattr(values, "indices"):
        return values.take(rows)
    return type(values).from_arrays(values.indices.to_numpy().take(rows), values.dictionary, safe=False)


def joined(parts: Sequence[Recording]) -> pd.DataFrame:
    """The rows of several parts of a recording, one after the other."""
    batches = [p for p in parts if isinstance(p, Batch)]
    if len(batches) < len(parts):
        return pd.concat([p.frame for p in parts], ignore_index=True)
    made: dict[str, Any] = {}
    for name, first in batches[0].columns.items():
        values = [b.columns[name] for b in batches]
        text = hasattr(first, "dictionary")
        made[name] = (
            pa.chunked_array([v.cast(pa.string()) for v in values]).to_pandas() if text else np.concatenate(values)
        )
    return pd.DataFrame(made, copy=False)
