"""`errpipe show`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    file: Path = typer.Argument(metavar="FILE", help="Any file or folder that errpipe reads or writes."),
    json: bool = Json,
) -> None:
    """Describe a file, with a plot for the terminal.

    \b
    Example:
      errpipe show recording
      errpipe show out/export/table.ect
    """
    print_answer("show", module_of("verbs.show").show(file), as_json=json)
