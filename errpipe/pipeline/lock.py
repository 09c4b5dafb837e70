"""What ran, on what, and what came out: `errpipe.lock`, and the reason why a stage would run again.

Per stage: kind, code version, canonical parameters, SHA-256 of every input and of every output. Paths of
inputs enter by their last part only, so that the same data elsewhere give the same bytes.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import errpipe
from errpipe import files, jsonfile
from errpipe.errors import DataError, ErrpipeError, VerifyError

if TYPE_CHECKING:
    from errpipe.pipeline.stage import Stage

LOCK = "errpipe.lock"
VERSION = 1  # of the lock file's layout
_SCRATCH = ".errpipe"  # folder in OUT for unfinished work
MAX_INPUT_FILES = 100_000  # below one input: a year of files every five minutes


@dataclass(frozen=True)
class Record:
    """One stage in the lock file. sources: slot -> stage names. inputs, outputs: file -> SHA-256."""

    kind: str
    code: str
    parameters: dict[str, Any]
    sources: dict[str, list[str]]
    inputs: dict[str, str]
    outputs: dict[str, str] = field(default_factory=dict)
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def fingerprint(self) -> str:
        """SHA-256 over everything that determines the outputs, except the code."""
        return jsonfile.fingerprint([self.kind, self.parameters, self.sources, self.inputs])


def read_lock(out: Path) -> dict[str, Record]:
    """The records in OUT, {} if there are none. An unreadable lock file counts as none: all stages run.

    Raises VerifyError if it names an output that is not in OUT: what is named there may be removed.
    """
    path = out / LOCK
    if not path.is_file():
        return {}
    try:
        document = jsonfile.read(path)
        if document["errpipe_lock"] != VERSION:
            return {}
        records = {name: _record(record) for name, record in document["stages"].items()}
    except (VerifyError, KeyError, TypeError, AttributeError):
        return {}
    for name, record in records.items():
        for file in (name, *record.outputs):
            refuse_outside(path, file)
    return records


def leftover_note(folder: Path, brought_up_to_date: Container[str]) -> str:
    """In words, which outputs in a folder an earlier run made; '' where there are none.

    A machine that fails keeps them: whoever reads its folder alone would take its old table for today's.
    """
    try:
        earlier = [name for name in read_lock(folder) if name not in brought_up_to_date and (folder / name).is_dir()]
    except (ErrpipeError, OSError):
        return ""
    made = f"; {folder.parent.name}/{folder.name} holds what an earlier run made: {', '.join(earlier)}"
    return made if earlier else ""


def _record(plain: Mapping[str, Any]) -> Record:
    """A record of the lock file. Raises TypeError if it is not one."""
    record = Record(**plain)
    texts = [record.kind, record.code, *record.inputs.values(), *record.outputs.values()]
    mappings = [record.parameters, record.sources, record.inputs, record.outputs, record.summary]
    lists = all(isinstance(names, list) for names in record.sources.values())
    if not (lists and all(isinstance(t, str) for t in texts) and all(isinstance(m, dict) for m in mappings)):
        raise TypeError("not a record")
    return record


def refuse_outside(listing: Path, name: str) -> None:
    """Raises VerifyError if a file that lists outputs names one outside its folder."""
    if not files.stays_inside(name):
        raise VerifyError(f"{listing}: names {name!r}, which is outside the folder; it was not written by errpipe")


def write_lock(out: Path, records: Mapping[str, Record]) -> None:
    """Write the lock file whole, if its bytes change."""
    stages = {name: asdict(record) for name, record in records.items()}
    jsonfile.write(out / LOCK, {"errpipe_lock": VERSION, "stages": stages})


def hash_file(path: Path) -> str:
    """SHA-256 of a file, as 64 hexadecimal digits. Raises DataError if it cannot be read."""
    try:
        with files.open_regular(path) as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
    except OSError as err:
        raise DataError(f"{path}: {files.why(err)}") from None


def files_below(path: Path) -> list[Path]:
    """A file itself; of a folder all files below it, hidden ones not, sorted. Raises DataError if absent."""
    if path.is_file():
        return [path]
    if not path.exists():
        raise DataError(f"{path}: no such file or folder")
    if not path.is_dir():
        return [path]  # a pipe or a device: refused where it is opened
    paths: list[Path] = []
    seen: set[str] = set()
    for folder, folders, names in os.walk(path, followlinks=True):
        resolved = os.path.realpath(folder)
        if resolved in seen:  # a link back to a folder above
            folders.clear()
            continue
        seen.add(resolved)
        folders[:] = sorted(name for name in folders if not name.startswith("."))
        paths += [Path(folder) / name for name in names if not name.startswith(".")]
        if len(paths) > MAX_INPUT_FILES:
            raise DataError(f"{path}: holds more than {MAX_INPUT_FILES} files (is it the right folder?)")
    return sorted(paths)


def label_inputs(paths: Sequence[Path]) -> dict[str, Path]:
    """Name in the lock file -> path, for every file of the inputs: the last part of what was named."""
    labels: dict[str, Path] = {}
    tops: dict[str, Path] = {}
    for top in dict.fromkeys(paths):
        name, number = top.name or "input", 2
        while tops.setdefault(name, top) != top:
            name, number = f"{top.name} ({number})", number + 1
        for file in files_below(top):
            labels[name if file == top else f"{name}/{file.relative_to(top).as_posix()}"] = file
    return labels


def code_of(stage: Stage) -> str:
    """The code version of a stage: release, its own counter, and the bytes of the package behind it."""
    return f"{errpipe.__version__}+{stage.code_version}.{package_code()}"


@lru_cache
def package_code() -> str:
    """Fingerprint of the package's source without the command line, 12 digits: edited code runs again."""
    top = Path(errpipe.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(top.rglob("*")):
        inside = path.relative_to(top)
        if inside.parts[0] == "cli" or "__pycache__" in inside.parts or not path.is_file():
            continue
        digest.update(inside.as_posix().encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()[:12]


def changes(old: Record, new: Record) -> list[str]:
    """Differences between two records in words; [] where they agree."""
    if old.kind != new.kind:
        return [f"kind {old.kind} -> {new.kind}"]
    reasons = ["code changed"] if old.code != new.code else []
    reasons += [f"params.{text}" for text in _differences(old.parameters, new.parameters)]
    reasons += [f"from.{text}" for text in _differences(old.sources, new.sources)]
    for name in sorted({**old.inputs, **new.inputs}):
        if name not in old.inputs:
            reasons.append(f"input {name} is new")
        elif name not in new.inputs:
            reasons.append(f"input {name} is gone")
        elif old.inputs[name] != new.inputs[name]:
            reasons.append(f"input {name} changed")
    return reasons


def _differences(old: Any, new: Any, where: str = "") -> list[str]:
    """Leaves that differ, as `where old -> new`."""
    if old == new and type(old) is type(new):
        return []
    if isinstance(old, dict) and isinstance(new, dict):
        keys = sorted({**old, **new})
        parts = [_differences(old.get(k), new.get(k), f"{where}.{k}" if where else k) for k in keys]
        return [text for part in parts for text in part]
    if isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        parts = [_differences(a, b, f"{where}[{i}]") for i, (a, b) in enumerate(zip(old, new, strict=True))]
        return [text for part in parts for text in part]
    return [f"{where} {_brief(old)} -> {_brief(new)}"]


def _brief(value: Any) -> str:
    if value is None:
        return "nothing"
    text = value if isinstance(value, str) else jsonfile.dumps(value, indent=None).strip()
    return text if len(text) <= 40 else text[:37] + "…"


def scratch(out: Path) -> Path:
    """The folder in OUT for unfinished work; it may remain after an interrupted run."""
    return out / _SCRATCH


@contextmanager
def exclusive_lock(out: Path, waiting: Any = lambda: None) -> Iterator[None]:
    """Hold OUT for this process; `waiting` is called once where another one holds it. The kernel lets go
    of the lock however the process ends."""
    scratch(out).mkdir(parents=True, exist_ok=True)
    if scratch(out).is_symlink():
        raise VerifyError(f"{scratch(out)}: is a link (errpipe removes unfinished work there)")
    try:
        import fcntl
    except ImportError:  # Windows
        with _exclusive_lock_without_flock(scratch(out) / "busy", waiting):
            yield
        return
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    with os.fdopen(os.open(scratch(out) / "busy", flags, 0o644), "rb") as stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            waiting()
            fcntl.flock(stream, fcntl.LOCK_EX)
        yield


@contextmanager
def _exclusive_lock_without_flock(path: Path, waiting: Any) -> Iterator[None]:
    """The same where the system has no flock, by a lock of the file's own system."""
    from filelock import FileLock, Timeout

    lock = FileLock(path)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        waiting()
        lock.acquire()
    try:
        yield
    finally:
        lock.release()
