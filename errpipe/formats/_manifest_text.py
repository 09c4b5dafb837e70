"""A recording's manifest as YAML 1.2."""

from __future__ import annotations

import json
import re
from typing import Any

from errpipe.domain.recording import Manifest

_PLAIN = re.compile(r"[A-Za-z_][\w./-]*", re.ASCII)
_NOT_TEXT = ("true", "false", "null", "yes", "no", "on", "off", "y", "n")  # to one YAML reader or another


def manifest_text(manifest: Manifest) -> str:
    """The manifest as YAML 1.2, one line a column; equal manifests give equal text."""
    lines = [f"recording: {manifest.recording}"]
    lines += [f"{key}: {_scalar(getattr(manifest, key))}" for key in ("title", "machine") if getattr(manifest, key)]
    lines.append(f"tables: [{', '.join(map(_scalar, manifest.tables))}]")
    for key, entries in (("constants", manifest.constants), ("columns", manifest.columns)):
        if entries:
            lines.append(f"{key}:")
            plain = {n: e.model_dump(mode="json", exclude_none=True) for n, e in entries.items()}
            lines += [f"  {_scalar(n)}: {flow(e)}" for n, e in plain.items()]
    return "\n".join(lines) + "\n"


def flow(entry: dict[str, Any]) -> str:
    """Plain data as one line of YAML 1.2."""
    return "{" + ", ".join(f"{k}: {_scalar(v)}" for k, v in entry.items()) + "}"


def _scalar(value: Any) -> str:
    if isinstance(value, dict):
        return flow(value)
    if isinstance(value, list):
        return "[" + ", ".join(map(_scalar, value)) + "]"
    if isinstance(value, str):
        plain = _PLAIN.fullmatch(value) and value.lower() not in _NOT_TEXT
        quoted = json.dumps(value, ensure_ascii=False)
        return value if plain else "".join(c if c.isprintable() else f"\\U{ord(c):08X}" for c in quoted)
    return json.dumps(value)
