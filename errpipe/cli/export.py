"""`errpipe export`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    table: Path = typer.Argument(..., metavar="TABLE", help="A compensation table (.ect or its JSON twin)."),
    target: list[str] = typer.Option(..., "--target", metavar="NAME", help="Controller format. Repeatable."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for the controller's files."),
    json: bool = Json,
) -> None:
    """Write a compensation table as the files of a controller.

    \b
    Example:
      errpipe export out/axis/export/table.ect --target linuxcnc_screw --out out/linuxcnc
    """
    from errpipe.cli.output import print_answer, stage_module

    print_answer("export", stage_module("targets").export(table, target, out), as_json=json)
