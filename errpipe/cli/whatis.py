"""`errpipe whatis`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    file: Path = typer.Argument(metavar="FILE", help="Any file that errpipe reads or writes."), json: bool = Json
) -> None:
    """Describe a file: machine, model, validity, cost per cycle.

    \b
    Example:
      errpipe whatis out/axis/export/table.ect
    """
    print_answer("whatis", module_of("verbs.whatis").whatis(file), as_json=json)
