"""Structures of arrays, as MATLAB and numpy files hold them, as sheets.

Vectors of equal length, also in nested structures, are the columns of a sheet, named by the path to them; elements of
an array of structures are sheets, or rows if each contains single values; texts precede the sheets they describe.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from errpipe.importing.readers.hdf5 import MOST_COLUMNS, columns_of
from errpipe.importing.sheet import Cell, Sheet, affordable
from errpipe.importing.units import split_header
from errpipe.importing.words import kind_by_name

LABELS = ("label", "name", "title")  # fields that name the structure they are in
VALUES = ("values", "value", "data")  # fields that are named by the structure they are in
DEEPEST = 12  # depth of nested structures
LONGEST_TEXT = 200  # characters of a text that is a comment


@dataclass
class Node:
    """A structure: its vectors and matrices, texts, lists of texts, and nested structures.

    of: the name of the array of which it is an element.
    """

    key: str
    of: str = ""
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    texts: dict[str, str] = field(default_factory=dict)
    lists: list[list[str]] = field(default_factory=list)
    within: list[Node] = field(default_factory=list)

    @property
    def called(self) -> str:
        """The name given by a text within, else its key."""
        return next((self.texts[n] for n in self.texts if n.lower() in LABELS and self.texts[n]), self.key)

    @property
    def full_name(self) -> str:
        """Its name, after the name of its array."""
        return f"{self.of} {self.called}" if self.of and self.called != self.key else self.key

    @property
    def lines(self) -> list[str]:
        """Its texts, with the names of their fields."""
        return [f"{k}: {v}" for k, v in self.texts.items() if k.lower() not in LABELS]


def put(node: Node, key: str, value: Any, depth: int = 0, of: str = "") -> None:
    """Insert a variable, a field of a structure, or an element of an array `of` into its node."""
    array = np.asarray(value)
    if depth > DEEPEST:
        return
    fields = array.dtype.names or ()
    if fields and (array.ndim == 0 or _are_rows(array)):
        inner = Node(key, of)
        for n in fields:
            put(inner, n, array[n].item() if array.ndim == 0 else np.array(array[n].tolist()), depth + 1)
        node.within.append(inner)
    elif fields or (array.dtype.kind == "O" and array.ndim == 1):
        if all(isinstance(v, str) for v in array.flat):
            node.lists.append([str(v) for v in array.flat])
        else:
            for k, element in enumerate(array.flat, 1):
                put(node, f"{key} {k}", element, depth + 1, key)
    elif array.dtype.kind == "U" and array.ndim == 0:
        node.texts[key] = str(array)[:LONGEST_TEXT]
    elif array.dtype.kind == "U" and array.ndim == 1:
        node.lists.append([str(v).strip() for v in array])
        node.arrays[key] = np.char.strip(array)
    elif array.dtype.kind == "M" and array.ndim == 1:
        node.arrays[key] = np.datetime_as_string(array)
    elif array.dtype.kind in "iufb" and array.ndim in (1, 2):
        node.arrays[key] = array


def _are_rows(array: np.ndarray) -> bool:
    """Whether every element of an array of structures contains single values, as in numpy's structured arrays."""
    return array.ndim == 1 and array.size > 1 and all(np.ndim(v) == 0 for element in array for v in element)


def sheets_of(root: Node, path: Path, name: str | None) -> list[Sheet]:
    """The sheets of a file, the largest first, or those of a name. Raises DataError for too many cells."""
    affordable(sum(array.size for array in _arrays(root)), path)
    sheets = sorted(_sheets(root, "", path.stem, []), key=lambda s: -sum(map(len, s.rows)))
    chosen = [s for s in sheets if name in (None, s.name)]
    return [s.limited() for s in chosen or [s for s in sheets if s.name.split(" ")[-1] == name]]


def _arrays(node: Node) -> Iterator[np.ndarray]:
    yield from node.arrays.values()
    for inner in node.within:
        yield from _arrays(inner)


def _sheets(node: Node, path: str, stem: str, lines: list[str]) -> list[Sheet]:
    """The sheets of a structure and its nested structures. lines: texts of the enclosing structures."""
    above = [*lines, *node.lines]
    above += [line for inner in node.within if not any(True for _ in _arrays(inner)) for line in inner.lines]
    clocks = _of_one_clock(node)
    own = {**clocks, **node.arrays}
    lengths = dict.fromkeys(a.size for a in own.values() if a.ndim == 1 and a.size > 1 and a.dtype.kind != "U")
    sheets = []
    for length in lengths:
        columns = [*_columns(own, "", length)]
        joined = [inner for inner in node.within if not clocks and all(length in a.shape for a in _arrays(inner))]
        columns += [c for inner in joined for c in _of_inner(inner, "", length)]
        cells = [a.tolist() if a.dtype.kind == "U" else np.asarray(a, dtype=float).tolist() for _, a in columns]
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
    """Vectors of a length, and the columns of matrices with that length; of: name of the enclosing structure."""
    for key, array in arrays.items():
        bare = len(arrays) == 1 and key.lower() in VALUES and of
        text = of if bare else " ".join(filter(None, (of, key) if split_header(key)[1] else (key, of)))
        if array.ndim == 1 and array.size == length:
            yield text, array
        elif array.ndim == 2:
            yield from ((n, a) for n, a, _ in columns_of(text, array, "", length))


def _of_inner(node: Node, of: str, length: int) -> Iterator[tuple[str, np.ndarray]]:
    """Columns of a nested structure, named by the path from inside out: `forward error_um`."""
    called = f"{node.called} {of}".strip()
    yield from _columns(node.arrays, called, length)
    for inner in node.within:
        yield from _of_inner(inner, called, length)


def _of_one_clock(node: Node) -> dict[str, np.ndarray]:
    """Signals that are each a structure of a time and values, if their times are equal; else nothing."""
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
