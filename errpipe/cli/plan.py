"""`errpipe plan`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Force, Json, Out, PipelineFile, Sets, To, output_folder
from errpipe.cli.output import print_result
from errpipe.errors import CHANGES_PENDING


def command(
    pipeline: Path = PipelineFile,
    out: Path | None = Out,
    to: str | None = To,
    sets: list[str] = Sets,
    force: list[str] = Force,
    exit_code: bool = typer.Option(False, "--exit-code", help="Exit with 5 where a stage would run."),
    json: bool = Json,
) -> None:
    """Show which stages would run, and why; write nothing.

    \b
    Example:
      errpipe plan pipelines/ball-screw-axis.yaml --set fit.method=linear
      errpipe plan pipelines/ball-screw-axis.yaml --exit-code
    """
    from errpipe.cli._pipeline import load_pipeline_file
    from errpipe.pipeline import runner

    steps = runner.plan(load_pipeline_file(pipeline, sets), output_folder(pipeline, out), to=to, force=force)
    pending = any(step.action != "fresh" for step in steps)
    code = CHANGES_PENDING if pending and exit_code else 0
    width = max(len(step.name) for step in steps)
    lines = [f"{s.name:<{width}}  {s.action:<7}  {'; '.join(s.reasons)}".rstrip() for s in steps]
    result = {
        "pending": pending,
        "stages": [{"name": s.name, "kind": s.kind, "action": s.action, "reasons": s.reasons} for s in steps],
    }
    print_result("plan", result, lines, as_json=json, code=code)
    raise typer.Exit(code)
