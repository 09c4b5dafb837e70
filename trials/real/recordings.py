"""Real recordings, found in folders: recording folders and vendor files that errpipe reads."""

from __future__ import annotations

import sys
from pathlib import Path

from trials import folder


def sources(paths: list[Path]) -> list[tuple[str, folder.Sheet]]:
    """(name, sheet) of every recording in these folders, in canonical units; keys are never read.

    What errpipe refuses to read is left out, with a line on standard error.
    """
    out = []
    for path in paths:
        if (path / "recording.yaml").is_file() or path.is_file():
            out += _read(path)
        elif path.is_dir():
            out += sources(sorted(p for p in path.iterdir() if p.is_dir() or p.suffix in (".dat", ".rtl")))
    return out


def _read(path: Path) -> list[tuple[str, folder.Sheet]]:
    from errpipe.errors import ErrpipeError
    from errpipe.formats import read

    try:
        recording = read(path)
    except ErrpipeError as err:
        print(f"{path.name} is left out: {str(err).splitlines()[0]}", file=sys.stderr)
        return []
    columns = {n: c.model_dump(exclude_none=True) for n, c in recording.manifest.columns.items() if c.role != "ignore"}
    facts = {n: c.model_dump(exclude_none=True) for n, c in recording.manifest.constants.items()}
    facts = {n: {k: list(v) if isinstance(v, tuple) else v for k, v in c.items()} for n, c in facts.items()}
    title = recording.manifest.title or path.stem
    return [(path.stem, folder.Sheet(title, recording.frame, columns, recording.manifest.machine or path.stem, facts))]
