"""`errpipe init`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer

NAMES = "laser-iso230, dial-gauge, diagnose-log, spindle-drift, gantry, drilled-plate, five-axis"


def command(
    folder: Path = typer.Argument(metavar="DIR", help="The folder to write."),
    template: str = typer.Option("laser-iso230", "--template", metavar="NAME", help=f"One of: {NAMES}."),
    recording: Path | None = typer.Option(
        None, "--recording", metavar="FOLDER", help="A recording of your own instead of the sample."
    ),
    target: list[str] = typer.Option(
        [], "--target", metavar="NAME", help="A controller format instead of the default ones. Repeatable."
    ),
    json: bool = Json,
) -> None:
    """Create a folder with a pipeline, ready to run, from a template.

    \b
    Example:
      errpipe init --template laser-iso230 axis
      errpipe init --template dial-gauge mill --recording data --target c_runtime
    """
    print_answer("init", module_of("verbs.init").init(folder, template, recording, target), as_json=json)
