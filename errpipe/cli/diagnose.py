"""`errpipe diagnose`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer, print_result
from errpipe.errors import UsageError


def command(
    recording: Path = typer.Argument(metavar="RECORDING", help="Folder with a recording manifest."),
    out: Path = typer.Option(..., "--out", metavar="DIR", help="Folder for diagnosis.json and report.html."),
    simulation: Path = typer.Option(
        None, "--simulation", metavar="FILE", help="CSV, error model or FMU, if not in the recording."
    ),
    apply: Path | None = typer.Option(
        None, "--apply", metavar="DIR", help="Folder for the corrected simulation: recording, terms, patch, FMU."
    ),
    against: Path | None = typer.Option(
        None, "--against", metavar="FINDINGS", help="An earlier diagnosis.json: is each effect still there?"
    ),
    json: bool = Json,
) -> None:
    """Find physical effects in a recording that its simulation lacks.

    Compares each error column with its simulated twin; writes diagnosis.json and report.html.
    With --against: against.json, and exit code 4 where an effect changed.

    \b
    Example:
      errpipe diagnose recording --out out/diagnosis
      errpipe diagnose recording --out out/diagnosis --apply out/corrected
      errpipe diagnose later --out new --against out/diagnosis/diagnosis.json
    """
    from errpipe.cli.progress import ProgressReporter

    if against is not None:
        if apply is not None:
            raise UsageError("--apply and --against: one of the two")
        held = module_of("stages.diagnose").against(recording, against, out, simulation)
        code = 4 if held["changed"] else 0
        says = held.pop("says")
        print_result("diagnose", held, says, as_json=json, code=code)
        raise typer.Exit(code)
    reporter = ProgressReporter(str(out))
    try:
        diagnosis = module_of("stages.diagnose").diagnose(
            recording, out, reporter.progress_of("diagnose"), simulation, apply
        )
    finally:
        reporter.clear()
    print_answer("diagnose", diagnosis, as_json=json)
