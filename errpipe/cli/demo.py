"""`errpipe demo`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    out: Path = typer.Option(Path("out/demo"), "--out", metavar="DIR", help="Folder for the outputs."),
    json: bool = Json,
) -> None:
    """Run the main job on a simulated ball-screw axis; no files needed.

    \b
    Example:
      errpipe demo
      errpipe demo --out out/demo
    """
    from errpipe.cli.progress import ProgressReporter

    print_answer("demo", module_of("verbs.demo").demo(out, ProgressReporter(str(out)).callbacks()), as_json=json)
