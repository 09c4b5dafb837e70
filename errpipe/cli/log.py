"""`errpipe log`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json, PublicKey
from errpipe.cli.output import module_of, print_answer


def command(
    registry: Path = typer.Argument(metavar="REGISTRY", help="Folder of the registry."),
    machine: str | None = typer.Argument(None, metavar="MACHINE", help="One machine only."),
    at: str | None = typer.Option(
        None, "--at", metavar="TIME", help="What was on the machine then, or on that day (UTC), such as 2026-03-03."
    ),
    file: Path | None = typer.Option(None, "--file", metavar="TABLE", help="Which entries this table belongs to."),
    public_key: Path = PublicKey,
    json: bool = Json,
) -> None:
    """Show which tables a machine had, when, and why; check signatures.

    \b
    Example:
      errpipe log registry 7 --at 2026-03-03 --public-key keys/errpipe.pub
      errpipe log registry --file found.ect --public-key keys/errpipe.pub
    """
    print_answer("log", module_of("stages.signing").log(registry, machine, at, file, public_key), as_json=json)
