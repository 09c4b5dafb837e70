"""`errpipe rollback`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json, PublicKey, SecretKey, Time, Why
from errpipe.cli.output import module_of, print_answer


def command(
    registry: Path = typer.Argument(metavar="REGISTRY", help="Folder of the registry."),
    machine: str = typer.Argument(metavar="MACHINE", help="Name of the machine."),
    to: int | None = typer.Option(
        None, "--to", metavar="ENTRY", help="Number of an entry; default: the table before this one."
    ),
    out: Path | None = typer.Option(None, "--out", metavar="FILE", help="Where to write the table that is back."),
    why: str = Why,
    key: Path = SecretKey,
    public_key: Path = PublicKey,
    time: str | None = Time,
    json: bool = Json,
) -> None:
    """Record that a machine returns to its previous table.

    The history is append-only: a rollback is a new entry. Each further rollback returns one table further
    back, never to one that was taken off.

    \b
    Example:
      errpipe rollback registry 7 --out t.ect --why bad --key k --public-key k.pub
    """
    done = module_of("stages.signing").rollback(registry, machine, to, out, why, key, public_key, time)
    print_answer("rollback", done, as_json=json)
