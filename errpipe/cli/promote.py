"""`errpipe promote`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json, PublicKey, SecretKey, Time, Why
from errpipe.cli.output import module_of, print_answer


def command(
    registry: Path = typer.Argument(metavar="REGISTRY", help="Folder of the registry."),
    machine: str = typer.Argument(metavar="MACHINE", help="Name of the machine."),
    table: Path = typer.Argument(metavar="TABLE", help="The table that it gets (.ect)."),
    why: str = Why,
    key: Path = SecretKey,
    public_key: Path = PublicKey,
    time: str | None = Time,
    other_outputs: bool = typer.Option(
        False,
        "--other-outputs",
        help="It may correct other axes or in other units than the table before, or be made for another machine.",
    ),
    json: bool = Json,
) -> None:
    """Record in the registry that a table is on a machine.

    It replaces the table before whole: one that corrects other axes is refused (exit 4) without --other-outputs.
    Of two who promote at once one wins, and the other is refused (exit 4).

    \b
    Example:
      errpipe promote registry 7 t.ect --why repair --key a.key --public-key a.pub
    """
    done = module_of("stages.signing").promote(registry, machine, table, why, key, public_key, time, other_outputs)
    print_answer("promote", done, as_json=json)
