"""`errpipe export`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    table: list[Path] = typer.Argument(
        metavar="TABLE...", help="A compensation table (.ect or its JSON twin); tables of several axes become one."
    ),
    target: list[str] = typer.Option(..., "--target", metavar="NAME", help="Controller format. Repeatable."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for the controller's files."),
    limit: float | None = typer.Option(
        None,
        "--limit",
        metavar="UM",
        min=0.001,
        help="Largest plausible correction; default: 0.5 mm or 1/1000 of the travel.",
    ),
    allow: list[str] = typer.Option(
        [], "--allow", metavar="NAME", help="Name of an implausible declaration that is correct. Repeatable."
    ),
    public_key: Path | None = typer.Option(
        None, "--public-key", metavar="FILE", help="Require a table signed by this key."
    ),
    json: bool = Json,
) -> None:
    """Convert a compensation table to the files of a controller.

    \b
    Example:
      errpipe export axis/out/export/table.ect --target linuxcnc_screw --out pc
      errpipe export x/table.ect y/table.ect --target fanuc_pitch --out machine
    """
    print_answer(
        "export", module_of("stages.targets").export(table, target, out, allow, limit, public_key), as_json=json
    )
