"""Verbs that plan measurements, and the error model of a machine in symbols."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from errpipe.cli.output import Answer, module_of
from errpipe.errors import UsageError

_By = typer.Option([], "--by", metavar="GROUP", help="Group column of duty cycles; default: duty_cycle. Repeatable.")


def measure(
    machine: Path = typer.Argument(metavar="MACHINE", help="A machine file with the kinematic chain (YAML)."),
    out: Path = typer.Option(..., "--out", metavar="FILE.ngc", help="Where to write the program."),
    without: list[str] = typer.Option(
        [], "--without", metavar="NAME", help="A component that need not be observable. Repeatable."
    ),
    positions: int = typer.Option(
        40, "--positions", metavar="N", min=6, max=500, help="Positions per socket and tool."
    ),
    reach: tuple[float, float] = typer.Option(
        (150.0, 1200.0), "--reach", metavar="MIN MAX", help="Shortest and longest length of the bar, mm."
    ),
) -> Mapping[str, Any]:
    """Plan a test that shows all errors of a machine, as G-code.

    A telescoping ball bar from a few sockets with a few tools, in minimum time; unobservable components are listed.
    Positions are machine coordinates; M0 stops say when to attach and to detach the bar. Run it without a bar first.

    \b
    Example:
      errpipe measure examples/machines/vertical-centre.yaml --out plan.ngc
    """
    return module_of("stages.measure").measure(machine, out, without, positions, reach)


def place(
    field: Path = typer.Argument(None, metavar="FIELD.csv", help="Readings at candidate places, with the error."),
    error: str = typer.Option("error", "--error", metavar="COLUMN", help="Column of the error."),
    group: str = typer.Option("duty_cycle", "--group", metavar="COLUMN", help="Column of the duty cycle."),
    time: str = typer.Option(None, "--time", metavar="COLUMN", help="Column of the time, not a sensor position."),
    most: int = typer.Option(4, "--most", metavar="N", min=1, max=20, help="Maximum number of sensors."),
    bar: float = typer.Option(
        None, "--bar", min=0.0, metavar="LOSS", help="A simulated heated bar of heat loss (mL)^2 instead of a file."
    ),
) -> Answer:
    """Select the number and positions of temperature sensors.

    A sum of readings is fitted to the error and validated on held-out duty cycles, against no compensation.

    \b
    Example:
      errpipe place --bar 1.5
    """
    if (field is None) == (bar is None):
        raise UsageError("place: give either a file or --bar LOSS")
    stage = module_of("verbs.place")
    return Answer(*(stage.place(field, error, group, time, most) if bar is None else stage.bar(bar, most)))


def plan_day(
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
) -> Answer:
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
        return Answer(*stage.from_errors(recording, log, component, by, least))
    return Answer(*stage.from_speeds(recording, speed, hours, noise, standing))


def synthesis(
    machine: Path = typer.Argument(metavar="MACHINE", help="A machine file with the kinematic chain (YAML)."),
) -> Answer:
    """Print the error model of a machine in symbols.

    What each error component does to the tool point, first order: arms in mm, L the tool's length, T its offsets.

    \b
    Example:
      errpipe synthesis examples/machines/horizontal-centre-ni-1997.yaml
    """
    return Answer(*module_of("verbs.synthesis").synthesis(machine))
