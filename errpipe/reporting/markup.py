"""Text from outside in a page of Markdown, and in a workflow command of GitHub Actions."""

from __future__ import annotations


def plain_text(text: object) -> str:
    """Text with Markdown markup escaped: labels come from the recording."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>#|!" else c for c in " ".join(str(text).split()))


def workflow_command(kind: str, message: object, **properties: object) -> str:
    """One line, escaped as the runner asks. kind: error, warning or notice; properties: such as file, line, title."""
    stated = ",".join(f"{n}={_data(v).replace(':', '%3A').replace(',', '%2C')}" for n, v in properties.items())
    return f"::{kind} {stated}::{_data(message)}"


def _data(text: object) -> str:
    return str(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
