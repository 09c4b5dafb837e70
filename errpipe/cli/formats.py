"""`errpipe formats`."""

from __future__ import annotations

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import print_answer, stage_module


def command(
    name: str = typer.Argument("", metavar="[NAME]", help="One format, such as ecmc_dat."), json: bool = Json
) -> None:
    """List the measurement files that are read, or show one format.

    \b
    Example:
      errpipe formats
      errpipe formats ecmc_dat
    """
    print_answer("formats", stage_module("catalogue").formats(name), as_json=json)
