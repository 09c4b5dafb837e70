"""Files packed in a gzip, zip or tar file, unpacked to a folder: each is imported like a file of its own."""

from __future__ import annotations

import gzip
import io
import re
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

from errpipe.errors import DataError
from errpipe.importing.readers import MOST_BYTES, READERS
from errpipe.importing.sheet import readable

MOST_MEMBERS = 256  # files of one archive; by judgement: more are not the runs of one test
ENCRYPTED = 1  # bit of a member's flags (PKWARE APPNOTE 4.4.4)
_GZIP, _ZIP, _TAR = b"\x1f\x8b", b"PK\x03\x04", b"ustar"
_HEAD = 262  # bytes: `ustar` ends there in the header of the first file (POSIX.1-1988)
_OF_A_SYSTEM = re.compile(r"(?:^|/)(?:\.(?![./])|__MACOSX/|thumbs\.db$|desktop\.ini$)|/$", re.IGNORECASE)
_OF_ONE_DOCUMENT = {"[Content_Types].xml", "mimetype", "modelDescription.xml"}  # Office Open XML, OpenDocument, FMI
_PROSE = re.compile(  # what accompanies measurements in an archive
    r"(?:.*/)?(?:read_?me|liesmich|lisez-?moi|leggimi|leame|licen[sc]e)[^/]*|.*\.(?:pdf|docx?|md|png|jpe?g|gif|svg|bmp)",
    re.IGNORECASE,
)


def unpacked(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The files of an archive, unpacked to a folder in the order of their names, and notes; other files unchanged.

    Raises DataError for an archive that cannot be read, is too large, or names a place outside its folder.
    """
    if not path.is_file() or path.stat().st_size > MOST_BYTES:
        return [path], []
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    zipped = head.startswith(_ZIP) and not any(reader.sniff(path, head) for reader in READERS)
    if not zipped and not head.startswith(_GZIP) and not head.endswith(_TAR):
        return [path], []
    with readable(path, "an archive", "extract it first"):
        if zipped and _is_document(path):
            return [path], []
        members = [m for m in (_zipped(path) if zipped else _tarred(path)) if not _OF_A_SYSTEM.search(m[0])]
        prose = [name for name, _ in members if len(members) > 1 and _PROSE.fullmatch(name)]
        files = [_written(path, name, data, folder) for name, data in members if name not in prose]
    if not files:
        raise DataError(f"{path}: an archive without a file of measurements")
    notes = [f"{path.name}: excluded, as no measurements: {', '.join(prose)}"] if prose else []
    return sorted(files, key=_in_order), notes


def _in_order(file: Path) -> list[tuple[str, int]]:
    """The key by which `run 10` follows `run 9`."""
    return [(text, int(figures or 0)) for text, figures in re.findall(r"(\D*)(\d{0,18})", str(file).lower())]


def _is_document(path: Path) -> bool:
    with zipfile.ZipFile(path) as archive:
        return not _OF_ONE_DOCUMENT.isdisjoint(archive.namelist())


def _zipped(path: Path) -> Iterator[tuple[str, bytes]]:
    with zipfile.ZipFile(path) as archive:
        _affordable(path, len(archive.infolist()), sum(info.file_size for info in archive.infolist()))
        for info in archive.infolist():
            if info.flag_bits & ENCRYPTED:
                raise DataError(f"{path}: {info.filename} is encrypted: extract it with its password first")
            yield info.filename, archive.read(info)  # zipfile stops at the stated size


def _tarred(path: Path) -> Iterator[tuple[str, bytes]]:
    with gzip.open(path) if path.read_bytes()[:2] == _GZIP else path.open("rb") as stream:
        data = stream.read(MOST_BYTES + 1)
    _affordable(path, 1, len(data))
    if not data[:_HEAD].endswith(_TAR):
        yield path.stem, data
        return
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as archive:
        _affordable(path, len(archive.getmembers()), sum(m.size for m in archive.getmembers()))  # some may be sparse
        for member in (m for m in archive.getmembers() if not m.isdir()):
            content = archive.extractfile(member) if member.isreg() else None
            if content is None:
                raise DataError(f"{path}: {member.name} is a link or a device (allowed: files)")
            yield member.name, content.read()


def _affordable(path: Path, members: int, size: int) -> None:
    if members > MOST_MEMBERS:
        raise DataError(f"{path}: an archive of {members} files (at most {MOST_MEMBERS}): extract those that are meant")
    if size > MOST_BYTES:
        raise DataError(f"{path}: more than {MOST_BYTES >> 20} MB unpacked (at most so many are imported)")


def _written(path: Path, name: str, data: bytes, folder: Path) -> Path:
    """A file of an archive, written below a folder. Raises DataError for a name that points elsewhere."""
    place = PurePosixPath(name.replace("\\", "/"))
    if place.is_absolute() or ".." in place.parts or ":" in name[:2]:
        raise DataError(f"{path}: {name!r} is a place outside the archive (allowed: names below its own folder)")
    file = folder.joinpath(*(re.sub(r"[^\w. +=()-]", "_", part)[-100:] for part in place.parts))
    if file.exists():
        raise DataError(f"{path}: {name!r} is in it twice (a run is imported once): extract the one that is meant")
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    return file
