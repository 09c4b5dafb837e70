"""MATLAB files (.mat): version 5 to 7 by scipy, version 7.3 by h5py (extra `hdf`). Vectors are columns.

Structures of any depth are read (errpipe/importing/structures.py).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from errpipe.importing.readers.hdf5 import refuse_linked_data, visit_items
from errpipe.importing.sheet import ReaderOptions, Sheet, readable
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

        with readable(path, "a MATLAB file"):
            file = loadmat(path, squeeze_me=True, struct_as_record=True)
        for key, value in file.items():
            if not key.startswith("__"):
                put(root, key, value)
    return sheets_of(root, path, options.sheet)


def _newer(path: Path, root: Node) -> None:
    nodes = {"": root}

    def visit(key: str, item: Any) -> None:
        parent, _, leaf = key.rpartition("/")
        if key.startswith("#") or parent not in nodes:
            return
        if hasattr(item, "keys"):
            nodes[key] = Node(leaf)
            nodes[parent].within.append(nodes[key])
        elif item.attrs.get("MATLAB_class") == b"char" and item.size <= LONGEST_TEXT:
            nodes[parent].texts[leaf] = "".join(map(chr, np.ravel(item[()], order="F")))
        elif item.dtype.kind in "iuf":
            refuse_linked_data(path, key, item)
            array = np.squeeze(item[()]).T
            if array.ndim in (1, 2):
                nodes[parent].arrays[leaf] = array

    visit_items(path, "a MATLAB file", visit)
