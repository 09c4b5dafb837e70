"""`errpipe synthesis`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_result


def command(
    machine: Path = typer.Argument(metavar="MACHINE", help="A machine file with the kinematic chain (YAML)."),
    json: bool = Json,
) -> None:
    """Print the error model of a machine in symbols.

    What each error component does to the tool point, first order: arms in mm, L the tool's length, T its offsets.

    \b
    Example:
      errpipe synthesis examples/machines/horizontal-centre-ni-1997.yaml
    """
    document, lines = module_of("verbs.synthesis").synthesis(machine)
    print_result("synthesis", document, lines, as_json=json)
