"""MATLAB files (.mat): version 5 to 7 by scipy, version 7.3 by h5py (extra `hdf`). Vectors are columns.

Structures of any depth are read: vectors of one length, also of structures within, are the columns of a sheet, called
by the path to it; elements of an array of structures are sheets; texts stand above the sheets that they are about.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.errors import DataError
from errpipe.importing.doors.hdf5 import MOST_COLUMNS, columns_of, refuse_linked_data
from errpipe.importing.sheet import Cell, DoorOptions, Sheet, affordable
from errpipe.importing.units import split_header
from errpipe.importing.words import kind_by_name

name = "MATLAB"
suffixes = (".mat",)
binary = True
LABELS = ("label", "name", "title")  # fields that call the structure they are in
VALUES = ("values", "value", "data")  # fields that are called by the structure they are in
DEEPEST = 12  # structures within one another
LONGEST_TEXT = 200  # letters of a text that is a remark


@dataclass
class _Node:
    """A structure: its vectors and matrices, texts, lists of texts, and the structures within it.

    of: the name of the array of which it is an element.
    """

    key: str
    of: str = ""
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    lists: list[list[str]] = field(default_factory=list)
    within: list[_Node] = field(default_factory=list)

    @property
    def called(self) -> str:
        """What a text within calls it, else its key."""
        return next((self.texts[n] for n in self.texts if n.lower() in LABELS and self.texts[n]), self.key)

    @property
    def full_name(self) -> str:
        """What it is called, behind the name of its array."""
        return f"{self.of} {self.called}" if self.of and self.called != self.key else self.key

    @property
    def lines(self) -> list[str]:
        """Its texts, with the names of their fields."""
        return [f"{k}: {v}" for k, v in self.texts.items() if k.lower() not in LABELS]


def sniff(path: Path, head: bytes) -> bool:
    """The text header of a MATLAB file."""
    return head.startswith(b"MATLAB ")


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """The sheets of a file, the largest first. Raises DataError."""
    root = _Node("")
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
                f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it anew, or as CSV"
            ) from None
        for key, value in file.items():
            if not key.startswith("__"):
                _add(root, key, value)
    affordable(sum(array.size for array in _arrays(root)), path)
    sheets = sorted(_sheets(root, "", path.stem, []), key=lambda s: -sum(map(len, s.rows)))
    chosen = [s for s in sheets if options.sheet in (None, s.name)]
    chosen = chosen or [s for s in sheets if s.name.split(" ")[-1] == options.sheet]
    return [s.limited() for s in chosen]


def _add(node: _Node, key: str, value: Any, depth: int = 0, of: str = "") -> None:
    """Put a variable, a field of a structure, or an element of an array `of` into its node."""
    array = np.asarray(value)
    if depth > DEEPEST:
        return
    if array.dtype.names and array.ndim == 0:
        inner = _Node(key, of)
        for n in array.dtype.names:
            _add(inner, n, array[n].item(), depth + 1)
        node.within.append(inner)
    elif array.dtype.names or (array.dtype.kind == "O" and array.ndim == 1):
        if all(isinstance(v, str) for v in array.flat):
            node.lists.append([str(v) for v in array.flat])
        else:
            for k, element in enumerate(array.flat, 1):
                _add(node, f"{key} {k}", element, depth + 1, key)
    elif array.dtype.kind == "U" and array.ndim == 0:
        node.texts[key] = str(array)[:LONGEST_TEXT]
    elif array.dtype.kind == "U" and array.ndim == 1:
        node.lists.append([str(v).strip() for v in array])
    elif array.dtype.kind in "iufb" and array.ndim in (1, 2):
        node.arrays[key] = array


def _arrays(node: _Node) -> Iterator[np.ndarray]:
    yield from node.arrays.values()
    for inner in node.within:
        yield from _arrays(inner)


def _sheets(node: _Node, path: str, stem: str, lines: list[str]) -> list[Sheet]:
    """The sheets of a structure and those within it. lines: texts of the structures around it."""
    above = [*lines, *node.lines]
    above += [line for inner in node.within if not any(True for _ in _arrays(inner)) for line in inner.lines]
    clocks = _of_one_clock(node)
    own = {**clocks, **node.arrays}
    lengths = dict.fromkeys(a.size for a in own.values() if a.ndim == 1 and a.size > 1)
    sheets = []
    for length in lengths:
        columns = [*_columns(own, "", length)]
        joined = [inner for inner in node.within if not clocks and all(length in a.shape for a in _arrays(inner))]
        columns += [c for inner in joined for c in _of_inner(inner, "", length)]
        cells = [np.asarray(a, dtype=float).tolist() for _, a in columns]
        rows: list[list[Cell]] = [[c[i] for c in cells] for i in range(length)]
        sheets.append(Sheet(path or stem, rows, [n for n, _ in columns], above=above))
    for key, a in node.arrays.items():
        if a.ndim == 2 and a.shape[1] <= MOST_COLUMNS:
            names = next((n for n in node.lists if len(n) == a.shape[1]), None)
            sheets.append(Sheet(f"{path} {key}".strip(), np.asarray(a, dtype=float).tolist(), names, above=above))
    for inner in node.within:
        sheets += _sheets(inner, f"{path} {inner.full_name}".strip(), stem, above)
    return sheets


def _columns(arrays: dict[str, np.ndarray], of: str, length: int) -> Iterator[tuple[str, np.ndarray]]:
    """Vectors of a length, and the columns of matrices beside them; of: what the structure around them is called."""
    for key, array in arrays.items():
        bare = len(arrays) == 1 and key.lower() in VALUES and of
        text = of if bare else " ".join(filter(None, (of, key) if split_header(key)[1] else (key, of)))
        if array.ndim == 1 and array.size == length:
            yield text, array
        elif array.ndim == 2:
            yield from ((n, a) for n, a, _ in columns_of(text, array, "", length))


def _of_inner(node: _Node, of: str, length: int) -> Iterator[tuple[str, np.ndarray]]:
    """Columns of a structure within another one, called by the path from inside out: `forward error_um`."""
    called = f"{node.called} {of}".strip()
    yield from _columns(node.arrays, called, length)
    for inner in node.within:
        yield from _of_inner(inner, called, length)


def _of_one_clock(node: _Node) -> dict[str, np.ndarray]:
    """Signals that each are a structure of a time and values, where their times are the same; else nothing."""
    out: dict[str, np.ndarray] = {}
    for inner in node.within:
        clock = [k for k in inner.arrays if kind_by_name(k) == "time"]
        values = [k for k in inner.arrays if k not in clock]
        if len(clock) != 1 or len(values) != 1 or inner.arrays[clock[0]].shape != inner.arrays[values[0]].shape:
            continue
        first = out.setdefault(clock[0], inner.arrays[clock[0]])
        if np.array_equal(first, inner.arrays[clock[0]]):
            out[inner.called] = inner.arrays[values[0]]
    return out if len(out) > 2 else {}


def _newer(path: Path, root: _Node) -> None:
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
            nodes[key] = _Node(leaf)
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
            f"{path}: not a MATLAB file that can be read ({type(err).__name__}): export it anew, or as CSV"
        ) from None
