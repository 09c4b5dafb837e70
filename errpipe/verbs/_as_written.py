"""The mark at the end of a manifest that shows whether a person changed the recording since a command wrote it."""

from __future__ import annotations

import hashlib

MARK = "# As imported: "  # before the identity of what was written


def marked(manifest: str, table: str) -> str:
    """The manifest with the mark: a comment of YAML."""
    return f"{manifest}{MARK}{_identity(manifest, table)}\n"


def as_written(manifest: str, table: str) -> bool:
    """Whether a marked manifest and its table are as they were written."""
    text, mark, identity = manifest.partition(MARK)
    return bool(mark) and identity.strip() == _identity(text, table)


def _identity(manifest: str, table: str) -> str:
    return hashlib.sha256(f"{manifest}{table}".encode()).hexdigest()[:16]
