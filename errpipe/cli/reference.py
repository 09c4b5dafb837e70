"""Verbs that describe errpipe itself: terms, formats, refusals, versions, schemas, completion."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from errpipe.cli.output import module_of


def terms(name: str = typer.Argument("", metavar="[NAME]", help="One term, such as backlash.")) -> Mapping[str, Any]:
    """List the terms, or show one with equation, sizes and sign.

    \b
    Example:
      errpipe terms
      errpipe terms backlash
    """
    return module_of("verbs.catalogue").terms(name)


def formats(
    name: str = typer.Argument("", metavar="[NAME]", help="One format, such as ecmc_dat."),
) -> Mapping[str, Any]:
    """List the readable measurement file formats, or show one.

    \b
    Example:
      errpipe formats
      errpipe formats ecmc_dat
    """
    return module_of("verbs.catalogue").formats(name)


def explain(
    code: str = typer.Argument(metavar="CODE", help="A name in brackets, a kind of error, or an exit code."),
) -> Mapping[str, Any]:
    """Explain a refusal: its name, its kind of error, or an exit code.

    \b
    Example:
      errpipe explain absolute-readings
      errpipe explain 4
    """
    return module_of("verbs.catalogue").explain(code)


def doctor() -> Mapping[str, Any]:
    """Show versions, compiler, extras, cache folder and threads.

    \b
    Example:
      errpipe doctor
    """
    return module_of("verbs.doctor").doctor()


def reference(
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
