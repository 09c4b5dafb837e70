"""`errpipe whatis`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import print_answer, stage_module


def command(
    file: Path = typer.Argument(metavar="FILE", help="Any file that errpipe reads or writes."), json: bool = Json
) -> None:
    """Say what a file is: machine, model, validity, cost per cycle.

    \b
    Example:
      errpipe whatis out/axis/export/table.ect
    """
    print_answer("whatis", stage_module("whatis").whatis(file), as_json=json)
