"""A file of errpipe has at most 400 lines, a function at most 60; what is longer stands here with its reason."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import errpipe

TOP = Path(errpipe.__file__).parent
MOST_LINES = {"file": 400, "function": 60}

# what is longer -> why; an entry that is no longer needed fails too
ARGUMENTS = "a signature with one documented option per argument; the body is short"
ONE_LOOP = "one compiled loop: calls out of it cost more than they explain"
LONGER = {
    "cli/import.py:command": ARGUMENTS,
    "kernels/evidence.py:scores": ONE_LOOP,
    "kernels/table_nodes.py:run_nodes": "one branch per operation of a table, in the order of the specification",
    "domain/table.py": "one document and what makes it a valid one",
    "tables/ect.py": "writer and reader of one file format, section by section, side by side",
    "tables/reference.py": "the second opinion on the cycle, step by step as the specification has it, in one place",
}


def lengths(source: str) -> Iterator[tuple[str, str, int]]:
    """(kind, name, lines) of a file and of every function in it."""
    yield "file", "", len(source.splitlines())
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield "function", f":{node.name}", (node.end_lineno or 0) - node.lineno + 1


def longer() -> set[str]:
    """What is longer than the limit, as file or file:function."""
    return {
        f"{path.relative_to(TOP).as_posix()}{name}"
        for path in TOP.rglob("*.py")
        for kind, name, lines in lengths(path.read_text(encoding="utf-8"))
        if lines > MOST_LINES[kind]
    }


def test_what_is_long_says_why() -> None:
    found = longer()
    assert found <= set(LONGER), f"longer than the limit: {sorted(found - set(LONGER))}"
    assert found == set(LONGER), f"short enough now, no reason needed: {sorted(set(LONGER) - found)}"


def test_a_long_function_is_seen() -> None:
    source = "def f():\n" + "    x = 1\n" * 60
    assert [lines for kind, _, lines in lengths(source) if lines > MOST_LINES[kind]] == [61]
