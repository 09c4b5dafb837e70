"""Controllers' files of two export folders, compared byte by byte."""

from __future__ import annotations

from pathlib import Path


def differing(old: Path, new: Path) -> list[str]:
    """What differs between the controllers' files of two export folders, edited by hand or not."""
    of_old, of_new = (
        {p.relative_to(d).as_posix(): p.read_bytes() for p in sorted(d.glob("*/*")) if p.is_file()} for d in (old, new)
    )
    differing = [name for name in {**of_old, **of_new} if of_old.get(name) != of_new.get(name)]
    only = {name: f"only in {old if name in of_old else new}" for name in of_old.keys() ^ of_new.keys()}
    return [f"file {only.get(name, 'changed')}: {name}" for name in differing]
