"""`errpipe verify`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    folder: Path = typer.Argument(..., metavar="DIR", help="A folder that `export` wrote."), json: bool = Json
) -> None:
    """Read exported files back and prove that they say what the model says.

    Exit code 6 on the first thing that does not hold.

    \b
    Example:
      errpipe verify out/axis/export
    """
    from errpipe.cli.output import print_answer, stage_module

    print_answer("verify", stage_module("verify").verify(folder), as_json=json)
