"""`errpipe compare-targets`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    table: Path = typer.Argument(metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    json: bool = Json,
) -> None:
    """Show what each controller format cannot express of a table, in um.

    \b
    Example:
      errpipe compare-targets out/axis/export/table.ect
    """
    print_answer("compare-targets", module_of("stages.targets").compare_targets(table), as_json=json)
