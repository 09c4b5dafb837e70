"""`errpipe plan-day`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_result

_By = typer.Option([], "--by", metavar="GROUP", help="Group column of duty cycles; default: duty_cycle. Repeatable.")


def command(
    recording: Path | None = typer.Argument(None, metavar="RECORDING", help="Folder of the days recorded so far."),
    log: Path = typer.Option(None, "--log", metavar="FOLDER", help="Recording of temperatures: further duty cycles."),
    component: str = typer.Option(None, "--component", metavar="NAME", help="The error that is modelled, such as E_D."),
    by: list[str] = _By,
    least: float = typer.Option(
        None, "--least", metavar="UM", min=0.0, help="Stop if the gain is below this rms; default: the noise."
    ),
    speed: float | None = typer.Option(None, "--speed", metavar="RPM", min=1.0, help="Plan speeds up to this one."),
    hours: float = typer.Option(8.0, "--hours", metavar="H", min=0.5, max=48.0, help="With --speed: length of a day."),
    noise: float = typer.Option(
        1.0, "--noise", metavar="UM", min=1e-3, help="With --speed: standard deviation of a reading."
    ),
    standing: float = typer.Option(
        0.0, "--standing", metavar="SHARE", min=0.0, max=1.0, help="With --speed: least share at rest."
    ),
    json: bool = Json,
) -> None:
    """Select the thermal duty cycle to record next; show its benefit.

    Of a recording with temperatures and measured errors: the duty cycle after which errors are expected to be predicted
    best in all states recorded or logged. With --speed: spindle speeds that teach a model of spindle heat most. Either
    stops when another day would hardly change the predictions.

    \b
    Example:
      errpipe plan-day recording
      errpipe plan-day --speed 6000 --hours 4
    """
    stage = module_of("verbs.plan_day")
    if speed is None and recording is not None and stage.has_errors(recording):
        document, lines = stage.from_errors(recording, log, component, by, least)
    else:
        document, lines = stage.from_speeds(recording, speed, hours, noise, standing)
    print_result("plan-day", document, lines, as_json=json)
