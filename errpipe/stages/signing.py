"""Signatures and the registry: what was on which machine, since when and why; promote, roll back, look up."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

from errpipe import files
from errpipe.errors import GateError, UsageError, VerifyError, did_you_mean
from errpipe.registry import minisign
from errpipe.stages import _artefacts

if TYPE_CHECKING:
    from errpipe.domain.table import CompensationTable
    from errpipe.registry.store import Entry, Registry

MAX_WHY = 500  # characters of a reason


def keygen(folder: Path) -> dict[str, Any]:
    """A new key pair in a folder. Raises UsageError if there is one already."""
    secret, public = minisign.write_pair(minisign.generate(), folder)
    key = minisign.read_public(public).name
    return {
        "key": key,
        "secret": str(secret),
        "public": str(public),
        "says": [f"{secret}: keep it secret", f"{public}: give it away"],
    }


def sign(file: Path, secret: Path, comment: str) -> dict[str, Any]:
    """Sign a file; a table's identity goes into the trusted comment. Raises VerifyError for an invalid key."""
    key = minisign.read_secret(secret)
    words = [
        f"file {file.name}",
        *([f"table {identity(file)}"] if file.suffix == ".ect" else []),
        *([comment] if comment else []),
    ]
    signature_file = minisign.sign_file(file, key, ", ".join(words))
    return {
        "signature": str(signature_file),
        "key": key.public.name,
        "says": [f"{signature_file}: signed by {key.public.name}"],
    }


def verify_signature(file: Path, public: Path) -> dict[str, Any]:
    """The trusted comment of a file's signature. Raises VerifyError if it is unsigned, touched or of another key."""
    key = minisign.read_public(public)
    comment = minisign.verify_file(file, key)
    return {"key": key.name, "comment": comment, "says": [f"{file}: signed by {key.name}: {comment}"]}


def identity(table: Path) -> str:
    """The identity that a controller shows for a table. Raises VerifyError if it is not a table."""
    from errpipe.tables import ect

    return ect.fingerprint(_artefacts.read_table(table))


def promote(
    registry: Path,
    machine: str,
    table: Path,
    why: str,
    secret: Path,
    public: Path,
    time: str | None,
    other_outputs: bool = False,
) -> dict[str, Any]:
    """Put a table on record as the one of a machine.

    other_outputs: the table may correct other axes, or be made for another machine, than the one that it replaces.
    Raises GateError if it does so without, or where another writer was first.
    """
    from errpipe.registry.store import MAX_OBJECT_BYTES
    from errpipe.tables import ect

    store = _registry(registry, public)
    past = store.history(machine)
    name = identity(table)
    data, new = files.read(table, MAX_OBJECT_BYTES, UsageError), _artefacts.read_table(table)
    if data[:1] == b"{":  # the JSON twin: on record is what a controller loads
        data = ect.dumps(new)
    if not other_outputs:
        _refuse_other_machine(store.machines(), machine, new, table)
    if past and not other_outputs:
        _refuse_other_outputs(store.table(past[-1]), new, machine, table)
    when = _time_after(past, time)
    entry = store.append(machine, "promote", data, _why(why), when, minisign.read_secret(secret), len(past))
    return _row(entry, store) | _with_remark(f"machine {machine}: table {name} is entry {entry.number}", when)


def _refuse_other_outputs(before: bytes, table: CompensationTable, machine: str, path: Path) -> None:
    """Raises GateError if a table is of another machine, axes or units than the one that it replaces.

    A controller runs one table: a table of Y alone in place of that of X ends the compensation of X, and one whose
    corrections are in um moves an axis that expects mm 1000 times too far.
    """
    from errpipe.tables import ect

    old = ect.loads_any(before)
    if old.machine and table.machine and old.machine != table.machine:
        reason = f"was made for {table.machine!r}, the one on record for {old.machine!r}"
    elif _outputs(old) != _outputs(table):
        reason = f"corrects {_outputs(table)}, the one on record {_outputs(old)}, and a table replaces all outputs"
    else:
        return
    raise GateError(
        f"machine {machine}: {path} {reason}. Give it a separate name in the registry, or use --other-outputs"
    )


def _refuse_other_machine(known: Sequence[str], machine: str, table: CompensationTable, path: Path) -> None:
    """Raises GateError if a table is of another machine of this registry; 7-X may have tables of 7."""
    of = table.machine
    if of in known and of != machine and not machine.startswith((f"{of}-", f"{of}.", f"{of}_")):
        raise GateError(
            f"machine {machine}: {path} was made for {of}, which this registry has too. Promote it there, or say"
            " --other-outputs"
        )


def _outputs(table: CompensationTable) -> str:
    """What a table corrects, in words, such as `E_X (axis X, in mm), E_C (axis C, in deg)`."""
    axes = (f"axis {o.axis}, in {o.correction_unit}" if o.axis else f"in {o.correction_unit}" for o in table.outputs)
    return ", ".join(sorted(f"{o.name} ({words})" for o, words in zip(table.outputs, axes, strict=True)))


def rollback(
    registry: Path,
    machine: str,
    to: int | None,
    out: Path | None,
    why: str,
    secret: Path,
    public: Path,
    time: str | None,
) -> dict[str, Any]:
    """Put the table of an earlier entry back on record, and write it to a file.

    Default: the table before the present one was promoted. A second rollback returns to one earlier, not to
    the table that the first one took off the machine.
    """
    store = _registry(registry, public)
    past = store.history(machine)
    if not past:
        raise UsageError(f"machine {machine} has no history in {registry}")
    earlier = _earlier_entries(past) if to is None else [e for e in past if e.number == to]
    if not earlier:
        store.table(past[-1])  # a modified one is refused as such, for every request
        raise UsageError(f"machine {machine}: no earlier table to go back to (--to: entries 1 to {len(past)})")
    data, when = store.table(earlier[-1]), _time_after(past, time)
    to, key = earlier[-1].number, minisign.read_secret(secret)
    if out is not None and out.is_dir():
        raise UsageError(f"--out {out}: is a folder (a file is needed)")
    with files.whole(out) if out is not None else BytesIO() as stream:  # it cannot be written: nothing is on record
        stream.write(data)
        entry = store.append(machine, "rollback", data, _why(why), when, key, len(past), to)
    sentence = f"machine {machine}: entry {entry.number} is again the table of entry {to}"
    return _row(entry, store) | _with_remark(sentence, when)


def _earlier_entries(past: Sequence[Entry]) -> list[Entry]:
    """The entries of other tables below the one on record, as they would be gone back to.

    A promotion lies on top of what was on record. A rollback restores what was on record after the entry that it
    returns to. One of version 1 does not state it: the nearest below with the same table, else the last with it.
    """
    on_record: list[tuple[Entry, ...]] = [()]  # after each entry
    for entry in past:
        if entry.action == "promote":
            on_record.append((*on_record[-1], entry))
            continue
        promoted = [e for e in past[: entry.number] if e.action == "promote"]
        same = [e.number for e in (*promoted, *on_record[-1]) if e.table == entry.table]
        on_record.append(on_record[entry.back_to or [0, *same][-1]])
    return [e for e in on_record[-1] if e.table != past[-1].table]


def log(registry: Path, machine: str | None, at: str | None, file: Path | None, public: Path) -> dict[str, Any]:
    """A machine's history, what was on it at a time, or which entries a file found on a controller belongs to.

    Raises UsageError if there is no registry, or no machine of that name in it.
    """
    store = _registry(registry, public)
    known = store.machines()
    if not known:
        raise UsageError(f"{registry}: no registry here (`errpipe promote` begins one)")
    if machine is not None and machine not in known:
        raise UsageError(f"machine {machine} has no history in {registry}.{did_you_mean(machine, known)}")
    rows = [_row(e, store) for name in ([machine] if machine is not None else known) for e in store.history(name)]
    if file is not None:
        wanted = identity(file)
        if all(row["identity"] != wanted for row in rows):
            raise VerifyError(f"{file}: table {wanted} was never recorded in {registry}")
    if at is not None:  # before the file: another table may have taken its place by then
        then = _time(at)
        until = _time(f"{at}T23:59:59") if len(at) == len("2026-03-03") else then  # a date alone is the whole day
        last = {row["machine"]: row["number"] for row in rows if row["time"] <= then}
        before = [r["number"] - last.get(r["machine"], 0) for r in rows]  # 0: it was on the machine at that time
        rows = [r for r, n in zip(rows, before, strict=True) if n == 0 or (n > 0 and r["time"] <= until)]
    rows = [row for row in rows if file is None or row["identity"] == wanted]
    words = [f"{r['action']} to {r['back_to']}" if r["back_to"] else r["action"] for r in rows]
    lines = [
        f"{r['machine']} {r['number']:>4}  {r['time']}  {done:<8}  table {r['identity']}  {r['why']}"
        for r, done in zip(rows, words, strict=True)
    ]
    return {"entries": rows, "says": lines or ["no entries"]}


def _registry(folder: Path, public: Path) -> Registry:
    from errpipe.registry.store import Registry

    return Registry(folder, minisign.read_public(public))


def _row(entry: Entry, store: Registry) -> dict[str, Any]:
    from errpipe.tables import ect

    return entry.plain() | {"identity": ect.fingerprint(ect.loads_any(store.table(entry)))}


def _why(text: str) -> str:
    if not text.strip() or len(text) > MAX_WHY or not text.isprintable():
        raise UsageError(f"--why: one printable line of at most {MAX_WHY} characters is needed")
    return text.strip()


def _time_after(past: Sequence[Entry], text: str | None) -> str:
    """The time of a new entry. Raises UsageError if this host's clock has not come to that of the last one."""
    time = _time(text)
    if text is None and past and time < past[-1].time:
        raise UsageError(
            f"this host's clock reads {time}, which is before entry {past[-1].number} ({past[-1].time}): one of them"
            " is wrong, and `log --at` would use it. Set the clock, or use --time."
        )
    return time


def _with_remark(sentence: str, when: str) -> dict[str, Any]:
    """What is printed of a new entry, with a remark on a time that has not come: a slip (2062 for 2026) stays for good.

    It is no error: a host's clock may be the wrong one.
    """
    now = _time(None)
    if when <= now:
        return {"says": [sentence]}
    remark = f"{when} is later than this host's clock ({now}): `log --at` knows the table from then on only"
    return {"says": [sentence, remark], "remark": remark}


def _time(text: str | None) -> str:
    """A time as UTC, ISO 8601; now, where none is stated. A record of when is the one place where a clock belongs."""
    if text is None:
        return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
    try:
        time = datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(f"{text!r} is not a time (allowed: such as 2026-03-03 or 2026-03-03T14:00:00Z)") from None
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).astimezone(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
