"""`errpipe measure`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
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
    json: bool = Json,
) -> None:
    """Plan a test that shows all errors of a machine, as G-code.

    A telescoping ball bar from a few sockets with a few tools, in minimum time; unobservable components are listed.
    Positions are machine coordinates; M0 stops say when to attach and to detach the bar. Run it without a bar first.

    \b
    Example:
      errpipe measure examples/machines/vertical-centre.yaml --out plan.ngc
    """
    print_answer("measure", module_of("stages.measure").measure(machine, out, without, positions, reach), as_json=json)
