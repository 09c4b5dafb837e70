"""Results on standard output (text, or one JSON document); messages and progress on standard error.

The JSON document, version 1, is the same for every verb, also when it fails:

    {"errpipe": 1, "command": "run", "ok": true,  "exit_code": 0, "result": {...}}
    {"errpipe": 1, "command": "run", "ok": false, "exit_code": 2, "error": {"kind": "ConfigError",
     "message": "...", "problems": [{"file": "...", "line": 7, "column": 11, "key": "...", "message": "..."}]}}
"""

from __future__ import annotations

import re
import sys
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict
from importlib import import_module
from typing import Any

from errpipe import jsonfile
from errpipe.errors import ConfigError

DOCUMENT = 1  # version of the JSON document around every result
WIDTH = 80  # columns of the narrowest terminal that people use
NARROWEST = 28  # columns in which a sentence can be read


def print_result(
    command: str, result: Mapping[str, Any], lines: Iterable[str] = (), *, as_json: bool, code: int = 0
) -> None:
    """Print the result of a verb: `lines` of text, or `result` as one JSON document."""
    if as_json:
        text = jsonfile.dumps(
            {"errpipe": DOCUMENT, "command": command, "ok": code == 0, "exit_code": code, "result": dict(result)}
        )
    else:
        text = "".join(f"{line}\n" for line in lines)
    sys.stdout.write(text)


def print_answer(command: str, result: Mapping[str, Any], *, as_json: bool) -> None:
    """Print the result of a stage function: its "says" (lines of text), or every key with its value."""
    result = dict(result)
    says = result.pop("says", None)
    lines = says if says is not None else [f"{key}: {short_value(value)}" for key, value in result.items()]
    print_result(command, result, folded([lines] if isinstance(lines, str) else lines), as_json=as_json)


def folded(lines: Iterable[str]) -> list[str]:
    """Text lines within `WIDTH` columns: longer ones are wrapped below their second column, or indented.

    Words, and so paths, are never broken; rows of figures and drawings (one `|`) stay as they are. Tables in
    Markdown become aligned columns.
    """
    out: list[str] = []
    for line in _without_markdown_tables([part for text in lines for part in text.splitlines() or [""]]):
        if len(line) <= WIDTH or line.startswith("|") or line.count("|") % 2 or "\x1b" in line:
            out.append(line)
            continue
        column = re.match(r"(\s*)(\S+(?: \S+)?\s{2,})?", line)
        own, second = (len(column[1]), len(column[2] or "")) if column is not None else (0, 0)
        below = own + second if second and own + second <= WIDTH // 2 else own + (2 if own else 0)
        head, rest = line[: own + second], line[own + second :]
        words = textwrap.wrap(rest, WIDTH - len(head), break_long_words=False, break_on_hyphens=False)
        first = words[0] if words else ""
        more = textwrap.wrap(rest[len(first) :].strip(), WIDTH - below, break_long_words=False, break_on_hyphens=False)
        out += [head + first, *(" " * below + text for text in more)]
    return out


def _without_markdown_tables(lines: list[str]) -> Iterator[str]:
    at = 0
    while at < len(lines):
        if lines[at].startswith("| ") and at + 1 < len(lines) and re.fullmatch(r"\|( -+:? \|)+", lines[at + 1]):
            end = next((k for k in range(at, len(lines)) if not lines[k].startswith("| ")), len(lines))
            rows = [re.split(r"(?<!\\)\|", line)[1:-1] for line in (lines[at], *lines[at + 2 : end])]
            yield from _aligned([[c.strip().replace("`", "").replace("\\|", "|") for c in row] for row in rows])
            at = end
        else:
            yield lines[at]
            at += 1


def _aligned(rows: list[list[str]]) -> Iterator[str]:
    """Rows in columns; the last one is wrapped below itself, or below the row if the others leave no space."""
    used = [i for i in range(len(rows[0])) if any(row[i] for row in rows[1:])]
    rows = [[row[i] for i in used] for row in rows]
    widths = [max(len(row[i]) for row in rows) for i in range(len(used))]
    left = sum(widths[:-1]) + 2 * (len(used) - 1)
    below = left if WIDTH - left >= min(widths[-1], NARROWEST) else 4
    for row in rows:
        head = "".join(f"{cell:<{width}}  " for cell, width in zip(row[:-1], widths[:-1], strict=True))
        parts = textwrap.wrap(row[-1], WIDTH - below, break_long_words=False, break_on_hyphens=False) or [""]
        if below < left:
            parts = ["", *parts]
            head = "  ".join(cell for cell in row[:-1] if cell)
        yield from (f"{head}{parts[0]}".rstrip(), *(" " * below + part for part in parts[1:]))


def short_value(value: Any) -> str:
    """A result's value in a line."""
    if isinstance(value, float):
        return f"{value:.4g}"
    return value if isinstance(value, str) else jsonfile.dumps(value, indent=None).strip()


def print_error(command: str, message: str, code: int, as_json: bool, err: Exception | None = None) -> int:
    """Print an error message (and the JSON document that holds it); returns the exit code."""
    sys.stdout.flush()
    sys.stderr.write(message + "\n")
    if as_json:
        error: dict[str, Any] = {"kind": type(err).__name__ if err is not None else "Error", "message": message}
        if isinstance(err, ConfigError):
            error["problems"] = [asdict(problem) for problem in err.problems]
        document = {"errpipe": DOCUMENT, "command": command, "ok": False, "exit_code": code, "error": error}
        sys.stdout.write(jsonfile.dumps(document))
    return code


def module_of(name: str) -> Any:
    """The module that does the work of a command (such as verbs.check), imported only now."""
    return import_module(f"errpipe.{name}")
