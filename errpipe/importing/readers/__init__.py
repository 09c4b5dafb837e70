"""Readers of `errpipe import`: one file per kind of measurement file. A new one is one file here and its name here.

A reader module has
    name                    as `errpipe formats` lists it
    suffixes                file name endings for which it is tried first
    sniff(path, head)       whether the first bytes match; never raises
    read(path, options)     -> list of Sheet; raises DataError
    binary                  True if a small file can expand to a large one: it is first read in a separate process
"""

from __future__ import annotations

import os
import re
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

from errpipe.errors import DataError, ErrpipeError, UsageError
from errpipe.importing import controller_files
from errpipe.importing.sheet import ReaderOptions, Sheet

_NAMES = (
    *("excel", "tdms", "hdf5", "matlab", "numpy_arrays", "sqlite", "mtconnect", "markup"),
    *("halscope", "halsampler", "records", "camonitor", "dmis", "delimited"),
)
READERS = tuple(import_module(f"{__name__}.{name}") for name in _NAMES)  # in the order in which they are tried

MOST_BYTES = 256 << 20  # 256 MB: a larger log is stored as Parquet with a manifest, which is read in blocks
HEAD_BYTES = 1 << 16  # for recognition of a format
MOST_MEMORY = 3 << 30  # bytes in addition to those in use: 256 MB of packed numbers as Python objects
MOST_SECONDS = 120  # s


def open_file(path: Path, options: ReaderOptions) -> tuple[str, list[Sheet]]:
    """Name of the reader that reads a file, and its sheets. Raises DataError."""
    if not path.is_file():
        raise DataError(f"{path}: no such file")
    size = path.stat().st_size
    if size == 0:
        raise DataError(f"{path}: the file is empty")
    if size > MOST_BYTES:
        raise DataError(
            f"{path}: {size >> 20} MB (at most {MOST_BYTES >> 20} MB are imported; write larger logs as CSV or Parquet "
            "with a recording.yaml, which is read in blocks)"
        )
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    _refuse_known(path, head)
    for reader in READERS:
        if reader.sniff(path, head):
            if getattr(reader, "binary", False):
                _check_in_child_process(reader, path, options)
            sheets = reader.read(path, options)
            if not any(sheet.rows for sheet in sheets):
                raise DataError(f"{path}: no rows ({reader.name})")
            return reader.name, sheets
    kinds = ", ".join(reader.name for reader in READERS)
    raise DataError(f"{path}: neither text nor any other kind of file that is imported (allowed: {kinds})")


def reader_of(path: Path) -> ModuleType | None:
    """The reader that fits both the ending and the first bytes of a file; None of a file that is not imported."""
    with path.open("rb") as stream:
        head = stream.read(HEAD_BYTES)
    try:
        _refuse_known(path, head)
    except DataError:
        return None
    return next((r for r in READERS if path.suffix.lower() in r.suffixes and head and r.sniff(path, head)), None)


def _refuse_known(path: Path, head: bytes) -> None:
    """Raise DataError for kinds of files that are not imported, with the alternative."""
    if (what := controller_files.controller_file_kind(path, head)) is not None:
        raise DataError(f"{path}: {what}")
    if path.name.startswith(("~$", ".~lock.")):
        raise DataError(f"{path}: the lock file of a workbook that is open: name the workbook")
    if head[4:19] in (b"Standard Jet DB", b"Standard ACE DB"):
        raise DataError(f"{path}: an Access database: export the table as CSV or as an Excel workbook")
    if head.startswith((b"\x1f\x8b", b"BZh", b"\xfd7zXZ", b"7z\xbc\xaf")):
        raise DataError(f"{path}: a compressed archive: extract it first")
    if re.match(rb"\x80[\x02-\x05]", head) or path.suffix in (".pkl", ".pickle"):
        raise DataError(f"{path}: a pickle, which can execute code when opened: write it as CSV or Parquet")
    if re.match(rb"CDF[\x01\x02\x05]", head):
        raise DataError(
            f"{path}: netCDF 3, of which only version 4 is read: nccopy -k nc4 {path.name} {path.stem}_4.nc"
        )
    if re.match(rb"K0100\b", head):
        raise DataError(f"{path}: a Q-DAS file: export its values as CSV, each with its commanded position")


def _check_in_child_process(reader: ModuleType, path: Path, options: ReaderOptions) -> None:
    """Read a file in a child process first, bounded in memory and time. Raises DataError."""
    if not hasattr(os, "fork") or sys.platform == "darwin":  # no fork, or an unsafe one: read unbounded
        return
    answers, pipe_end = os.pipe()
    sys.stderr.flush()
    child = os.fork()
    if child == 0:
        os.close(answers)
        _read_and_report(reader, path, options, pipe_end)
    os.close(pipe_end)
    with os.fdopen(answers, "rb") as stream:
        text = stream.read(1 << 16).decode(errors="replace")
    _, status = os.waitpid(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == 2:
        raise UsageError(text)
    if code == 3:
        raise DataError(text)
    if code != 0:
        raise DataError(f"{path}: takes more than {MOST_MEMORY >> 30} GB of memory or {MOST_SECONDS} s to read")


def _read_and_report(reader: ModuleType, path: Path, options: ReaderOptions, answer_pipe: int) -> None:
    import resource

    code = 1
    try:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)  # suppresses a library's own message when memory runs out
        used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGESIZE")
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for which, most in ((resource.RLIMIT_AS, used + MOST_MEMORY), (resource.RLIMIT_CPU, MOST_SECONDS)):
            _, hard = resource.getrlimit(which)
            most = most if hard == resource.RLIM_INFINITY else min(most, hard)
            resource.setrlimit(which, (most, most))
        reader.read(path, options)
        code = 0
    except ErrpipeError as err:
        os.write(answer_pipe, str(err).encode()[: 1 << 16])
        code = 2 if isinstance(err, UsageError) else 3
    finally:
        os._exit(code)
