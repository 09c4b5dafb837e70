"""A recording's manifest as YAML 1.2, and the mark at its end that shows whether a person changed it since."""

from __future__ import annotations

import hashlib
import json
import re
from typing import Any

from errpipe.domain.recording import Manifest

_PLAIN = re.compile(r"[A-Za-z_][\w./-]*", re.ASCII)
MARK = "# As imported: "  # before the identity of what was written
_NOT_TEXT = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")  # to one YAML reader or another


def manifest_text(manifest: Manifest) -> str:
    """The manifest as YAML 1.2, one line a column; equal manifests give equal text."""
    lines = [f"recording: {manifest.recording}"]
    lines += [f"{key}: {scalar(getattr(manifest, key))}" for key in ("title", "machine") if getattr(manifest, key)]
    lines.append(f"tables: [{', '.join(map(scalar, manifest.tables))}]")
    for key, entries in (("constants", manifest.constants), ("columns", manifest.columns)):
        if entries:
            lines.append(f"{key}:")
            plain = {n: e.model_dump(mode="json", exclude_defaults=True) for n, e in entries.items()}
            lines += [f"  {scalar(n)}: {flow(e)}" for n, e in plain.items()]
    return "\n".join(lines) + "\n"


def flow(entry: dict[str, Any]) -> str:
    """Plain data as one line of YAML 1.2."""
    return "{" + ", ".join(f"{k}: {scalar(v)}" for k, v in entry.items()) + "}"


def scalar(value: Any) -> str:
    """A value within a line of YAML 1.2; text is quoted where a reader could take it for something else."""
    if isinstance(value, dict):
        return flow(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(scalar, value)) + "]"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _NOT_TEXT
        quoted = json.dumps(value, ensure_ascii=False)
        return value if plain else "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in quoted)
    return json.dumps(value)


def marked(manifest: str, table: str) -> str:
    """The manifest with the mark: a comment of YAML."""
    return f"{manifest}{MARK}{_identity(manifest, table)}\n"


def is_unchanged(manifest: str, table: str) -> bool:
    """Whether a marked manifest and its table are as they were written."""
    text, mark, identity = manifest.partition(MARK)
    return bool(mark) and identity.strip() == _identity(text, table)


def _identity(manifest: str, table: str) -> str:
    return hashlib.sha256(f"{manifest}{table}".encode()).hexdigest()[:16]
