"""`errpipe diagnose`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    recording: Path = typer.Argument(..., metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for diagnosis.json and report.html."),
    json: bool = Json,
) -> None:
    """Find the physics that a simulation leaves out of a recording.

    Compares each error column with its simulated twin; writes diagnosis.json and report.html.

    \b
    Example:
      errpipe diagnose examples/vmc-1 --out out/diagnosis
    """
    from errpipe.cli.say import answer, work

    answer("diagnose", work("diagnose").diagnose(recording, out), as_json=json)
