"""A file of errpipe has at most 400 lines, a function at most 60.

A longer file says why in its first lines (`Longer than 400 lines: ...`); a longer function stands here with its reason.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import errpipe
from tests.contract.sources import tree_of

TOP = Path(errpipe.__file__).parent
MOST_LINES = {"file": 400, "function": 60}

# function -> why it is longer; an entry that is no longer needed fails too
LONGER: dict[str, str] = {}


def lengths(source: str) -> Iterator[tuple[str, str, int]]:
    """(kind, name, lines) of a file and of every function in it."""
    yield "file", "", len(source.splitlines())
    for node in ast.walk(tree_of(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield "function", f":{node.name}", (node.end_lineno or 0) - node.lineno + 1


def longer() -> set[str]:
    """Functions longer than the limit; files that are and do not say why, or say why and are not."""
    return {
        f"{path.relative_to(TOP).as_posix()}{name}"
        for path in TOP.rglob("*.py")
        for kind, name, lines in lengths(path.read_text(encoding="utf-8"))
        if (lines > MOST_LINES[kind]) != (kind == "file" and says_why(path))
    }


def says_why(path: Path) -> bool:
    """Whether a file's first lines hold the reason for its length."""
    return "\nLonger than 400 lines: " in "\n".join(path.read_text(encoding="utf-8").splitlines()[:25])


def test_what_is_long_says_why() -> None:
    names = longer()
    assert names <= set(LONGER), f"too long, or a file that needs no reason: {sorted(names - set(LONGER))}"
    assert names == set(LONGER), f"short enough now, no reason needed: {sorted(set(LONGER) - names)}"


def test_a_long_function_is_seen() -> None:
    source = "def f():\n" + "    x = 1\n" * 60
    assert [lines for kind, _, lines in lengths(source) if lines > MOST_LINES[kind]] == [61]
