"""`errpipe correct`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import At, Json, values


def command(
    program: Path = typer.Argument(..., metavar="PROGRAM", help="An NC program (RS-274, the LinuxCNC dialect)."),
    table: Path = typer.Option(..., "--table", metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    out: Path | None = typer.Option(
        None, "--out", metavar="FILE", help="Where to write; default: standard output.", show_default=False
    ),
    at: list[str] = At,
    json: bool = Json,
) -> None:
    """Rewrite an NC program so that the uncorrected machine cuts the part.

    \b
    Example:
      errpipe correct part.ngc --table out/axis/export/table.ect --at T_nut=25 --out part-corrected.ngc
    """
    from errpipe.cli.say import answer, work

    answer("correct", work("correct").correct(program, table, out, values(at)), as_json=json)
