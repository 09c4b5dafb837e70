"""MATLAB files (.mat): version 5 to 7 by scipy, version 7.3 by h5py (extra `hdf`). Vectors are columns.

Structures of any depth are read (errpipe/importing/structures.py).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.readers.hdf5 import refuse_linked_data
from errpipe.importing.sheet import ReaderOptions, Sheet
from errpipe.importing.structures import LONGEST_TEXT, Node, put, sheets_of

name = "MATLAB"
suffixes = (".mat",)
binary = True


def sniff(path: Path, head: bytes) -> bool:
    """The text header of a MATLAB file."""
    return head.startswith(b"MATLAB ")


def read(path: Path, options: ReaderOptions) -> list[Sheet]:
    """The sheets of a file, the largest first. Raises DataError."""
    root = Node("")
    if path.read_bytes()[:20].startswith(b"MATLAB 7.3"):
        _newer(path, root)
    else:
        from scipy.io import loadmat

        try:
            file = loadmat(path, squeeze_me=True, struct_as_record=True)
        except MemoryError:
            raise
        except Exception as err:  # scipy raises ValueError, TypeError, zlib.error, ... for damaged files
            raise DataError(
                f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it again, or as CSV"
            ) from None
        for key, value in file.items():
            if not key.startswith("__"):
                put(root, key, value)
    return sheets_of(root, path, options.sheet)


def _newer(path: Path, root: Node) -> None:
    try:
        import h5py
    except ImportError:
        raise DataError(f"{path}: MATLAB 7.3 needs h5py: pip install 'errpipe[hdf]', or save it with -v7") from None
    nodes = {"": root}

    def visit(key: str, item: Any) -> None:
        parent, _, leaf = key.rpartition("/")
        if key.startswith("#") or parent not in nodes:
            return
        if isinstance(item, h5py.Group):
            nodes[key] = Node(leaf)
            nodes[parent].within.append(nodes[key])
        elif item.attrs.get("MATLAB_class") == b"char" and item.size <= LONGEST_TEXT:
            nodes[parent].texts[leaf] = "".join(map(chr, np.ravel(item[()], order="F")))
        elif item.dtype.kind in "iuf":
            refuse_linked_data(path, key, item)
            array = np.squeeze(item[()]).T
            if array.ndim in (1, 2):
                nodes[parent].arrays[leaf] = array

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except (DataError, MemoryError):
        raise
    except Exception as err:  # h5py raises OSError, RuntimeError, ValueError for damaged files
        raise DataError(
            f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it again, or as CSV"
        ) from None
