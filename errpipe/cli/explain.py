"""`errpipe explain`."""

from __future__ import annotations

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_answer


def command(
    code: str = typer.Argument(metavar="CODE", help="A name in brackets, a kind of error, or an exit code."),
    json: bool = Json,
) -> None:
    """Explain a refusal: its name, its kind of error, or an exit code.

    \b
    Example:
      errpipe explain absolute-readings
      errpipe explain 4
    """
    print_answer("explain", module_of("verbs.catalogue").explain(code), as_json=json)
