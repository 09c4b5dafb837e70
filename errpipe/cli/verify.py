"""`errpipe verify`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    folder: Path = typer.Argument(metavar="DIR", help="A folder that `export` wrote, or a table alone."),
    public_key: Path | None = typer.Option(
        None, "--public-key", metavar="FILE", help="The table must be signed by this key."
    ),
    json: bool = Json,
) -> None:
    """Read exported files back and compare them with the model.

    Exit code 6 on the first thing that does not hold.

    \b
    Example:
      errpipe verify out/axis/export
    """
    if public_key is not None:
        module_of("stages.signing").verify_signature(folder if folder.is_file() else folder / "table.ect", public_key)
    print_answer("verify", module_of("verbs.verify").verify(folder), as_json=json)
