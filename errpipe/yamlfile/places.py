"""Where things stand in a file, and how a message names them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

Place = tuple[str | int, ...]  # keys and list positions from the top, such as ("stages", 2, "alpha")


@dataclass(frozen=True)
class Location:
    """Where a value and its key stand (line, column from 1); `origin` replaces the file's name (`--set a=1`)."""

    value: tuple[int, int] = (0, 0)
    key: tuple[int, int] | None = None
    origin: str | None = None


def dotted(place: Place) -> str:
    """`terms[1].lead` for ("terms", 1, "lead")."""
    text = ""
    for step in place:
        text += f"[{step}]" if isinstance(step, int) else f".{step}" if text else str(step)
    return text


def describe(value: Any) -> str:
    """A value in words for a message."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int | float):
        return f"the number {value}"
    if isinstance(value, str):
        return f"the text {(value[:60] + '…' if len(value) > 60 else value)!r}"
    return "a list" if isinstance(value, list) else "a mapping"
