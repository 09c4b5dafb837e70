"""Syntax trees of many files."""

from __future__ import annotations

import ast
import gc
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import errpipe

TOP = Path(errpipe.__file__).parent


@cache
def tree_of(source: str) -> ast.Module:
    """The tree of a module's text, made once for all tests of this folder; `conftest.py` drops them at its end."""
    return _tree(source)


def _tree(source: str) -> ast.Module:
    """Without searches for garbage, of which there is none: they took three quarters of it."""
    gc.disable()
    try:
        return ast.parse(source)
    finally:
        gc.enable()


def parsed(paths: Iterable[Path]) -> dict[Path, ast.Module]:
    """The tree of each file. Only those of the package are kept: with the tests' own it is half a gigabyte."""
    return {p: (tree_of if TOP in p.parents else _tree)(p.read_text(encoding="utf-8")) for p in paths}
