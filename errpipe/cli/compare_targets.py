"""`errpipe compare-targets`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    table: Path = typer.Argument(..., metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    json: bool = Json,
) -> None:
    """Say what each controller format would lose of a table, in um.

    \b
    Example:
      errpipe compare-targets out/axis/export/table.ect
    """
    from errpipe.cli.say import answer, work

    answer("compare-targets", work("targets").compare_targets(table), as_json=json)
