"""MATLAB files (.mat): version 5 to 7 by scipy, version 7.3 by h5py (extra `hdf`). Vectors are columns."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.doors.hdf5 import MOST_COLUMNS, columns_of, refuse_linked_data
from errpipe.importing.sheet import DoorOptions, Sheet, affordable

name = "MATLAB"
suffixes = (".mat",)
binary = True


def sniff(path: Path, head: bytes) -> bool:
    """The text header of a MATLAB file."""
    return head.startswith(b"MATLAB ")


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """Variables, and the fields of structures, of one length are the columns of a sheet. Raises DataError."""
    if path.read_bytes()[:20].startswith(b"MATLAB 7.3"):
        arrays = _newer(path)
    else:
        from scipy.io import loadmat

        try:
            file = loadmat(path, squeeze_me=True, struct_as_record=True)
        except MemoryError:
            raise
        except Exception as err:  # scipy raises ValueError, TypeError, zlib.error, ... for damaged files
            raise DataError(
                f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it anew, or as CSV"
            ) from None
        arrays = [part for key, value in file.items() if not key.startswith("__") for part in _parts(key, value)]
    affordable(sum(array.size for _, _, array in arrays), path)
    groups: dict[tuple[str, int], list[tuple[str, np.ndarray]]] = {}
    sheets, matrices = [], []
    for group, key, array in arrays:
        if array.ndim == 1 and array.size > 1:
            groups.setdefault((group, array.size), []).append((key, array))
        elif array.ndim == 2 and array.shape[1] <= MOST_COLUMNS:
            sheets.append(Sheet(key, np.asarray(array, dtype=float).tolist()))
            matrices.append((group, key, array))
    for (group, length), parts in groups.items():
        parts += [(n, a) for g, key, m in matrices if g == group for n, a, _ in columns_of(key, m, "", length)]
        columns = [np.asarray(a, dtype=float).tolist() for _, a in parts]
        sheets.append(
            Sheet(group or path.stem, [[c[i] for c in columns] for i in range(length)], [n for n, _ in parts])
        )
    sheets.sort(key=lambda s: -sum(map(len, s.rows)))
    return [s.limited() for s in sheets if options.sheet in (None, s.name)]


def _parts(key: str, value: Any, group: str = "") -> list[tuple[str, str, np.ndarray]]:
    array = np.asarray(value)
    if array.dtype.names and array.ndim == 0:
        return [part for n in array.dtype.names for part in _parts(n, array[n].item(), key)]
    if array.dtype.kind in "iufb" and array.ndim in (1, 2):
        return [(group, key, array)]
    return []


def _newer(path: Path) -> list[tuple[str, str, np.ndarray]]:
    try:
        import h5py
    except ImportError:
        raise DataError(f"{path}: MATLAB 7.3 needs h5py: pip install 'errpipe[hdf]', or save it with -v7") from None
    arrays: list[tuple[str, str, np.ndarray]] = []

    def visit(key: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and item.dtype.kind in "iuf" and not key.startswith("#refs#"):
            refuse_linked_data(path, key, item)
            group, _, leaf = key.rpartition("/")
            arrays.append((group, leaf, np.squeeze(item[()]).T))

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (DataError, MemoryError):
        raise
    except Exception as err:  # h5py raises OSError, RuntimeError, ValueError for damaged files
        raise DataError(
            f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it anew, or as CSV"
        ) from None
    return arrays
