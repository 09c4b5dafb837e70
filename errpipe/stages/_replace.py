"""An export folder as a whole: files of the export before it go, and one that was interrupted is not verified.

Otherwise a screw file of an axis that the new table no longer corrects would remain among the new files.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from errpipe import jsonfile
from errpipe.errors import ErrpipeError, VerifyError
from errpipe.files import inside

LIST = "export.json"
REPLACING = "replacing"  # key of a list while files are exchanged: name -> permitted SHA-256
STAGED = ".unfinished"


@contextlib.contextmanager
def replaced(folder: Path) -> Iterator[Path]:
    """A folder to write an export to, with its list; in the end its files take the place of those of the one before.

    Raises VerifyError, before anything is changed, for a file of the export before that was edited and would go.
    """
    there, staged = folder.is_dir(), folder / STAGED
    if staged.is_symlink():
        raise VerifyError(f"{staged}: is a link; errpipe writes there")
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    try:
        yield staged
        _exchange(staged, folder)
    finally:
        shutil.rmtree(staged, ignore_errors=True)
        if not there:
            with contextlib.suppress(OSError):
                folder.rmdir()


def refuse_interrupted(path: Path, document: Any) -> None:
    """Raise VerifyError for the list of an export that was interrupted while files were exchanged."""
    if isinstance(document, dict) and REPLACING in document:
        raise VerifyError(
            f"{path.parent}: an export was interrupted here, old and new files may be mixed; export again"
        )


def _exchange(staged: Path, folder: Path) -> None:
    after = {p.relative_to(staged).as_posix(): _digest(p) for p in staged.rglob("*") if p.is_file()}
    places = {name: inside(folder, name, VerifyError) for name in after}
    before = _listed(folder)
    old = {name for name in before if "/" in name or name.endswith(".minisig")}  # of controllers, and a signature
    gone = _places(folder, old - after.keys())
    for name, path in gone.items():
        if _digest(path) not in before[name]:
            raise VerifyError(f"{path}: of the export before, and changed since; move it away, or name another --out")
    same = {name for name, digest in after.items() if places[name].is_file() and _digest(places[name]) == digest}
    if not gone and same == set(after):
        return
    names = before.keys() | after.keys()
    may = {name: [*before.get(name, ()), *([after[name]] if name in after else [])] for name in names}
    jsonfile.write(staged / REPLACING, {REPLACING: may})
    os.replace(staged / REPLACING, folder / LIST)
    for path in gone.values():
        path.unlink()
        with contextlib.suppress(OSError):
            path.parent.rmdir()
    for name in sorted(after.keys() - same, key=lambda name: (name == LIST, name)):
        places[name].parent.mkdir(parents=True, exist_ok=True)
        os.replace(staged / name, places[name])
    if LIST in same:  # it served as the list of an exchange
        os.replace(staged / LIST, places[LIST])


def _listed(folder: Path) -> dict[str, list[str]]:
    """Name -> SHA-256 of the files of an earlier export; empty without one."""
    try:
        document = jsonfile.read(folder / LIST)
    except ErrpipeError:
        return {}
    listed = document.get(REPLACING, document.get("sha256")) if isinstance(document, dict) else None
    if not isinstance(listed, dict):
        return {}
    return {name: digests if isinstance(digests, list) else [digests] for name, digests in listed.items()}


def _places(folder: Path, names: set[str]) -> dict[str, Path]:
    """Paths of the named files that exist. Raises VerifyError for a name outside the folder."""
    places = {name: inside(folder, name, VerifyError) for name in names}
    return {name: path for name, path in places.items() if path.is_file() and not path.is_symlink()}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
