"""The files in a folder or archive that `errpipe import` is given: what their names state, and which are meant."""

from __future__ import annotations

import hashlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path

from errpipe import formats
from errpipe.errors import DataError
from errpipe.files import MOST_NEIGHBOURS
from errpipe.importing.layout import axis_of_name
from errpipe.importing.proposed import ImportOptions
from errpipe.importing.readers import reader_of


def folders_of(file: Path, place: Path, given: Path) -> tuple[str, ...]:
    """The names of the folders of a file within a folder or archive from the user, that of this one first."""
    top = given.resolve()
    root = place if file.is_relative_to(place) else given
    return (top.name if given.is_dir() else top.stem, *file.relative_to(root).parent.parts)


def refuse_twice(files: Sequence[Path]) -> None:
    """Raise DataError if two files hold the same bytes: a run that is counted twice claims a repeat that is none."""
    seen: dict[bytes, Path] = {}
    for file in map(Path, files):
        if len(files) > 1 and file.is_file():
            with file.open("rb") as stream:
                first = seen.setdefault(hashlib.file_digest(stream, "sha256").digest(), file)
            if first != file or list(files).count(file) > 1:
                raise DataError(f"{file}: the same as {first} (a run is imported once)")


def of_one_axis(
    files: Sequence[Path], inside: Mapping[Path, tuple[str, ...]], options: ImportOptions
) -> tuple[list[Path], list[str]]:
    """The files, of a folder or archive those of one axis if its names state several, and a note on the others.

    Raises DataError if the axis is ambiguous: the files would become runs of one.
    """
    stated = {
        f: next((a for part in (f.stem, *folders[::-1]) for a in axis_of_name(part)), None)
        for f, folders in inside.items()
    }
    letters = sorted({*filter(None, stated.values())})
    if len(letters) > 1 and options.axis is None:
        raise DataError(
            f"files of several axes ({', '.join(letters)}): declare it with --axis {letters[0]}; one recording for each"
        )
    others = [f for f, letter in stated.items() if letter not in (None, options.axis) and options.axis in letters]
    notes = [f"{len(others)} files of other axes than {options.axis}, by their names, were excluded"] if others else []
    ends = {m[1] for f in files if f not in inside and (m := re.search(r"(?:^|[\s_-])([XYZABC])$", Path(f).stem))}
    if len(ends) > 1 and options.axis is None:
        alone = f"errpipe import {files[0]} --out recording-{Path(files[0]).stem[-1]}"
        raise DataError(
            f"{', '.join(Path(f).name for f in files)}: of the axes {', '.join(sorted(ends))}? Import each by "
            f"itself ({alone}), or use --axis if they are runs of one"
        )
    return [f for f in files if f not in others], notes


def only_some(folder: Path) -> str:
    """How to name only some files of a folder: by the most frequent ending of those that can be read."""
    held = [p for p in islice(folder.iterdir(), MOST_NEIGHBOURS) if p.is_file()]
    kinds = Counter(p.suffix for p in held if p.suffix and _may_be_read(p)).most_common(1)
    return f". Or name only the files that are meant: {folder / '*'}{kinds[0][0]}" if kinds else ""


def _may_be_read(file: Path) -> bool:
    """Whether the first bytes of a file are those of a known format, or of a reader for its file name ending."""
    return any(f.sniff(file) for f in formats.FORMATS) or reader_of(file) is not None
