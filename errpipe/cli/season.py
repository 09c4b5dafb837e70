"""`errpipe season`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    recording: Path = typer.Argument(..., metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for the figures and the report."),
    json: bool = Json,
) -> None:
    """Leave whole seasons out, and say what each candidate is worth.

    \b
    Example:
      errpipe season examples/vmc-1 --out out/season
    """
    from errpipe.cli.say import answer, work

    answer("season", work("season").season(recording, out), as_json=json)
