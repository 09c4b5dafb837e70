"""What the tests of all generators ask of the folders that they write."""

from __future__ import annotations

from pathlib import Path


def assert_same_files(one: Path, other: Path, count: int | None = None) -> None:
    """Two folders hold the same files, byte for byte, and so many where a number is given."""
    names = [sorted(p.relative_to(at) for p in at.rglob("*") if p.is_file()) for at in (one, other)]
    assert names[0] == names[1] and len(names[0]) == (count or len(names[0])) > 0
    for name in names[0]:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name
