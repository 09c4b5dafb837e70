"""Rows of a longer recording as arrays, without a pandas frame: making one takes as long as reading them."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

from errpipe.domain.recording import Manifest, Past, Recording

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd


class Batch(Recording):
    """Some rows of a recording. columns: name -> (rows,), float64, or a dictionary array of labels (pyarrow).

    Its frame is made where somebody asks for it.
    """

    columns: dict[str, Any]

    def __init__(self, manifest: Manifest, columns: dict[str, Any], rows: int, past: Past | None = None):
        self.__dict__.update(manifest=manifest, columns=columns, rows=rows, between="held", past=past)
        labels = {n for n, values in columns.items() if hasattr(values, "dictionary")}
        self.__dict__["_arrays"] = {n: values for n, values in columns.items() if n not in labels}
        if (run := self.name("run")) is not None:
            self.__dict__.update(zip(("_codes", "run_starts"), _runs(columns[run]), strict=True))

    def __len__(self) -> int:
        return int(self.__dict__["rows"])

    def names(self, role: str, *, axis: str | None = None, component: str | None = None) -> tuple[str, ...]:
        """Column names of a role that are present in the rows, in manifest order."""
        return tuple(n for n in self.manifest.names(role, axis=axis, component=component) if n in self.columns)

    @cached_property
    def frame(self) -> pd.DataFrame:
        """The rows as pandas has them, labels as categories."""
        import pandas as pd

        made = {n: v.to_pandas() if hasattr(v, "dictionary") else v for n, v in self.columns.items()}
        return pd.DataFrame(made, copy=False)

    def take(self, rows: Any) -> Batch:
        """The batch with only the rows of a boolean mask or an index array."""
        import numpy as np

        rows = np.flatnonzero(rows) if getattr(rows, "dtype", None) == "bool" else rows
        return Batch(self.manifest, {n: values.take(rows) for n, values in self.columns.items()}, len(rows))


def joined(parts: Sequence[Recording]) -> pd.DataFrame:
    """The rows of several parts of a recording, one after the other."""
    import numpy as np
    import pandas as pd
    import pyarrow as pa

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


def _runs(run: Any) -> tuple[tuple[np.ndarray, tuple[str, ...]], np.ndarray]:
    """Codes and labels of runs in order of appearance, and where stretches of a run start; run: dictionary array."""
    import numpy as np

    index = run.indices.to_numpy()
    starts = np.r_[0, np.flatnonzero(index[1:] != index[:-1]) + 1] if index.size else np.zeros(0, dtype=np.int64)
    heads = index[starts]
    order = list(dict.fromkeys(heads.tolist()))
    code_of = np.empty(max(order, default=-1) + 1, dtype=np.int64)
    code_of[order] = np.arange(len(order))
    codes = np.repeat(code_of[heads], np.diff(starts, append=index.size))
    labels = run.dictionary.to_pylist()
    return (codes, tuple(labels[k] for k in order)), starts
