"""A table whose signature holds: the only access to a table where only signed ones are allowed."""

from __future__ import annotations

from pathlib import Path

from errpipe import files
from errpipe.domain.table import CompensationTable
from errpipe.errors import VerifyError
from errpipe.registry import minisign
from errpipe.tables import ect


def read_table(path: Path, key: minisign.PublicKey) -> CompensationTable:
    """A `.ect` file whose signature (FILE.minisig) is that key's; what was checked is what is read.

    Raises VerifyError if the table is unsigned, was changed after it was signed, or is signed by another key.
    """
    data = files.read(Path(path), ect.MAX_FILE_BYTES, VerifyError)
    minisign.verify(data, minisign.signature_of(path), key, str(path))
    return ect.loads(data)


def remarks(table: CompensationTable, signature: str, key: minisign.PublicKey) -> tuple[str, ...]:
    """Lines that carry a table's identity and signature into a controller's file."""
    _, own, comment, whole = signature.split("\n")[:4]
    return (f"made from table {ect.fingerprint(table)}, signed by {key.name}: {own}", f"{comment}: {whole}")
