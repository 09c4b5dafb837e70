"""A registry as tests use it: its verbs from the command line, and one with entries."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from errpipe.cli.app import main
from errpipe.registry import minisign
from errpipe.registry.store import Registry


def run(where: Path, *words: str | Path, capsys: Any) -> tuple[int, dict[str, Any]]:
    """Exit code and JSON document of one command line, with the keys where a verb takes them."""
    keys = ["--public-key", where / "keys/errpipe.pub"]
    if words[0] in ("promote", "rollback"):
        keys += ["--key", where / "keys/errpipe.key"]
    capsys.readouterr()
    code = main([str(w) for w in (*words, *keys, "--json")])
    return code, json.loads(capsys.readouterr().out)


def filled(where: Path, key: minisign.SecretKey, entries: int = 3) -> Registry:
    store = Registry(where / "reg", key.public)
    for n in range(entries):
        store.append("7", "promote", f"table {n}".encode(), f"because {n}", "2026-01-01T00:00:00Z", key, n)
    return store
