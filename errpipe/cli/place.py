"""`errpipe place`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_result
from errpipe.errors import UsageError


def command(
    field: Path = typer.Argument(None, metavar="FIELD.csv", help="Readings at candidate places, with the error."),
    error: str = typer.Option("error", "--error", metavar="COLUMN", help="Column of the error."),
    group: str = typer.Option("duty_cycle", "--group", metavar="COLUMN", help="Column of the duty cycle."),
    time: str = typer.Option(None, "--time", metavar="COLUMN", help="Column of the time, not a sensor position."),
    most: int = typer.Option(4, "--most", metavar="N", min=1, max=20, help="Maximum number of sensors."),
    bar: float = typer.Option(
        None, "--bar", min=0.0, metavar="LOSS", help="A simulated heated bar of heat loss (mL)^2 instead of a file."
    ),
    json: bool = Json,
) -> None:
    """Select the number and positions of temperature sensors.

    A sum of readings is fitted to the error and validated on held-out duty cycles, against no compensation.

    \b
    Example:
      errpipe place --bar 1.5
    """
    if (field is None) == (bar is None):
        raise UsageError("place: give either a file or --bar LOSS")
    stage = module_of("verbs.place")
    document, lines = stage.place(field, error, group, time, most) if bar is None else stage.bar(bar, most)
    print_result("place", document, lines, as_json=json)
