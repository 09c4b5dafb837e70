"""SQLite databases, a sheet per table. Views are not opened because they are programs."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from pathlib import Path

from errpipe.errors import DataError
from errpipe.importing.sheet import DoorOptions, Sheet, affordable

name = "SQLite"
suffixes = (".db", ".sqlite", ".sqlite3")
binary = True
_TABLES = "select name from sqlite_master where type = 'table' and name not like 'sqlite%' and sql not like '%virtual%'"


def sniff(path: Path, head: bytes) -> bool:
    """The first bytes of a database."""
    return head.startswith(b"SQLite format 3\0")


def read(path: Path, options: DoorOptions) -> list[Sheet]:
    """The named table, else all, the largest first. Raises DataError, also if a journal contains pending rows."""
    for beside in (Path(f"{path}-wal"), Path(f"{path}-journal")):
        if beside.is_file() and beside.stat().st_size:
            raise DataError(
                f"{path}: still open in another program, or not closed properly ({beside.name}): close it there first"
            )
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            database.execute("pragma trusted_schema = off")
            if (state := database.execute("pragma quick_check(1)").fetchone()[0]) != "ok":
                raise sqlite3.DatabaseError(state)
            names = [str(row[0]) for row in database.execute(_TABLES)]
            sheets = [_table(database, n, path) for n in names if options.sheet in (None, n)]
    except sqlite3.Error as err:
        raise DataError(f"{path}: not a database that can be read ({err}): export the table as CSV") from None
    return sorted(sheets, key=lambda s: -sum(map(len, s.rows)))


def _table(database: sqlite3.Connection, table: str, path: Path) -> Sheet:
    quoted = '"' + table.replace('"', '""') + '"'
    (rows,) = database.execute(f"select count(*) from {quoted}").fetchone()
    cursor = database.execute(f"select * from {quoted}")
    header = [column[0] for column in cursor.description]
    affordable(rows * len(header), f"{path}: {table}")
    rows = [[float(v) if isinstance(v, int) else v if isinstance(v, float | str) else None for v in r] for r in cursor]
    return Sheet(table, rows, header)
