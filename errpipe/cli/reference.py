"""`errpipe reference`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli.output import module_of


def command(
    page: str = typer.Argument("terms", metavar="[PAGE]", help="terms, formats, targets, stages or recordings."),
    name: str = typer.Argument("", metavar="[NAME]", help="One entry of the page, such as backlash."),
    write: Path | None = typer.Option(None, "--write", metavar="DIR", help="Write all pages into DIR instead."),
) -> None:
    """Print a reference page, or one entry of it, as Markdown.

    \b
    Example:
      errpipe reference terms backlash
      errpipe reference stages
    """
    reference = module_of("verbs.reference")
    if write is not None:
        reference.write(write)
        return
    typer.echo(reference.entry(page, name) if name else reference.page(page), nl=False)
