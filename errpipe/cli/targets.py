"""`errpipe targets`."""

from __future__ import annotations

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    name: str = typer.Argument("", metavar="[NAME]", help="One format, such as linuxcnc_screw."), json: bool = Json
) -> None:
    """List the controller formats, or show the page of one.

    \b
    Example:
      errpipe targets
      errpipe targets linuxcnc_screw
      errpipe targets --json
    """
    if name:
        page = module_of("verbs.reference").entry("targets", name)
        print_answer("targets", {"target": name, "says": [page.rstrip()]}, as_json=json)
        return
    print_answer("targets", module_of("stages.targets").targets(), as_json=json)
