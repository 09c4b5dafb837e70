"""Verbs of signatures, and of the registry of the tables that each machine had."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from errpipe.cli._arguments import PublicKey, SecretKey, Time, Why
from errpipe.cli.output import module_of


def keygen(
    folder: Path = typer.Argument(metavar="DIR", help="Where errpipe.key (secret) and errpipe.pub are written."),
) -> Mapping[str, Any]:
    """Generate a key pair for signing, in minisign's format.

    The secret key has no password: keep it where only the signer can read it. A key is never overwritten.

    \b
    Example:
      errpipe keygen keys
    """
    return module_of("stages.signing").keygen(folder)


def sign(
    file: Path = typer.Argument(metavar="FILE", help="A table, or any other file."),
    key: Path = SecretKey,
    comment: str = typer.Option("", "--comment", metavar="TEXT", help="Signed along with the file, such as a machine."),
) -> Mapping[str, Any]:
    """Sign a file; `minisign` can check the signature, too.

    \b
    Example:
      errpipe sign out/export/table.ect --key errpipe.key --comment "machine 7"
    """
    return module_of("stages.signing").sign(file, key, comment)


def verify_signature(
    file: Path = typer.Argument(metavar="FILE", help="The file; its signature is FILE.minisig."),
    public_key: Path = PublicKey,
) -> Mapping[str, Any]:
    """Check a signature; exit code 6 if missing, invalid or foreign.

    \b
    Example:
      errpipe verify-signature out/export/table.ect --public-key keys/errpipe.pub
    """
    return module_of("stages.signing").verify_signature(file, public_key)


def promote(
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
) -> Mapping[str, Any]:
    """Record in the registry that a table is on a machine.

    It replaces the table before whole: one that corrects other axes is refused (exit 4) without --other-outputs.
    Of two who promote at once one wins, and the other is refused (exit 4).

    \b
    Example:
      errpipe promote registry 7 t.ect --why repair --key a.key --public-key a.pub
    """
    done = module_of("stages.signing").promote(registry, machine, table, why, key, public_key, time, other_outputs)
    return done


def rollback(
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
) -> Mapping[str, Any]:
    """Record that a machine returns to its previous table.

    The history is append-only: a rollback is a new entry. Each further rollback returns one table further
    back, never to one that was taken off.

    \b
    Example:
      errpipe rollback registry 7 --out t.ect --why bad --key k --public-key k.pub
    """
    done = module_of("stages.signing").rollback(registry, machine, to, out, why, key, public_key, time)
    return done


def log(
    registry: Path = typer.Argument(metavar="REGISTRY", help="Folder of the registry."),
    machine: str | None = typer.Argument(None, metavar="MACHINE", help="One machine only."),
    at: str | None = typer.Option(
        None, "--at", metavar="TIME", help="What was on the machine then, or on that day (UTC), such as 2026-03-03."
    ),
    file: Path | None = typer.Option(None, "--file", metavar="TABLE", help="Which entries this table belongs to."),
    public_key: Path = PublicKey,
) -> Mapping[str, Any]:
    """Show which tables a machine had, when, and why; check signatures.

    \b
    Example:
      errpipe log registry 7 --at 2026-03-03 --public-key keys/errpipe.pub
      errpipe log registry --file found.ect --public-key keys/errpipe.pub
    """
    return module_of("stages.signing").log(registry, machine, at, file, public_key)
