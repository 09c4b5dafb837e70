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
    from errpipe.cli.output import print_answer, stage_module
    from errpipe.cli.progress import ProgressReporter

    reporter = ProgressReporter(str(out))
    try:
        found = stage_module("diagnose").diagnose(recording, out, reporter.progress_of("diagnose"), simulation)
    finally:
        reporter.clear()
    print_answer("diagnose", found, as_json=json)
