"""Workflow commands of GitHub Actions: a line that marks a place in a file, or the run, with a message."""

from __future__ import annotations


def workflow_command(kind: str, message: object, **properties: object) -> str:
    """One line, escaped as the runner asks. kind: error, warning or notice; properties: such as file, line, title."""
    stated = ",".join(f"{n}={_data(v).replace(':', '%3A').replace(',', '%2C')}" for n, v in properties.items())
    return f"::{kind} {stated}::{_data(message)}"


def _data(text: object) -> str:
    return str(text).replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")
