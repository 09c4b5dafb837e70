"""`errpipe fleet`."""

from __future__ import annotations

from pathlib import Path

import typer

from errpipe.cli._arguments import Json


def command(
    fleet: Path = typer.Argument(metavar="FLEET", help="The fleet file (YAML)."),
    out: Path = typer.Option(..., "--out", "-o", metavar="DIR", help="Folder for machines and report."),
    jobs: int = typer.Option(0, "--jobs", "-j", min=0, metavar="N", help="Processes; 0: one for each core."),
    scheduler: str | None = typer.Option(
        None, "--scheduler", metavar="ADDRESS", help="A running Dask cluster instead."
    ),
    json: bool = Json,
) -> None:
    """Run one pipeline for many machines; one report.

    A failed machine does not stop the others (exit 4 at the end); the same command resumes an interrupted run.

    \b
    Example:
      errpipe fleet fleet.yaml --out out/fleet --jobs 4
      errpipe fleet fleet.yaml --out out/fleet --scheduler tcp://10.0.0.5:8786
    """
    from errpipe.cli.output import module_of, print_result
    from errpipe.cli.progress import ProgressReporter

    reporter = ProgressReporter(str(out))
    try:
        summary = module_of("verbs.fleet").fleet(fleet, out, jobs, scheduler, reporter.progress_of("fleet"))
    finally:
        reporter.clear()
    if "parts" in summary:  # of one machine's history
        lines = [f"{s}: {c}: {text}" for s, texts in summary["whole"].items() for c, text in texts.items()]
        print_result("fleet", summary, [*lines, str(out / "whole")], as_json=json)
        return
    rows = summary["machines"]
    bad = [r for r in rows if r["state"] != "done"]
    lines = [f"{r['name']}: {r['state']}: {r['message']}" for r in bad]
    lines += [f"{d['name']}: {d['what']} drifts since run {d['since']}" for d in summary["drifting"]]
    lines += summary["suspicious"]
    lines += [f"{len(rows) - len(bad)} of {len(rows)} machines done", str(out / "fleet.md")]
    print_result("fleet", summary, lines, as_json=json, code=4 if bad else 0)
    if bad:
        raise typer.Exit(4)
