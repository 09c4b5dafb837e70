"""`errpipe keygen`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    folder: Path = typer.Argument(metavar="DIR", help="Where errpipe.key (secret) and errpipe.pub are written."),
    json: bool = Json,
) -> None:
    """Generate a key pair for signing, in minisign's format.

    The secret key has no password: keep it where only the signer can read it. A key is never overwritten.

    \b
    Example:
      errpipe keygen keys
    """
    print_answer("keygen", module_of("stages.signing").keygen(folder), as_json=json)
