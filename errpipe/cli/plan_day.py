"""`errpipe plan-day`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    recording: Path = typer.Argument(None, metavar="RECORDING", help="Folder of the days recorded so far."),
    speed: float = typer.Option(None, "--speed", min=1.0, help="Highest spindle speed, rpm."),
    hours: float = typer.Option(8.0, "--hours", min=0.5, max=48.0, help="Length of a day."),
    noise: float = typer.Option(1.0, "--noise", min=1e-3, help="Standard deviation of a reading, um."),
    standing: float = typer.Option(0.0, "--standing", min=0.0, max=1.0, help="Least share at rest."),
    json: bool = Json,
) -> None:
    """Say which thermal duty cycle to run next, and what it brings.

    Speeds that teach a model of spindle heat most; stops when another day would hardly change its predictions.

    \b
    Example:
      errpipe plan-day --speed 6000 --hours 4
    """
    from errpipe.cli.output import print_result, stage_module

    document, lines = stage_module("plan_day").plan_day(recording, speed, hours, noise, standing)
    print_result("plan-day", document, lines, as_json=json)
