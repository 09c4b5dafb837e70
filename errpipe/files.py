"""Access to files that others wrote: regular files only, of a bounded size, under names that stay in their folder.

A named pipe or `/dev/zero` in a folder of recordings would be read for ever; a name such as `../../x` in a lock file
would be deleted. Every reader and every writer of errpipe passes here.
"""

from __future__ import annotations

import contextlib
import difflib
import filecmp
import glob
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextvars import ContextVar
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import IO

from errpipe.errors import ErrpipeError

MAX_FILE_BYTES = 64 << 30  # of any file: ten times a day of fifty channels at 1 kHz as text; a hole may have terabytes
MAX_JSON_BYTES = 256 << 20  # the twin of the largest table allowed (4 million values) has about 50 MB
_KINDS = {
    stat.S_IFDIR: "is a folder",
    stat.S_IFIFO: "is a named pipe",
    stat.S_IFCHR: "is a device",
    stat.S_IFBLK: "is a device",
    stat.S_IFSOCK: "is a socket",
}


_to_disk = ContextVar("to_disk", default=True)


def open_regular(path: Path, follow: bool = True) -> IO[bytes]:
    """A regular file of at most MAX_FILE_BYTES, for reading. Raises OSError with a plain text otherwise; never waits.

    follow: whether its last part may be a link.
    """
    # without O_NONBLOCK the opening of a named pipe waits for somebody to write
    handle = os.open(
        path,
        os.O_RDONLY
        | getattr(os, "O_NONBLOCK", 0)
        | getattr(os, "O_CLOEXEC", 0)
        | (0 if follow else getattr(os, "O_NOFOLLOW", 0)),
    )
    facts = os.fstat(handle)
    mode = facts.st_mode
    if stat.S_ISREG(mode) and facts.st_size <= MAX_FILE_BYTES:
        return os.fdopen(handle, "rb")
    os.close(handle)
    if stat.S_ISREG(mode):
        raise OSError(0, f"is {facts.st_size >> 30} GB large (at most {MAX_FILE_BYTES >> 30} GB are read)", str(path))
    raise OSError(0, f"{_KINDS.get(stat.S_IFMT(mode), 'is no file')} (a regular file is needed)", str(path))


def read(path: Path, most: int, error: type[ErrpipeError], follow: bool = True) -> bytes:
    """All bytes of a regular file of at most `most` bytes. Raises `error`, naming the file, where it is not one."""
    try:
        with open_regular(path, follow) as stream:
            data = stream.read(most + 1)
            if len(data) > most:
                raise error(f"{path}: has {os.fstat(stream.fileno()).st_size} bytes (at most {most} are read)")
            return data
    except FileNotFoundError:
        raise error(f"{path}: there is no such file") from None
    except OSError as err:
        raise error(f"{path}: {why(err)}") from None


MOST_NEIGHBOURS = 1000  # names of a folder that are compared with one that is missing


def missing(path: Path) -> str:
    """`no such file`, with the name in its folder that is nearest to it; a link is there, without its file."""
    return "a link to a file that is not there" if path.is_symlink() else f"no such file{nearest(path)}"


def nearest(path: Path) -> str:
    """`. Did you mean X?` for the name in its folder that is nearest to one that is not there; '' where none is."""
    try:
        near = [entry.name for entry in islice(path.parent.iterdir(), MOST_NEIGHBOURS)]
    except OSError:
        near = []
    meant = difflib.get_close_matches(path.name, near, n=1, cutoff=0.75)
    return f". Did you mean {path.parent / meant[0]}?" if meant else ""


def why(err: OSError) -> str:
    """An operating system's refusal in the words of a message."""
    text = (err.strerror or str(err)).lower()
    return text if text.startswith("is ") else f"cannot be read: {text}"


def stays_inside(name: str) -> bool:
    """Whether a name, put behind a folder's, names something below that folder (links apart)."""
    if not name or not name.strip() or any(ord(c) < 32 or ord(c) == 127 for c in name) or "\\" in name or "//" in name:
        return False
    path = PurePosixPath(name)
    return not path.is_absolute() and ".." not in path.parts and bool(path.parts) and not re.match("[A-Za-z]:", name)


def is_below(folder: Path, path: Path) -> bool:
    """Whether a path lies in a folder once its links are followed; a link that leads to itself lies nowhere."""
    try:
        return path.resolve().is_relative_to(folder.resolve())
    except (RuntimeError, OSError):
        return False


def inside(folder: Path, name: str, error: type[ErrpipeError]) -> Path:
    """`folder/name`. Raises `error` where that leads out of the folder, by its name or through a link."""
    if not stays_inside(name):
        raise error(f"{name!r} is not the name of a file in {folder.name or folder} (it leads out of the folder)")
    path = folder / name
    if not is_below(folder, path.parent):
        raise error(f"{name!r} leads out of {folder.name or folder} through a link")
    return path


@contextlib.contextmanager
def scratch() -> Iterator[None]:
    """Files of this block are not waited for until they are on disk: who moves them to their place does that."""
    before = _to_disk.set(False)
    try:
        yield
    finally:
        _to_disk.reset(before)


def to_disk(path: Path) -> None:
    """Wait until the bytes of a file are on disk."""
    with open(path, "rb") as stream:
        os.fsync(stream.fileno())


@contextlib.contextmanager
def _temporary(path: Path) -> Iterator[tuple[int, str]]:
    """A new hidden file beside `path`, and its name. What killed processes left of the same file is removed.

    It is locked in this block, however the process ends: so those that are still written are known from those left.
    """
    prefix = f".{path.name[:100]}."
    try:
        import fcntl
    except ImportError:  # Windows
        yield tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=".tmp")
        return
    for left in path.parent.glob(f"{glob.escape(prefix)}????????.tmp"):
        with contextlib.suppress(OSError), open_regular(left, follow=False) as stream:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            left.unlink()
    while True:
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=prefix, suffix=".tmp")
        with contextlib.suppress(OSError):
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.path.lexists(temporary):  # else another process took it for one that was left
            break
        os.close(handle)
    with os.fdopen(os.dup(handle), "wb"):  # which holds the lock when `handle` is closed
        yield handle, temporary


@contextlib.contextmanager
def whole(path: Path) -> Iterator[IO[bytes]]:
    """A stream whose bytes become the file `path`, at once and on disk, when the block ends without an error.

    Within `scratch` nothing waits for the disk. A file that holds these bytes already is not touched. Raises OSError
    with the file's name, also where the disk is full; what was there before then stays.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with _temporary(path) as (handle, temporary):
        try:
            with os.fdopen(handle, "wb") as stream:
                yield stream
                stream.flush()
                if _to_disk.get():
                    os.fsync(stream.fileno())
            if path.is_file() and filecmp.cmp(temporary, path, shallow=False):
                os.unlink(temporary)
                return
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException as err:
            Path(temporary).unlink(missing_ok=True)
            if isinstance(err, OSError) and err.filename is None and err.errno:
                raise OSError(err.errno, err.strerror, str(path)) from None
            raise
