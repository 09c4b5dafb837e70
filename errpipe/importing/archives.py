"""Files packed in a gzip, zip or tar file, unpacked to a folder: each is imported like a file of its own."""

from __future__ import annotations

import gzip
import io
import re
import tarfile
import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import IO

from errpipe.errors import DataError
from errpipe.importing.readers import MOST_BYTES, READERS

MOST_MEMBERS = 256  # files of one archive; by judgement: more are not the runs of one test
_GZIP, _ZIP = b"\x1f\x8b", b"PK\x03\x04"
_TAR = slice(257, 262)  # bytes `ustar` of the header of the first file, POSIX.1-1988
_OF_A_SYSTEM = re.compile(r"(?:^|/)(?:\.(?!\.)|__MACOSX/|thumbs\.db$|desktop\.ini$)|/$", re.IGNORECASE)
_PROSE = re.compile(  # what accompanies measurements in an archive
    r"(?:read_?me|liesmich|lisez-?moi|leggimi|leame|licen[sc]e)[^/]*|[^/]*\.(?:pdf|docx?|md|png|jpe?g|gif|svg|bmp)",
    re.IGNORECASE,
)


def unpacked(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The files of an archive, unpacked to a folder in the order of their names, and notes; other files unchanged.

    Raises DataError for an archive that cannot be read, is too large, or names a place outside its folder.
    """
    if not path.is_file() or not 0 < path.stat().st_size <= MOST_BYTES:
        return [path], []
    with path.open("rb") as stream:
        head = stream.read(1 << 16)
    tar = head[_TAR] == b"ustar"
    if not (tar or head.startswith(_GZIP)) and (not head.startswith(_ZIP) or any(r.sniff(path, head) for r in READERS)):
        return [path], []
    try:
        found = sorted(_members(path, head), key=lambda member: _in_order(member[0]))
    except (OSError, EOFError, RuntimeError, zlib.error, zipfile.BadZipFile, tarfile.TarError) as err:
        raise DataError(f"{path}: an archive that cannot be read here ({err}): extract it first") from None
    prose = [name for name, _ in found if len(found) > 1 and _PROSE.fullmatch(PurePosixPath(name).name)]
    files = [_written(path, name, data, folder) for name, data in found if name not in prose]
    if not files:
        raise DataError(f"{path}: an archive without a file of measurements")
    return files, [f"{path.name}: excluded, as no measurements: {', '.join(prose)}"] if prose else []


def _in_order(name: str) -> list[tuple[int, str]]:
    """The key by which `run 10` follows `run 9`."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d{0,18})", name.lower())]


def _members(path: Path, head: bytes) -> Iterator[tuple[str, bytes]]:
    """Name and bytes of every file, at most MOST_BYTES together. Raises DataError."""
    if head.startswith(_ZIP):
        with zipfile.ZipFile(path) as archive:
            infos = [info for info in archive.infolist() if not _OF_A_SYSTEM.search(info.filename)]
            left = _affordable(path, len(infos), sum(info.file_size for info in infos))
            for info in infos:
                data = _read(path, archive.open(info), left)
                left -= len(data)
                yield info.filename, data
        return
    data = _read(path, gzip.GzipFile(path) if head.startswith(_GZIP) else path.open("rb"), MOST_BYTES)
    if data[_TAR] != b"ustar":
        yield path.stem, data
        return
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
        members = [m for m in archive.getmembers() if not (m.isdir() or _OF_A_SYSTEM.search(m.name))]
        _affordable(path, len(members), 0)
        for member in members:
            stream = archive.extractfile(member) if member.isreg() else None
            if stream is None:
                raise DataError(f"{path}: {member.name} is a link or a device (allowed: files)")
            yield member.name, stream.read()


def _affordable(path: Path, members: int, size: int) -> int:
    if members > MOST_MEMBERS:
        raise DataError(f"{path}: an archive of {members} files (at most {MOST_MEMBERS}): extract those that are meant")
    if size > MOST_BYTES:
        raise DataError(f"{path}: {size >> 20} MB unpacked (at most {MOST_BYTES >> 20} MB are imported)")
    return MOST_BYTES


def _read(path: Path, stream: IO[bytes] | gzip.GzipFile, most: int) -> bytes:
    with stream:
        data = stream.read(most + 1)
    _affordable(path, 1, MOST_BYTES + 1 if len(data) > most else 0)
    return data


def _written(path: Path, name: str, data: bytes, folder: Path) -> Path:
    """A file of an archive, written below a folder. Raises DataError for a name that points elsewhere."""
    place = PurePosixPath(name.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or ":" in place.parts[0]:
        raise DataError(f"{path}: {name!r} is a place outside the archive (allowed: names below its own folder)")
    file = folder.joinpath(*(re.sub(r"[^\w. +=()-]", "_", part)[-100:] for part in place.parts))
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    return file
