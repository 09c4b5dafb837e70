"""Real recordings, found in folders: recording folders and vendor files that errpipe reads."""

from __future__ import annotations

from pathlib import Path

from trials import folder


def sources(paths: list[Path]) -> list[tuple[str, folder.Sheet]]:
    """(name, sheet) of every recording in these folders; simulated columns are left aside, keys are never read."""
    found = []
    for path in paths:
        if (path / "recording.yaml").is_file():
            found.append((path.name, folder.read(path)))
        elif path.is_dir():
            found += sources(sorted(p for p in path.iterdir() if p.is_dir() or p.suffix in (".dat", ".rtl")))
        elif path.is_file():
            found.append((path.stem, measured(path)))
    return found


def measured(path: Path) -> folder.Sheet:
    """A vendor's measurement file, by errpipe's own reader."""
    from errpipe.formats import read as read_file

    recording = read_file(path)
    columns = {n: c.model_dump(exclude_none=True) for n, c in recording.manifest.columns.items()}
    facts = {n: c.model_dump(exclude_none=True) for n, c in recording.manifest.constants.items()}
    facts = {n: {k: list(v) if isinstance(v, tuple) else v for k, v in c.items()} for n, c in facts.items()}
    return folder.Sheet(recording.manifest.title or path.stem, recording.frame, columns, path.stem, facts)
