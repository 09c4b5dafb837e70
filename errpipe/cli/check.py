"""`errpipe check`."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import typer

from errpipe.cli._arguments import Json


def command(
    files: list[Path] = typer.Argument(metavar="FILE...", help="Pipelines, fleets, machines, manifests or folders."),
    data: bool = typer.Option(True, "--data/--no-data", help="Whether the inputs must be there."),
    style: Literal["text", "github"] = typer.Option("text", "--format", help="How problems are printed."),
    json: bool = Json,
) -> None:
    """Check configuration files; list all problems with line numbers.

    Manifests, headers and first rows are read; components, axes, sensors, groups, targets and machines are looked up.

    \b
    Example:
      errpipe check pipelines/ball-screw-axis.yaml
      errpipe check pipelines/ball-screw-axis.yaml --no-data --format github
    """
    from errpipe.cli._check import check

    if code := check(files, data, style, json):
        raise typer.Exit(code)
