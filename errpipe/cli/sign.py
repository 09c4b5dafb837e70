"""`errpipe sign`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json, SecretKey
from errpipe.cli.output import module_of, print_answer


def command(
    file: Path = typer.Argument(metavar="FILE", help="A table, or any other file."),
    key: Path = SecretKey,
    comment: str = typer.Option("", "--comment", metavar="TEXT", help="Signed along with the file, such as a machine."),
    json: bool = Json,
) -> None:
    """Sign a file; `minisign` can check the signature, too.

    \b
    Example:
      errpipe sign out/export/table.ect --key errpipe.key --comment "machine 7"
    """
    print_answer("sign", module_of("stages.signing").sign(file, key, comment), as_json=json)
