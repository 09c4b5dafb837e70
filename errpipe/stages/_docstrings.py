"""The docstrings of plug-ins, read: what it is, and its sections such as the equation of a term."""

from __future__ import annotations

import inspect
import re

# `Equation   text`: two spaces or more after the word, continued by indentation.
_SECTION = re.compile(r"^([A-Z][A-Za-z-]+) {2,}(\S.*)$")


def sections(docstring: str) -> tuple[str, list[tuple[str, str]]]:
    """First paragraph of a docstring, and its sections (heading, text with its own line breaks)."""
    lines = inspect.cleandoc(docstring).splitlines()
    head: list[str] = []
    parts: list[tuple[str, list[str]]] = []
    for line in lines:
        match = _SECTION.match(line)
        if match:
            parts.append((match.group(1), [match.group(2)]))
        elif parts and line.startswith("   "):
            parts[-1][1].append(line.strip())
        elif not parts:
            head.append(line)
    return " ".join(" ".join(head).split()), [(word, "\n".join(text)) for word, text in parts]


def equation(term: type) -> str:
    """The equation of a term in one line, with its units; empty where its docstring states none."""
    return " ".join(dict(sections(term.__doc__ or "")[1]).get("Equation", "").split())
