"""`errpipe terms`."""

from __future__ import annotations

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    name: str = typer.Argument("", metavar="[NAME]", help="One term, such as backlash."), json: bool = Json
) -> None:
    """List the terms, or show one with equation, sizes and sign.

    \b
    Example:
      errpipe terms
      errpipe terms backlash
    """
    print_answer("terms", module_of("verbs.catalogue").terms(name), as_json=json)
