"""`errpipe verify-signature`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json, PublicKey
from errpipe.cli.output import module_of, print_answer


def command(
    file: Path = typer.Argument(metavar="FILE", help="The file; its signature is FILE.minisig."),
    public_key: Path = PublicKey,
    json: bool = Json,
) -> None:
    """Check a signature; exit code 6 if missing, invalid or foreign.

    \b
    Example:
      errpipe verify-signature out/export/table.ect --public-key keys/errpipe.pub
    """
    print_answer("verify-signature", module_of("stages.signing").verify_signature(file, public_key), as_json=json)
