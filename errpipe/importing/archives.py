"""Files in a folder, or packed in a gzip, zip or tar file: each is imported like a file of its own."""

from __future__ import annotations

import gzip
import io
import os
import re
import tarfile
import zipfile
from collections.abc import Iterator
from itertools import islice
from pathlib import Path, PurePosixPath

from errpipe.errors import DataError
from errpipe.importing.readers import MOST_BYTES, READERS
from errpipe.importing.sheet import readable

MOST_MEMBERS = 256  # files of one folder or archive; by judgement: more are not the runs of one test
RECORDING = "recording.yaml"  # in a folder that is ready
ENCRYPTED = 1  # bit of a member's flags (PKWARE APPNOTE 4.4.4)
_GZIP, _ZIP, _TAR = b"\x1f\x8b", b"PK\x03\x04", b"ustar"
_HEAD = 262  # bytes: `ustar` ends there in the header of the first file (POSIX.1-1988)
_OF_A_SYSTEM = re.compile(r"(?:^|/)(?:\.(?![./])|__MACOSX/|thumbs\.db$|desktop\.ini$)|/$", re.IGNORECASE)
_OF_ONE_DOCUMENT = {"[Content_Types].xml", "mimetype", "modelDescription.xml"}  # Office Open XML, OpenDocument, FMI
_PROSE = re.compile(  # what accompanies measurements in an archive
    r"(?:.*/)?(?:read_?me|liesmich|lisez-?moi|leggimi|leame|licen[sc]e)[^/]*|.*\.(?:pdf|docx?|md|png|jpe?g|heic|gif|svg|bmp|mp4|mov)",
    re.IGNORECASE,
)
_TEXTS = ("", ".md", ".txt")
LARGEST_REMARK = 1 << 16  # bytes of a text whose lines are read: 500 lines


def unpacked(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The files of a folder or an archive, in the order of their names, and notes; other files unchanged.

    Those of an archive are written to a folder. Raises DataError for an archive that cannot be read, is too large, or
    names a place outside its folder.
    """
    if re.search("[\ud800-\udfff]", path.name):
        raise DataError(f"{os.fsencode(path)!r}: its name is not UTF-8 (allowed: names in UTF-8): rename it")
    if path.is_dir():
        return _of_folder(path, folder)
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
        kept, notes = _without_prose(path, [name for name, _ in members])
        files = [_written(path, name, data, folder) for name, data in members if name in kept]
    if not files:
        raise DataError(f"{path}: an archive without a file of measurements")
    return sorted(files, key=_in_order), notes


def _of_folder(path: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """The files in a folder and those below it, without earlier recordings. Raises DataError if there are none."""
    if (path / RECORDING).is_file():
        raise DataError(f"{path}: a folder that is a recording: errpipe init axis --recording {path}")
    notes: list[str] = []
    names = sorted(islice(_below(path, notes), MOST_MEMBERS + 1), key=_in_order)
    _affordable(path, len(names), 0)
    kept, prose = _without_prose(path, names)
    if not kept:
        raise DataError(f"{path}: a folder without a file of measurements")
    out = []
    for name in kept:
        inside, more = unpacked(path / name, folder / Path(name).with_suffix(""))
        out += inside
        notes += more
    return out, [*notes, *prose]


def _below(path: Path, notes: list[str]) -> Iterator[str]:
    """The names of the files in a folder and below it; recordings are left out, with a note on each."""
    for root, folders, files in os.walk(path, onerror=_unreadable):
        place = Path(root).relative_to(path)
        links = [str(place / name) for name in folders if (path / place / name).is_symlink()]
        notes += [f"{path.name}: links to folders are not followed: {', '.join(links)}"] if links else []
        if RECORDING in files:
            notes.append(f"{path.name}: excluded, as already a recording: {place}")
            folders.clear()
            continue
        yield from (name for name in ((place / f).as_posix() for f in files) if not _OF_A_SYSTEM.search(name))


def _unreadable(err: OSError) -> None:
    raise DataError(f"{err.filename}: {err.strerror} (needed: the right to read it)") from err


def _without_prose(path: Path, names: list[str]) -> tuple[list[str], list[str]]:
    """The names without those of documents and pictures beside measurements, and a note on these."""
    prose = [name for name in names if len(names) > 1 and _PROSE.fullmatch(name)]
    notes = [f"{path.name}: excluded, as no measurements: {', '.join(prose)}"] if prose else []
    return [name for name in names if name not in prose], notes


def remarks(folder: Path) -> Iterator[tuple[Path, list[str]]]:
    """The texts beside the measurements in a folder, with their lines."""
    for file in sorted(f for f in folder.iterdir() if f.is_file() and not f.is_symlink()):
        if (
            _PROSE.fullmatch(file.name)
            and "licen" not in file.name.lower()
            and file.suffix.lower() in _TEXTS
            and file.stat().st_size < LARGEST_REMARK
        ):
            yield file, file.read_text("utf-8", errors="replace").splitlines()


def _in_order(file: Path | str) -> list[tuple[str, int]]:
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
        raise DataError(f"{path}: it holds more than {MOST_MEMBERS} files: name those that are meant")
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
