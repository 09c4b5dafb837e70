"""HDF5 files (.h5, .hdf5), by h5py (extra `hdf`). Data sets of one length are the columns of a sheet.

A two-dimensional or compound data set is a separate sheet; an attribute `units` or `unit` is the unit.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.errors import DataError, UsageError
from errpipe.importing.sheet import ReaderOptions, Sheet, affordable, readable

name = "HDF5"
suffixes = (".h5", ".hdf5", ".hdf", ".nc")
binary = True
SIGNATURE = b"\x89HDF\r\n\x1a\n"
MOST_SETS = 200  # data sets of one file
MOST_COLUMNS = 64  # of a matrix


def sniff(path: Path, head: bytes) -> bool:
    """The signature of HDF5, but not a MATLAB file, which has another header before it."""
    return head.startswith(SIGNATURE)


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """Sheets of columns with one length. Raises DataError."""
    datasets: list[tuple[str, Any, str]] = []

    def visit(key: str, item: Any) -> None:
        if getattr(item, "size", 0) and len(datasets) < MOST_SETS:
            refuse_linked_data(path, key, item)
            datasets.append((key, item[()], _unit(item)))

    visit_items(path, "an HDF5 file", visit)
    return [s.limited() for s in sheets_of(datasets, path.stem) if options.sheet in (None, s.name)]


def visit_items(path: Path, what: str, visit: Callable[[str, Any], None]) -> None:
    """Call a function with the path and the object of everything in a file. Raises DataError, UsageError."""
    try:
        import h5py
    except ImportError:
        raise UsageError(f"{path}: reading {what} needs h5py: pip install 'errpipe[hdf]'") from None
    with readable(path, what), h5py.File(path, "r") as file:
        file.visititems(visit)


def refuse_linked_data(path: Path, key: str, item: Any) -> None:
    """Raise DataError if a data set stores its values in other files, or declares more of them than are imported."""
    if item.external or item.is_virtual:
        raise DataError(f"{path}: {key} stores its values in another file (copy them into this one)")
    affordable(item.size, f"{path}: {key}")


def _unit(item: Any) -> str:
    for key in ("units", "unit"):
        value = item.attrs.get(key)
        if value is not None:
            return value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
    return ""


def sheets_of(datasets: list[tuple[str, Any, str]], stem: str) -> list[Sheet]:
    """(name, array, unit) of every data set as sheets: columns of one length and group form a sheet."""
    groups: dict[tuple[str, int], list[tuple[str, Any, str]]] = {}
    matrices = []
    for key, value, unit in datasets:
        array = np.squeeze(np.asarray(value))
        group, _, leaf = key.rpartition("/")
        if array.dtype.names:
            parts = [(n, array[n], "") for n in array.dtype.names if array[n].ndim == 1]
            groups.setdefault((key, array.size), []).extend(parts)
        elif array.ndim == 1 and array.size > 1:
            groups.setdefault((group, array.size), []).append((leaf, array, unit))
        elif array.ndim == 2 and array.dtype.kind in "iuf" and array.shape[1] <= MOST_COLUMNS:
            matrices.append((group, leaf, array, unit))
    sheets = [Sheet(f"{g}/{n}".strip("/"), np.asarray(a, dtype=float).tolist()) for g, n, a, _ in matrices]
    for (group, length), parts in groups.items():
        parts += [part for g, n, a, u in matrices if g == group for part in columns_of(n, a, u, length)]
    for (group, length), parts in reversed(groups.items()):
        header = [f"{n} [{u}]" if u else n for n, _, u in parts]
        columns = [_cells(a) for _, a, _ in parts]
        sheets.insert(0, Sheet(group or stem, [[c[i] for c in columns] for i in range(length)], header))
    return sorted(sheets, key=lambda s: -sum(map(len, s.rows)))


def columns_of(name: str, matrix: np.ndarray, unit: str, length: int) -> list[tuple[str, np.ndarray, str]]:
    """The columns of a matrix with the length of the vectors: readings of several runs."""
    if matrix.shape[0] != length and matrix.shape[1] == length:
        matrix = matrix.T
    runs = range(matrix.shape[1] if len(matrix) == length else 0)
    return [(f"run {k + 1} {name}", matrix[:, k], unit) for k in runs]


def _cells(array: np.ndarray) -> list[Any]:
    if array.dtype.kind in "iufb":
        return np.asarray(array, dtype=float).tolist()
    return [v.decode("utf-8", "replace") if isinstance(v, bytes) else str(v) for v in array]
