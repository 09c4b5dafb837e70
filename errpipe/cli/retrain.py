"""`errpipe retrain`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer

from errpipe.cli._arguments import Json, PipelineFile, Sets
from errpipe.errors import UsageError


def _read(file: Path, sets: list[str], out: Path) -> Any:
    """The pipeline; where it cannot be read, pages say so in the place of those of the look before."""
    from errpipe.cli._pipeline import load_pipeline_file
    from errpipe.cli.output import module_of
    from errpipe.errors import ErrpipeError

    try:
        return load_pipeline_file(file, sets)
    except ErrpipeError as err:
        if (out / "retrain.json").is_file():
            module_of("verbs.retrain").write_failure("", str(err), out)
        raise


def command(
    pipeline: Path = PipelineFile,
    champion: Path = typer.Option(..., "--champion", metavar="DIR", help="Run folder of the champion."),
    out: Path = typer.Option(..., "--out", "-o", metavar="DIR", help="Folder of the challenger and of the decision."),
    alpha: float = typer.Option(
        0.05, "--alpha", metavar="P", min=1e-9, max=0.5, help="Risk of ever promoting a challenger that is no better."
    ),
    max_change_um: float | None = typer.Option(
        None, "--max-change-um", metavar="UM", min=0.0, help="Largest change of the correction."
    ),
    max_change_um_per_k: float | None = typer.Option(
        None, "--max-change-um-per-k", metavar="UM/K", min=0.0, help="Largest change of it per kelvin."
    ),
    allow_sensor: list[str] = typer.Option(
        [], "--allow-sensor", metavar="COLUMN", help="Input that the challenger may newly require."
    ),
    annotations: str = typer.Option("none", "--annotations", metavar="HOW", help="github: annotate failed gates."),
    sets: list[str] = Sets,
    json: bool = Json,
) -> None:
    """Fit to all data; promote only if better than the model in use.

    Exit code 0: promote; 4: keep the champion. Every new run counts once, so it may be run as often as there is data.

    \b
    Example:
      errpipe retrain axis/pipeline.yaml --champion out/champion --out out/retrain
    """
    from errpipe.cli.output import module_of, print_result
    from errpipe.cli.progress import ProgressReporter

    if annotations not in ("none", "github"):
        raise UsageError(f"--annotations: {annotations!r} is not known (allowed: none, github)")
    spec = _read(pipeline, sets, out)
    reporter = ProgressReporter(str(out))
    try:
        document = module_of("verbs.retrain").retrain(
            spec,
            champion,
            out,
            alpha=alpha,
            max_change_um=max_change_um,
            max_change_um_per_k=max_change_um_per_k,
            allowed_sensors=allow_sensor,
            callbacks=reporter.callbacks(),
        )
    finally:
        reporter.clear()
    promoted = document["decision"] == "promote"
    lines = module_of("verbs.retrain").in_words(document)
    lines.append(str(out / "retrain.md"))
    if annotations == "github":
        lines = [*module_of("verbs.retrain").github_annotations(document), *lines]
    print_result("retrain", document, lines, as_json=json, code=0 if promoted else 4)
    if not promoted:
        raise typer.Exit(4)
