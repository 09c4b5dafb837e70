"""`errpipe diagnose`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    recording: Path = typer.Argument(..., metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for diagnosis.json and report.html."),
    simulation: Path = typer.Option(
        None, "--simulation", metavar="FILE", help="CSV, error model or FMU where the recording holds no twin."
    ),
    json: bool = Json,
) -> None:
    """Find the physics that a simulation leaves out of a recording.

    Compares each error column with its simulated twin; writes diagnosis.json and report.html.

    \b
    Example:
      errpipe diagnose examples/vmc-1 --out out/diagnosis
    """
    from errpipe.cli.progress import Watcher
    from errpipe.cli.say import answer, work

    watcher = Watcher(str(out))
    try:
        found = work("diagnose").diagnose(recording, out, watcher.progress_of("diagnose"), simulation)
    finally:
        watcher.clear()
    answer("diagnose", found, as_json=json)
