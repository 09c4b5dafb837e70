"""The registry: which table was on which machine, since when, and why. Plain folders, append-only.

    REGISTRY/objects/ab/abcd...             bytes by their SHA-256: tables, entries and the entries' signatures
    REGISTRY/machines/7/000001              one line: SHA-256 of the machine's first entry

An entry says machine, number, what was done (promote, rollback), the table's SHA-256, when, why, the SHA-256 of the
entry before it and, since version 2, the number of the entry that a rollback returns to; it is signed. Nothing is ever
overwritten: an entry's place is made by a link that fails where another writer was first. Killed anywhere, a writer
leaves at most objects that nothing names.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from errpipe import files, jsonfile
from errpipe.errors import GateError, UsageError, VerifyError
from errpipe.registry.minisign import PublicKey, SecretKey, verify

_MACHINE = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_DIGEST = re.compile(r"[0-9a-f]{64}")
VERSION = 2  # of an entry's layout; version 1 lacks `back_to`
MAX_OBJECT_BYTES = 1 << 30  # a table, model or report
MAX_ENTRY_BYTES = 1 << 20  # a line of history with its signature


@dataclass(frozen=True)
class Entry:
    """One line of a machine's history. table: SHA-256 of its bytes; digest: SHA-256 of the entry itself.

    back_to: number of the entry that a rollback returns to; 0 for a promotion, and where version 1 does not state it.
    """

    machine: str
    number: int
    action: str
    table: str
    time: str
    why: str
    previous: str
    back_to: int = 0
    digest: str = ""

    def plain(self) -> dict[str, Any]:
        """What is written and signed."""
        names = ("machine", "number", "action", "table", "back_to", "time", "why", "previous")
        return {"registry_entry": VERSION} | {name: getattr(self, name) for name in names}


class Registry:
    """A registry in a folder. key: whose signatures count."""

    def __init__(self, folder: Path, key: PublicKey):
        self.folder, self.key = Path(folder), key

    def history(self, machine: str) -> list[Entry]:
        """All entries of a machine, oldest first, each checked. Raises VerifyError for what was tampered with."""
        place = self._machine(machine)
        names = sorted(p.name for p in place.iterdir() if not p.name.startswith(".")) if place.is_dir() else []
        entries: list[Entry] = []
        for number, name in enumerate(names, 1):
            if name != f"{number:06d}":
                raise VerifyError(f"{place}: entry {number:06d} is missing (found {name})")
            entry = self._entry(place / name)
            previous = entries[-1].digest if entries else ""
            same = not entry.back_to or entry.table in [e.table for e in entries if e.number == entry.back_to]
            if (entry.machine, entry.number, entry.previous) != (machine, number, previous) or not same:
                raise VerifyError(f"{place / name}: is not entry {number} of machine {machine} in this history")
            entries.append(entry)
        return entries

    def machines(self) -> list[str]:
        """Names of the machines that have a history."""
        place = self.folder / "machines"
        return sorted(p.name for p in place.iterdir() if _MACHINE.fullmatch(p.name)) if place.is_dir() else []

    def table(self, entry: Entry) -> bytes:
        """The bytes of an entry's table. Raises VerifyError if they are missing or altered."""
        try:
            return self._object(entry.table)
        except VerifyError as err:
            where = f"machine {entry.machine}, table of entry {entry.number}"
            raise VerifyError(f"{where}: {err}; put it back from a copy") from None

    def append(
        self, machine: str, action: str, table: bytes, why: str, time: str, key: SecretKey, after: int, back_to: int = 0
    ) -> Entry:
        """A new entry after entry number `after`. Raises GateError if another writer was first."""
        if key.public != self.key:
            raise UsageError(f"the secret key is {key.public.name}, the registry's public key {self.key.name}")
        past = self.history(machine)
        previous = past[after - 1].digest if 0 < after <= len(past) else ""
        digest = self._put(table)
        entry = Entry(machine, after + 1, action, digest, time, why, previous, back_to)
        data = jsonfile.dumps(entry.plain()).encode()
        name = self._put(data)
        signature = key.sign(data, f"machine {machine} entry {after + 1} table {digest} time {time}")
        self._put_signature(name, signature)
        place = self._machine(machine)
        place.mkdir(parents=True, exist_ok=True)
        if not _link(f"{name}\n".encode(), place / f"{after + 1:06d}"):
            raise GateError(
                f"machine {machine}: another writer was first with entry {after + 1}: see `errpipe log`, then try again"
            )
        return replace(entry, digest=name)

    def _machine(self, machine: str) -> Path:
        if not _MACHINE.fullmatch(machine):
            raise UsageError(f"{machine!r} cannot be a machine's name (allowed: letters, digits, '.', '_' and '-')")
        return self.folder / "machines" / machine

    def _entry(self, place: Path) -> Entry:
        name = files.read(place, 100, VerifyError).decode("ascii", errors="replace").strip()
        data = self._object(name)
        signature = files.read(self._signature(name), MAX_ENTRY_BYTES, VerifyError).decode("utf-8", errors="replace")
        verify(data, signature, self.key, str(place))
        try:
            plain = json.loads(data)
            if plain.pop("registry_entry") not in (1, VERSION):
                raise VerifyError(f"{place}: an entry of a newer registry")
            return Entry(**plain, digest=name)
        except (ValueError, TypeError, KeyError, AttributeError):
            raise VerifyError(f"{place}: not an entry of a registry") from None

    def _path(self, digest: str) -> Path:
        if not _DIGEST.fullmatch(digest):
            raise VerifyError(f"{self.folder}: {digest[:80]!r} is no SHA-256")
        return self.folder / "objects" / digest[:2] / digest

    def _signature(self, digest: str) -> Path:
        return self._path(digest).with_name(f"{digest}.minisig")

    def _object(self, digest: str) -> bytes:
        data = files.read(self._path(digest), MAX_OBJECT_BYTES, VerifyError)
        if hashlib.sha256(data).hexdigest() != digest:
            raise VerifyError(f"{self._path(digest)}: was changed (its SHA-256 is no longer its name)")
        return data

    def _put(self, data: bytes) -> str:
        digest = hashlib.sha256(data).hexdigest()
        path = self._path(digest)
        if not _link(data, path):
            self._object(digest)  # it is there already: it must be the same
        return digest

    def _put_signature(self, digest: str, signature: str) -> None:
        _link(signature.encode(), self._signature(digest))


def _link(data: bytes, path: Path) -> bool:
    """Put bytes at a path whole and on disk, only where nothing is there. False where something is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=".new-")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(data)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o444)
        try:
            os.link(temporary, path)
        except FileExistsError:
            return False
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)
        os.close(folder)
        return True
    except OSError as err:
        raise OSError(err.errno, err.strerror, str(path)) from None
    finally:
        os.unlink(temporary)
