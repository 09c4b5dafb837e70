"""Verbs that make, plan and run pipelines of one machine or of many."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from errpipe.cli._arguments import Force, Out, PipelineFile, Sets, To, output_folder
from errpipe.cli.output import Answer, module_of
from errpipe.errors import CHANGES_PENDING

TEMPLATES = "laser-iso230, dial-gauge, diagnose-log, spindle-drift, gantry, drilled-plate, five-axis"


def init(
    folder: Path = typer.Argument(metavar="DIR", help="The folder to write."),
    template: str = typer.Option("laser-iso230", "--template", metavar="NAME", help=f"One of: {TEMPLATES}."),
    recording: Path | None = typer.Option(
        None, "--recording", metavar="FOLDER", help="A recording of your own instead of the sample."
    ),
    target: list[str] = typer.Option(
        [], "--target", metavar="NAME", help="A controller format instead of the default ones. Repeatable."
    ),
) -> Mapping[str, Any]:
    """Create a folder with a pipeline, ready to run, from a template.

    \b
    Example:
      errpipe init --template laser-iso230 axis
      errpipe init --template dial-gauge mill --recording data --target c_runtime
    """
    return module_of("verbs.init").init(folder, template, recording, target)


def plan(
    pipeline: Path = PipelineFile,
    out: Path | None = Out,
    to: str | None = To,
    sets: list[str] = Sets,
    force: list[str] = Force,
    exit_code: bool = typer.Option(False, "--exit-code", help="Exit with 5 where a stage would run."),
) -> Answer:
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
    return Answer(result, lines, code)


def demo(
    out: Path = typer.Option(Path("out/demo"), "--out", metavar="DIR", help="Folder for the outputs."),
) -> Mapping[str, Any]:
    """Run the main job on a simulated ball-screw axis; no files needed.

    \b
    Example:
      errpipe demo
      errpipe demo --out out/demo
    """
    from errpipe.cli.progress import ProgressReporter

    return module_of("verbs.demo").demo(out, ProgressReporter(str(out)).callbacks())


def fleet(
    fleet: Path = typer.Argument(metavar="FLEET", help="The fleet file (YAML)."),
    out: Path = typer.Option(..., "--out", "-o", metavar="DIR", help="Folder for machines and report."),
    jobs: int = typer.Option(0, "--jobs", "-j", min=0, metavar="N", help="Processes; 0: one for each core."),
    scheduler: str | None = typer.Option(
        None, "--scheduler", metavar="ADDRESS", help="A running Dask cluster instead."
    ),
) -> Answer:
    """Run one pipeline for many machines; one report.

    A failed machine does not stop the others (exit 4 at the end); the same command resumes an interrupted run.

    \b
    Example:
      errpipe fleet fleet.yaml --out out/fleet --jobs 4
      errpipe fleet fleet.yaml --out out/fleet --scheduler tcp://10.0.0.5:8786
    """
    from errpipe.cli.progress import ProgressReporter

    with ProgressReporter(str(out)) as reporter:
        summary = module_of("verbs.fleet").fleet(fleet, out, jobs, scheduler, reporter.progress_of("fleet"))
    if "parts" in summary:  # of one machine's history
        lines = [f"{s}: {c}: {text}" for s, texts in summary["whole"].items() for c, text in texts.items()]
        return Answer(summary, [*lines, str(out / "whole")])
    rows = summary["machines"]
    bad = [r for r in rows if r["state"] != "done"]
    lines = [f"{r['name']}: {r['state']}: {r['message']}" for r in bad]
    lines += [f"{d['name']}: {d['what']} drifts since run {d['since']}" for d in summary["drifting"]]
    lines += summary["suspicious"]
    lines += [f"{len(rows) - len(bad)} of {len(rows)} machines done", str(out / "fleet.md")]
    return Answer(summary, lines, 4 if bad else 0)
