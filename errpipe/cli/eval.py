"""`errpipe eval`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import At, Json, input_values
from errpipe.cli.output import module_of, print_answer


def command(
    table: Path = typer.Argument(metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    at: list[str] = At,
    json: bool = Json,
) -> None:
    """Evaluate a compensation table at one point.

    \b
    Example:
      errpipe eval out/axis/export/table.ect --at x=100 --at T_nut=25
    """
    print_answer("eval", module_of("verbs.evaluate").evaluate(table, input_values(at)), as_json=json)
