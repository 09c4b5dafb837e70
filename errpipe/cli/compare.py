"""`errpipe compare`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json
from errpipe.cli.output import module_of, print_result


def command(
    old: Path = typer.Argument(metavar="OLD", help="Table, model, recording, diagnosis, run folder or fleet."),
    new: Path = typer.Argument(metavar="NEW", help="Another one of that kind."),
    max_um: float | None = typer.Option(
        None, "--max-um", min=0.0, metavar="UM", help="Largest difference allowed; beyond it exit 4."
    ),
    figure: Path | None = typer.Option(
        None, "--figure", metavar="FILE", help="Write a figure of the difference (SVG)."
    ),
    json: bool = Json,
) -> None:
    """Compare two results: what changed, where, and by how many um.

    Tables and models are evaluated on the same states over their common validity range.

    \b
    Example:
      errpipe compare out/champion out/retrain/run --max-um 5
      errpipe compare before.ect out/export/table.ect --figure change.svg
    """
    comparison = module_of("verbs.compare").compare(old, new, max_um, figure)
    says = comparison.pop("says")
    code = 4 if comparison["within"] is False else 0
    print_result("compare", comparison, says, as_json=json, code=code)
    if code:
        raise typer.Exit(code)
