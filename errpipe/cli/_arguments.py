"""Arguments and first steps that several verbs share."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.errors import UsageError

PipelineFile = typer.Argument(metavar="PIPELINE", help="The pipeline file (YAML).")
Out = typer.Option(
    None,
    "--out",
    metavar="DIR",
    help="Folder for the outputs; default: out/<name of the pipeline file>.",
    show_default=False,
)
To = typer.Option(None, "--to", metavar="STAGE", help="Only this stage and what it reads.")
Sets = typer.Option(
    [],
    "--set",
    metavar="STAGE.KEY=VALUE",
    help="Set one key for this run; the value is YAML. Repeatable.",
    show_default=False,
)
Force = typer.Option([], "--force", metavar="STAGE", help="Run this stage even if it is up to date. Repeatable.")
At = typer.Option([], "--at", metavar="INPUT=VALUE", help="Value of one input, in its canonical unit. Repeatable.")
SecretKey = typer.Option(..., "--key", envvar="ERRPIPE_KEY", metavar="FILE", help="The secret key (errpipe keygen).")
PublicKey = typer.Option(
    ..., "--public-key", envvar="ERRPIPE_PUBLIC_KEY", metavar="FILE", help="The public key that verifies signatures."
)
Why = typer.Option(..., "--why", metavar="TEXT", help="The reason, one line; it is signed.")
Time = typer.Option(None, "--time", metavar="TIME", help="Time, ISO 8601, UTC if no zone is given; default: now.")
Json = typer.Option(False, "--json", help="One JSON document on standard output, also on failure.")


def output_folder(file: Path, out: Path | None) -> Path:
    """The folder for outputs: `--out`, else out/<name of the pipeline file>."""
    return out if out is not None else Path("out") / file.stem


def input_values(at: list[str]) -> dict[str, float]:
    """The inputs of `--at x=100 --at T_nut=25`. Raises UsageError."""
    values: dict[str, float] = {}
    for text in at:
        name, equals, value = text.partition("=")
        try:
            if not equals or not name.strip():
                raise ValueError
            number = float(value)
        except ValueError:
            raise UsageError(f"--at {text}: not of the form INPUT=VALUE, such as x=100") from None
        if name.strip() in values:
            raise UsageError(f"--at {text}: {name.strip()} was given before ({values[name.strip()]:g})")
        values[name.strip()] = number
    return values
