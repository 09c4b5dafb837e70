"""`errpipe formats`."""

from __future__ import annotations

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    name: str = typer.Argument("", metavar="[NAME]", help="One format, such as ecmc_dat."), json: bool = Json
) -> None:
    """List the readable measurement file formats, or show one.

    \b
    Example:
      errpipe formats
      errpipe formats ecmc_dat
    """
    print_answer("formats", module_of("verbs.catalogue").formats(name), as_json=json)
